//! Exact order statistics in bounded memory.
//!
//! Floats are mapped to integers of the same order and found digit by digit (16 bits each): a pass
//! counts, per leading digits that are still in question, how many values continue with each next
//! digit; when so few values are in question that they fit into memory, they are collected and
//! sorted. At most four passes, usually two or three; a few MB whatever the number of values. Exact,
//! hence the same for any order. In the unit of the values.

use std::collections::BTreeMap;

use super::values::Values;

/// Values that are collected and sorted instead of counted on: 4 MiB.
const COLLECT_UP_TO: u64 = 1 << 19;

const DIGIT_BITS: u32 = 16;
const DIGITS: usize = 1 << DIGIT_BITS;

/// Some values by their place in ascending order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OrderStatistics {
    n: u64,
    by_rank: BTreeMap<u64, f64>,
}

/// Where a quantile lies: between two neighbours in the order, a share of the way (numpy's default).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Position {
    below: u64,
    above: u64,
    share: f64,
}

impl Position {
    /// `None` without values.
    fn of(q: f64, n: u64) -> Option<Self> {
        let last = n.checked_sub(1)?;
        let position = q.clamp(0.0, 1.0) * last as f64;
        let below = (position as u64).min(last);
        Some(Self {
            below,
            above: (below + 1).min(last),
            share: position - below as f64,
        })
    }

    fn between(self, a: f64, b: f64) -> f64 {
        // Two products cannot overflow where b − a would; the clamp removes their rounding.
        (a * (1.0 - self.share) + b * self.share).clamp(a, b)
    }
}

impl OrderStatistics {
    /// Finds what [`Self::quantile`] and [`Self::median`] need for these quantiles, and the `extremes`
    /// lowest and highest values, of `n` values; also with any one of them left out.
    ///
    /// # Errors
    /// Where the values cannot be read.
    pub fn find<V: Values>(
        values: &V,
        n: u64,
        quantiles: &[f64],
        extremes: u64,
    ) -> Result<Self, V::Error> {
        let mut ranks: Vec<u64> = (0..extremes)
            .chain(n.saturating_sub(extremes)..n)
            .chain([n / 2, n.saturating_sub(1) / 2])
            .collect();
        for &q in quantiles {
            for n in [n, n.saturating_sub(1)] {
                // Without a lower value, rank k is rank k + 1 of all.
                ranks.extend(
                    Position::of(q, n)
                        .into_iter()
                        .flat_map(|p| [p.below, p.below + 1, p.above + 1]),
                );
            }
        }
        ranks.retain(|&rank| rank < n);
        ranks.sort_unstable();
        ranks.dedup();
        let found = select(values, n, &ranks)?;
        Ok(Self {
            n,
            by_rank: ranks.into_iter().zip(found).collect(),
        })
    }

    /// How many values there are.
    #[must_use]
    pub fn n(&self) -> u64 {
        self.n
    }

    /// The value at a place that was asked for, counted from 0.
    #[must_use]
    pub fn nth(&self, rank: u64) -> Option<f64> {
        self.by_rank.get(&rank).copied()
    }

    /// The same in the order without one copy of `value`, which is in it.
    #[must_use]
    pub fn nth_without(&self, rank: u64, value: f64) -> Option<f64> {
        let found = self.nth(rank)?;
        if found < value {
            Some(found)
        } else {
            self.nth(rank + 1)
        }
    }

    /// The smallest value.
    #[must_use]
    pub fn min(&self) -> Option<f64> {
        self.nth(0)
    }

    /// The largest value.
    #[must_use]
    pub fn max(&self) -> Option<f64> {
        self.nth(self.n.checked_sub(1)?)
    }

    /// The median: the middle value, or the midpoint of the two; `None` without values.
    #[must_use]
    pub fn median(&self) -> Option<f64> {
        let upper = self.nth(self.n / 2)?;
        if self.n % 2 == 1 {
            return Some(upper);
        }
        Some(f64::midpoint(self.nth(self.n / 2 - 1)?, upper))
    }

    /// The q-quantile, linear between order statistics (numpy's default); `None` without values.
    #[must_use]
    pub fn quantile(&self, q: f64) -> Option<f64> {
        let position = Position::of(q, self.n)?;
        Some(position.between(self.nth(position.below)?, self.nth(position.above)?))
    }

