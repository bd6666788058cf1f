//! The median of numbers.

/// The median, the mean of the middle two for an even count; `None` of nothing. Reorders its argument.
#[must_use]
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    let is_odd = values.len() % 2 == 1;
    if values.is_empty() {
        return None;
    }
    let (lower, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let below = lower.iter().copied().max_by(f64::total_cmp);
    Some(match below {
        Some(below) if !is_odd => below + (upper - below) / 2.0,
        _ => upper,
    })
}

/// As [`median`] of the same values widened to f64; faster, for planes. The order is total, so that no value
/// is refused.
#[must_use]
pub(crate) fn median_f32(values: impl Iterator<Item = f32>) -> Option<f64> {
    let keys: Vec<u32> = values.map(order_key).collect();
    let middle = keys.len() / 2;
    let is_odd = keys.len() % 2 == 1;
    if keys.is_empty() {
        return None;
    }
    let (below, upper) = middle_two(keys, middle);
    let upper = f64::from(value_of(upper));
    Some(match below {
        Some(below) if !is_odd => {
            let below = f64::from(value_of(below));
            below + (upper - below) / 2.0
        }
        _ => upper,
    })
}

/// The key at place `middle` in order, and the one before it. Many keys are first counted by their upper bits:
/// only those of the bucket where the middle lies are put in order.
fn middle_two(mut keys: Vec<u32>, mut middle: usize) -> (Option<u32>, u32) {
    let mut below = None;
    if keys.len() > BUCKETS {
        let mut counts = vec![0usize; BUCKETS];
        for &key in &keys {
            counts[bucket(key)] += 1;
        }
        let (mut chosen, mut before) = (0, 0);
        while before + counts[chosen] <= middle {
            before += counts[chosen];
            chosen += 1;
        }
        // The key before the middle may be the largest of the buckets below.
        if before == middle {
            let lower = keys.iter().filter(|&&key| bucket(key) < chosen);
            below = lower.max().copied();
        }
        keys.retain(|&key| bucket(key) == chosen);
        middle -= before;
    }
    let (lower, &mut upper, _) = keys.select_nth_unstable(middle);
    (lower.iter().max().copied().or(below), upper)
}

const BUCKET_BITS: u32 = 12;

/// Buckets by the upper bits: sign, exponent and the first bits of the mantissa.
const BUCKETS: usize = 1 << BUCKET_BITS;

fn bucket(key: u32) -> usize {
    (key >> (u32::BITS - BUCKET_BITS)) as usize
}

/// An integer that orders as `f32::total_cmp` does.
fn order_key(value: f32) -> u32 {
    let bits = value.to_bits();
    if bits >> 31 == 1 {
        !bits
    } else {
        bits | 1 << 31
    }
}

fn value_of(key: u32) -> f32 {
    f32::from_bits(if key >> 31 == 1 {
        key & !(1 << 31)
    } else {
        !key
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_planes_are_those_of_numbers() {
        let value = |i: usize| ((i * 7919) % 101) as f32 * 0.37 - 12.0;
        let spread = |i: usize| libm::sin(i as f64 * 1.7) as f32 * [1e-3, 1.0, 70.0][i % 3];
        // From 4097 on by buckets: all in one, half in each of two, many in many.
        let two = |i: usize| if i.is_multiple_of(2) { 1.5 } else { -8.0 };
        let kinds: [&dyn Fn(usize) -> f32; 4] = [&value, &spread, &two, &|_| -0.0];
        let counts = [0, 1, 2, 3, 10, 101, 256, 4097, 4098, 5000, 20_001];
        for (value, count) in kinds
            .into_iter()
            .flat_map(|value| counts.map(|count| (value, count)))
        {
            let values = (0..count)
                .map(value)
                .chain([-0.0, 0.0].into_iter().take(count));
            let mut wide: Vec<f64> = values.clone().map(f64::from).collect();
            let (fast, slow) = (median_f32(values), median(&mut wide));
            assert_eq!(fast.map(f64::to_bits), slow.map(f64::to_bits), "{count}");
        }
    }

    #[test]
    fn medians() {
        assert_eq!(median(&mut []), None);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [4.0, 1.0]), Some(2.5));
        assert_eq!(median(&mut [4.0, -1.0, 9.0, 2.0, 0.0, 7.0]), Some(3.0));
    }
}
