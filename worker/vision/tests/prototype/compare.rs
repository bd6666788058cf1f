//! How far two series are apart.

use std::collections::BTreeMap;

/// Deviations of one signal, over all clips.
#[derive(Debug, Default)]
pub(crate) struct Deviations {
    by_signal: BTreeMap<&'static str, Vec<Deviation>>,
}

#[derive(Debug, Clone, Copy)]
struct Deviation {
    absolute: f64,
    relative: f64,
}

/// What is allowed: a value fits within either. One value in a hundred may be farther off: where a cell
/// is within a rounding of a threshold (ρ = 1, |F| = 1 px), it may count here and not there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tolerance {
    pub(crate) relative: f64,
    pub(crate) absolute: f64,
}

const SHARE_BEYOND: f64 = 0.01;

impl Deviations {
    /// Adds the pairs of a series, which must be defined at the same places.
    pub(crate) fn add(
        &mut self,
        clip: &str,
        signal: &'static str,
        ours: &[Option<f64>],
        theirs: &[Option<f64>],
    ) {
        assert_eq!(ours.len(), theirs.len(), "{clip}: length of {signal}");
        for (place, (ours, theirs)) in ours.iter().zip(theirs).enumerate() {
            let (ours, theirs) = match (ours, theirs) {
                (None, None) => continue,
                (Some(ours), Some(theirs)) => (ours, theirs),
                _ => panic!("{clip}: {signal} at {place} is {ours:?}, there {theirs:?}"),
            };
            let absolute = (ours - theirs).abs();
            let relative = absolute / theirs.abs().max(f64::MIN_POSITIVE);
            let deviations = self.by_signal.entry(signal).or_default();
            deviations.push(Deviation { absolute, relative });
        }
    }

    /// Prints the table and fails where a signal is beyond its tolerance.
    pub(crate) fn check(&self, tolerance: impl Fn(&str) -> Tolerance) {
        println!("signal           n   worst rel  worst abs   beyond");
        let mut failed = Vec::new();
        for (signal, deviations) in &self.by_signal {
            let allowed = tolerance(signal);
            let worst =
                |part: fn(&Deviation) -> f64| deviations.iter().map(part).fold(0.0, f64::max);
            let is_beyond = |deviation: &&Deviation| {
                deviation.relative > allowed.relative && deviation.absolute > allowed.absolute
            };
            let beyond = deviations.iter().filter(is_beyond).count();
            println!(
                "{signal:14} {:4}  {:10.2e} {:10.2e} {beyond:5}",
                deviations.len(),
                worst(|deviation| deviation.relative),
                worst(|deviation| deviation.absolute),
            );
            if beyond as f64 > SHARE_BEYOND * deviations.len() as f64 {
                failed.push(format!(
                    "{signal}: {beyond} of {} beyond {allowed:?}",
                    deviations.len()
                ));
            }
        }
        assert!(failed.is_empty(), "{failed:#?}");
    }
}

/// Spearman's rank correlation; ties get the mean of their ranks.
pub(crate) fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() + 1) as f64 / 2.0;
    let product = |a: &[f64], b: &[f64]| -> f64 {
        let pairs = a.iter().zip(b);
        pairs.map(|(x, y)| (x - mean) * (y - mean)).sum()
    };
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt()
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let rank = |value: &f64| {
        let below = values.iter().filter(|&other| other < value).count();
        let equal = values.iter().filter(|&other| other == value).count();
        below as f64 + (equal + 1) as f64 / 2.0
    };
    values.iter().map(rank).collect()
}