    /// The q-quantile without one copy of `value`, which is among the values.
    #[must_use]
    pub fn quantile_without(&self, q: f64, value: f64) -> Option<f64> {
        let position = Position::of(q, self.n.checked_sub(1)?)?;
        let (below, above) = (
            self.nth_without(position.below, value)?,
            self.nth_without(position.above, value)?,
        );
        Some(position.between(below, above))
    }
}

/// Ranks that are looked for at once: each may need a table of [`DIGITS`] counts.
const RANKS_AT_ONCE: usize = 128;

/// The values at many ranks (ascending, distinct, below n), in bounded memory.
///
/// # Errors
/// Where the values cannot be read.
pub fn at_ranks<V: Values>(values: &V, n: u64, ranks: &[u64]) -> Result<Vec<f64>, V::Error> {
    let mut found = Vec::with_capacity(ranks.len());
    if n <= COLLECT_UP_TO {
        return select(values, n, ranks);
    }
    for ranks in ranks.chunks(RANKS_AT_ONCE) {
        found.extend(select(values, n, ranks)?);
    }
    Ok(found)
}

/// An integer of the same order as the float.
fn key(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits >> 63 == 1 {
        !bits
    } else {
        bits | (1 << 63)
    }
}

fn from_key(key: u64) -> f64 {
    f64::from_bits(if key >> 63 == 1 {
        key & !(1 << 63)
    } else {
        !key
    })
}

/// The leading `bits` of a key.
fn prefix(key: u64, bits: u32) -> u64 {
    if bits == 0 { 0 } else { key >> (64 - bits) }
}

/// Values with the same leading digits, and the ranks that fall among them.
#[derive(Debug, Clone)]
struct Window {
    prefix: u64,
    /// Values below all of these.
    below: u64,
    count: u64,
    ranks: Vec<u64>,
}

/// The values at `ranks` (ascending, distinct, below n).
fn select<V: Values>(values: &V, n: u64, ranks: &[u64]) -> Result<Vec<f64>, V::Error> {
    if ranks.is_empty() {
        return Ok(Vec::new());
    }
    let mut windows = vec![Window {
        prefix: 0,
        below: 0,
        count: n,
        ranks: ranks.to_vec(),
    }];
    let mut bits = 0;
    while bits < 64 && windows.iter().map(|w| w.count).sum::<u64>() > COLLECT_UP_TO {
        let counts = count_next_digits(values, &windows, bits)?;
        bits += DIGIT_BITS;
        windows = windows
            .iter()
            .zip(counts.chunks(DIGITS))
            .flat_map(|(window, counts)| narrowed(window, counts))
            .collect();
    }
    if bits == 64 {
        let found = windows
            .iter()
            .flat_map(|w| w.ranks.iter().map(|_| from_key(w.prefix)));
        return Ok(found.collect());
    }
    let mut collected = values.fold(
        &Vec::new,
        &|collected: &mut Vec<f64>, piece| {
            let inside = |&&value: &&f64| place(&windows, prefix(key(value), bits)).is_some();
            collected.extend(piece.iter().filter(inside));
        },
        &|all, more| all.extend(more),
    )?;
    collected.sort_unstable_by(f64::total_cmp);
    let mut start = 0;
    let mut found = Vec::with_capacity(ranks.len());
    for window in &windows {
        let values = &collected[start as usize..];
        found.extend(
            window
                .ranks
                .iter()
                .filter_map(|rank| values.get((rank - window.below) as usize)),
        );
        start += window.count;
    }
    Ok(found)
}

/// The window with this prefix; windows ascend.
fn place(windows: &[Window], prefix: u64) -> Option<usize> {
    match windows {
        [only] => (only.prefix == prefix).then_some(0),
        _ => windows
            .binary_search_by_key(&prefix, |window| window.prefix)
            .ok(),
    }
}

fn count_next_digits<V: Values>(
    values: &V,
    windows: &[Window],
    bits: u32,
) -> Result<Vec<u64>, V::Error> {
    values.fold(
        &|| vec![0_u64; windows.len() * DIGITS],
        &|counts, piece| {
            for &value in piece {
                let key = key(value);
                if let Some(place) = place(windows, prefix(key, bits)) {
                    let digit = (key >> (64 - bits - DIGIT_BITS)) as usize % DIGITS;
                    counts[place * DIGITS + digit] += 1;
                }
            }
        },
        &|counts, more| counts.iter_mut().zip(more).for_each(|(a, b)| *a += b),
    )
}

