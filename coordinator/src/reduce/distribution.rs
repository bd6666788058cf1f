//! A distribution in few numbers: values at evenly spaced ranks, with exact counts at each.
//!
//! Up to 1001 values all are kept, and everything below is exact; of more, every thousandth part of
//! them. What is asked of a place between two kept values is interpolated between the exact counts at
//! them, hence right to 0.1%. In the unit of the values. Only reading the values can fail.

use serde::{Deserialize, Serialize};

use super::order::at_ranks;
use super::values::Values;

/// Steps between the smallest and the largest value.
const STEPS: u64 = 1000;

/// The frozen form of some values.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Distribution {
    /// How many values there were.
    pub n: u64,
    /// Some of them, ascending and distinct, the smallest and the largest among them.
    pub values: Vec<f64>,
    /// How many were smaller than each.
    pub below: Vec<u64>,
    /// How many were smaller than each, or equal to it.
    pub at_most: Vec<u64>,
}

/// How many of some other values lie at the places of a distribution.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// All of them.
    pub n: u64,
    /// As in [`Distribution`].
    pub below: Vec<u64>,
    /// As in [`Distribution`].
    pub at_most: Vec<u64>,
}

impl Distribution {
    /// Of values.
    ///
    /// # Errors
    /// Where they cannot be read.
    pub fn of<V: Values>(values: &V) -> Result<Self, V::Error> {
        let n = values.fold(&|| 0, &|n, piece| *n += piece.len() as u64, &|n, more| {
            *n += more;
        })?;
        let Some(last) = n.checked_sub(1) else {
            return Ok(Self::default());
        };
        let steps = last.min(STEPS);
        let mut ranks: Vec<u64> = (0..=steps)
            .map(|k| (u128::from(k) * u128::from(last) / u128::from(steps.max(1))) as u64)
            .collect();
        ranks.dedup();
        let mut kept = at_ranks(values, n, &ranks)?;
        kept.dedup();
        let mut found = Self {
            n,
            values: kept,
            ..Self::default()
        };
        let placed = found.place(values)?;
        (found.below, found.at_most) = (placed.below, placed.at_most);
        Ok(found)
    }

    /// Counts other values at the places of this distribution.
    ///
    /// # Errors
    /// Where they cannot be read.
    pub fn place<V: Values>(&self, values: &V) -> Result<Placed, V::Error> {
        // Even cells lie between kept values, odd ones are one.
        let cells = values.fold(
            &|| vec![0_u64; 2 * self.values.len() + 1],
            &|cells, piece| {
                for &value in piece {
                    let (below, equal) = self.find(value);
                    cells[2 * below + usize::from(equal)] += 1;
                }
            },
            &|cells, more| cells.iter_mut().zip(more).for_each(|(a, b)| *a += b),
        )?;
        let mut placed = Placed {
            n: cells.iter().sum(),
            below: Vec::with_capacity(self.values.len()),
            at_most: Vec::with_capacity(self.values.len()),
        };
        let mut sum = 0;
        for pair in cells.chunks_exact(2) {
            sum += pair[0];
            placed.below.push(sum);
            sum += pair[1];
            placed.at_most.push(sum);
        }
        Ok(placed)
    }

    /// How many kept values are smaller, and whether the next one equals the value.
    fn find(&self, value: f64) -> (usize, bool) {
        let below = self.values.partition_point(|&kept| kept < value);
        (below, self.values.get(below) == Some(&value))
    }

    /// How many of the values are below `value`, those equal to it counted by half; for the value of
    /// rank k among distinct ones that is k − 0.5.
    #[must_use]
    pub fn count_below(&self, value: f64) -> f64 {
        let (next, equal) = self.find(value);
        if equal {
            f64::midpoint(self.below[next] as f64, self.at_most[next] as f64)
        } else if next == 0 {
            0.0
        } else if next == self.values.len() {
            self.n as f64
        } else {
            let (low, high) = (self.values[next - 1], self.values[next]);
            // Halves cannot overflow.
            let share = ((value / 2.0 - low / 2.0) / (high / 2.0 - low / 2.0)).clamp(0.0, 1.0);
            let (from, to) = (self.at_most[next - 1] as f64, self.below[next] as f64);
            from + (to - from) * share
        }
    }

    /// True where kept values and counts belong together.
    #[must_use]
    pub fn is_consistent(&self) -> bool {
        let k = self.values.len();
        self.values.iter().all(|value| value.is_finite())
            && self.values.windows(2).all(|pair| pair[0] < pair[1])
            && (self.below.len(), self.at_most.len()) == (k, k)
            && self.below.first().is_none_or(|&first| first == 0)
            && self
                .at_most
                .last()
                .map_or(self.n == 0, |&last| last == self.n)
            && self.below.iter().zip(&self.at_most).all(|(a, b)| a < b)
            && self
                .at_most
                .iter()
                .zip(self.below.iter().skip(1))
                .all(|(a, b)| a <= b)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::reduce::values::InMemory;

    fn of(values: &[f64]) -> Distribution {
        let values: InMemory = values.iter().copied().collect();
        let Ok(found) = Distribution::of(&values);
        assert!(found.is_consistent());
        found
    }

    #[test]
    fn few_values_are_all_kept() {
        let found = of(&[3.0, 1.0, 3.0, 2.0]);
        assert_eq!(found.values, [1.0, 2.0, 3.0]);
        assert_eq!(
            (found.below.as_slice(), found.at_most.as_slice()),
            (&[0, 1, 2][..], &[1, 2, 4][..])
        );
        let counts = [0.0, 1.0, 1.5, 3.0, 9.0].map(|value| found.count_below(value));
        assert_eq!(counts, [0.0, 0.5, 1.0, 3.0, 4.0]);
        assert_eq!(of(&[]).count_below(1.0), 0.0);
        assert_eq!(of(&[-f64::MAX, f64::MAX]).count_below(0.0), 1.0);
    }

    /// 100,001 values in scrambled order: every share is right to a thousandth.
    #[test]
    fn many_values_are_right_to_a_thousandth() {
        let n = 100_001_u64;
        let values: Vec<f64> = (0..n).map(|i| (i * 7919 % n) as f64).collect();
        let found = of(&values);
        assert_eq!(found.values.len(), 1001);
        for value in [0.0, 17.5, 4321.0, 99_999.5, 100_000.0] {
            let exact = values.iter().filter(|&&v| v < value).count() as f64;
            assert!(
                (found.count_below(value) - exact).abs() < 1e-3 * n as f64,
                "{value}"
            );
        }
    }

    proptest! {
        /// The slow twin goes through all values.
        #[test]
        fn counts_are_exact_where_all_values_are_kept(
            values in prop::collection::vec(-20_i8..20, 1..80), asked in -25_i8..25,
        ) {
            let values: Vec<f64> = values.into_iter().map(f64::from).collect();
            let asked = f64::from(asked) / 2.0;
            let count = |test: &dyn Fn(f64) -> bool| values.iter().filter(|&&v| test(v)).count() as f64;
            let twin = count(&|v| v < asked) + 0.5 * count(&|v| v == asked);
            prop_assert_eq!(of(&values).count_below(asked), twin);
        }
    }
}