/// The windows of one more digit that hold the ranks of `window`.
fn narrowed(window: &Window, counts: &[u64]) -> Vec<Window> {
    let mut narrower: Vec<Window> = Vec::new();
    let mut below = window.below;
    let mut ranks = window.ranks.iter().copied().peekable();
    for (digit, &count) in counts.iter().enumerate() {
        let mut inside = Vec::new();
        while let Some(rank) = ranks.next_if(|&rank| rank < below + count) {
            inside.push(rank);
        }
        if !inside.is_empty() {
            narrower.push(Window {
                prefix: (window.prefix << DIGIT_BITS) | digit as u64,
                below,
                count,
                ranks: inside,
            });
        }
        below += count;
    }
    narrower
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::reduce::values::InMemory;

    fn find(values: &[f64], quantiles: &[f64]) -> OrderStatistics {
        let values: InMemory = values.iter().copied().collect();
        let Ok(found) = OrderStatistics::find(&values, values_len(&values), quantiles, 3);
        found
    }

    fn values_len(values: &InMemory) -> u64 {
        let Ok(n) = values.fold(&|| 0, &|n, piece| *n += piece.len() as u64, &|_, _| {});
        n
    }

    #[test]
    fn quantiles_and_medians() {
        let found = find(&[4.0, 1.0, f64::NAN, 2.0, 3.0], &[0.25, 1.0]);
        assert_eq!(found.median(), Some(2.5));
        assert_eq!(found.quantile(0.25), Some(1.75));
        assert_eq!(found.quantile(1.0), Some(4.0));
        assert_eq!((found.min(), found.max()), (Some(1.0), Some(4.0)));
        let none = find(&[], &[0.5]);
        assert_eq!((none.quantile(0.5), none.median()), (None, None));
        let wide = find(&[-f64::MAX, f64::MAX], &[0.5]);
        assert_eq!((wide.median(), wide.quantile(0.5)), (Some(0.0), Some(0.0)));
        assert_eq!(find(&[0.0, -0.0], &[]).min().unwrap().to_bits(), 0);
    }

    /// More values than are collected at once, many of them equal: digits are counted to the last.
    #[test]
    fn many_values_are_selected_by_digits() {
        let n = COLLECT_UP_TO * 2 + 17;
        let value = |i: u64| match i % 4 {
            0 => 0.1,
            1 => 1.0 + (i * 7919 % n) as f64 * f64::EPSILON,
            2 => -((i * 31 % n) as f64),
            _ => 1e-300 * i as f64,
        };
        let values: InMemory = (0..n).map(value).collect();
        let mut sorted: Vec<f64> = (0..n).map(|i| value(i) + 0.0).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let ranks = [
            0,
            1,
            n / 4,
            n / 4 + 1,
            n / 2,
            n * 3 / 4,
            n * 9 / 10,
            n - 2,
            n - 1,
        ];
        let Ok(found) = select(&values, n, &ranks);
        assert_eq!(found, ranks.map(|rank| sorted[rank as usize]));
        let equal: InMemory = (0..n).map(|_| 0.3).collect();
        let Ok(found) = select(&equal, n, &[0, n / 2, n - 1]);
        assert_eq!(found, [0.3; 3]);
    }

    proptest! {
        /// The slow twin sorts, with and without each value.
        #[test]
        fn agrees_with_sorting(
            values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::ZERO, 1..40),
            q in 0.0_f64..1.0,
        ) {
            let sorted = |values: &[f64]| {
                let mut sorted: Vec<f64> = values.iter().map(|v| v + 0.0).collect();
                sorted.sort_unstable_by(f64::total_cmp);
                sorted
            };
            let quantile = |sorted: &[f64]| {
                let position = q * (sorted.len() as f64 - 1.0);
                let below = position as usize;
                let (a, b) = (sorted[below], sorted[(below + 1).min(sorted.len() - 1)]);
                let share = position - below as f64;
                (a * (1.0 - share) + b * share).clamp(a, b)
            };
            let found = find(&values, &[q]);
            prop_assert_eq!(found.quantile(q), Some(quantile(&sorted(&values))));
            for i in 0..values.len() {
                let mut rest = values.clone();
                let value = rest.remove(i) + 0.0;
                let expected = (!rest.is_empty()).then(|| quantile(&sorted(&rest)));
                prop_assert_eq!(found.quantile_without(q, value), expected);
            }
            for &value in &values {
                prop_assert_eq!(from_key(key(value)).to_bits(), value.to_bits());
            }
        }
    }
}
