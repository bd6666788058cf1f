//! The statistics beside a twin of 300 bits (`dashu-float`), on extreme and on random corpora.
//!
//! The twin sums exactly (unlimited precision), then divides, takes roots, logarithms and
//! exponentials at 300 bits. Bounds, in units in the last place (ulp) of the result: μ, σ, H and w 2;
//! z and S_r 4 times their condition number. For z that is max(|s|, |μ|)/(σ|z|), never taken below 1;
//! for S_r it is Σ w|z|·condition(z)/|S_r|. Robust z: the same with median and MAD, where the median,
//! being a float, adds its own half ulp to the MAD.
//!
//! The hand-made corpora ([`extremes`]), each with bins 1, 2 and 30: n = 1 and 2; constants (0, −0,
//! the smallest float, the largest, 0.1 seven times); two values; denormals (alone, with 0, with
//! normal ones, 40 steps); around 2^−1022; 1e±300 alone, mixed, of both signs; one outlier at 1e300,
//! 1e16, 10 in a constant or spread corpus; 1e15 + eighths, 1e15 + one eighth, −1e15, 1e12 + 1e-4,
//! 2^53 and its neighbours; sums that cancel (±1e300 with 1, ±MAX with 1e-300); max − min beyond the
//! largest float; squares beyond it and below the smallest; values one ulp apart; σ below half the
//! smallest float; every bin 1/n; one bin but one value; powers of two from 2^−1074 to 2^1023;
//! decimal fractions; both halves equal. n = 0, NaN and infinities, and softmax of huge |H| have
//! tests of their own below.

mod extremes;

use std::num::NonZeroU16;

use dashu_float::FBig;
use dashu_float::ops::SquareRoot;
use dashu_float::round::mode::HalfEven;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

use extremes::extremes;

use super::double::Double;
use super::outcome::{Range, Recipe};
use super::population::{Surveyed, in_memory};
use super::recipe::{BySignal, PAPER, Signal};
use super::weights::{entropy, softmax_of_negated};

fn survey(rows: &[BySignal<Option<f64>>], bins: NonZeroU16, range: Range) -> Surveyed {
    let Ok(found) = super::population::survey(rows.len() as u64, &in_memory(rows), bins, range);
    found
}

type Big = FBig<HalfEven, 2>;

const BITS: usize = 300;
const RANDOM_CORPORA: u64 = 10_000;

/// Exact, and so is what is added to, subtracted from or multiplied by it.
fn exact(value: f64) -> Big {
    Big::try_from(value).unwrap().with_precision(0).value()
}

/// To [`BITS`] bits, as divisions, roots and logarithms need it.
fn rounded(value: Big) -> Big {
    // By way of a larger one: a sum may have kept a bit more than its precision, which is only cut
    // where the precision falls.
    value
        .with_precision(2 * BITS)
        .value()
        .with_precision(BITS)
        .value()
}

fn big(value: f64) -> Big {
    rounded(exact(value))
}

fn magnitude(value: &Big) -> Big {
    if *value < Big::ZERO {
        -value.clone()
    } else {
        value.clone()
    }
}

/// The unit in the last place of a float.
fn ulp(value: f64) -> Big {
    let exponent = ((value.to_bits() >> 52) & 0x7FF).max(1) as isize - 1075;
    Big::from_parts(1.into(), exponent)
}

/// How many units in its last place a float is off.
fn ulps_off(found: f64, twin: &Big) -> f64 {
    let difference = magnitude(&(exact(found) - twin.clone()));
    quotient(&difference, &ulp(found)).to_f64().value()
}

/// `|found − twin| ≤ bound`, with the numbers where it is not.
fn assert_ulps(found: f64, twin: &Big, bound: f64, what: &str) {
    let off = ulps_off(found, twin);
    assert!(
        off <= bound,
        "{what}: {found:e} is {off} ulp off, {bound} allowed"
    );
}

fn quotient(a: &Big, b: &Big) -> Big {
    rounded(a.clone()) / rounded(b.clone())
}

struct Twin {
    mean: Big,
    std: Big,
}

impl Twin {
    fn of(values: &[f64]) -> Self {
        let n = Big::from(values.len() as u64).with_precision(0).value();
        let sum = values.iter().fold(exact(0.0), |sum, &v| sum + exact(v));
        let squares = values
            .iter()
            .fold(exact(0.0), |sum, &v| sum + exact(v) * exact(v));
        let spread = rounded(squares * n.clone() - sum.clone() * sum.clone());
        let n = rounded(n);
        let variance = quotient(&spread, &(n.clone() * n.clone()));
        Self {
            mean: quotient(&sum, &n),
            std: if variance == Big::ZERO {
                variance
            } else {
                variance.sqrt()
            },
        }
    }

    fn z(&self, value: f64) -> Big {
        quotient(&(big(value) - self.mean.clone()), &self.std)
    }

    /// max(|s|, |μ|)/(σ|z|), at least 1, times |z|: what rounding of s and μ may do to z.
    fn weighty(&self, value: f64) -> Big {
        let (s, mean) = (magnitude(&big(value)), magnitude(&self.mean));
        let scaled = quotient(if s > mean { &s } else { &mean }, &self.std);
        let z = magnitude(&self.z(value));
        if scaled > z { scaled } else { z }
    }
}

/// `found` within 4 ulp times its condition number of `twin`, `weighty` being |twin|·condition.
fn assert_conditioned(found: f64, twin: &Big, weighty: &Big, what: &str) {
    // An ulp is between 2^−53 and 2^−52 of a number; the relative form covers a twin of zero too.
    let off = magnitude(&(exact(found) - twin.clone()));
    let relative = rounded(weighty.clone()) * Big::from_parts(1.into(), -52);
    let allowed = rounded(relative + rounded(ulp(0.0))) * Big::from(4_u8);
    assert!(
        rounded(off.clone()) <= allowed,
        "{what}: {found:e}, off by {}, {} allowed",
        off.to_f64().value(),
        allowed.to_f64().value()
    );
}

fn twin_entropy(counts: &[u64]) -> Big {
    let n: u64 = counts.iter().sum();
    let mut by_count = std::collections::BTreeMap::new();
    for &count in counts.iter().filter(|&&count| count > 0) {
        *by_count.entry(count).or_insert(0_u64) += 1;
    }
    let mut sum = big(0.0);
    for (count, bins) in by_count {
        let p = quotient(&Big::from(count), &Big::from(n));
        sum -= rounded(Big::from(bins)) * p.clone() * p.ln();
    }
    sum
}

fn twin_softmax(entropies: &[Big]) -> Vec<Big> {
    let least = entropies.iter().min().unwrap().clone();
    let powers: Vec<Big> = entropies
        .iter()
        .map(|h| (least.clone() - h.clone()).exp())
        .collect();
    let total = powers.iter().fold(big(0.0), |sum, p| sum + p.clone());
    powers.iter().map(|p| quotient(p, &total)).collect()
}

/// Compares everything that a corpus of the paper's two signals comes to.
fn compare(name: &str, signals: [&[f64]; 2], bins: u16) {
    let rows: Vec<BySignal<Option<f64>>> = (0..signals[0].len())
        .map(|i| {
            let mut row = BySignal::default();
            for (signal, values) in PAPER.iter().zip(signals) {
                row[*signal] = values.get(i).copied();
            }
            row
        })
        .collect();
    let found = survey(&rows, NonZeroU16::new(bins).unwrap(), Range::Full);
    let twins = signals.map(Twin::of);
    let mut entropies = Vec::new();
    for ((signal, twin), values) in PAPER.iter().zip(&twins).zip(signals) {
        let statistics = &found.population.signals[signal.column()];
        let name = format!("{name}, {bins} bins, {}", signal.column());
        assert_ulps(
            statistics.mean.unwrap(),
            &twin.mean,
            2.0,
            &format!("{name}: mean"),
        );
        assert_ulps(
            statistics.std.unwrap(),
            &twin.std,
            2.0,
            &format!("{name}: std"),
        );
        let h = twin_entropy(&statistics.counts);
        assert_ulps(
            statistics.entropy_nats.unwrap(),
            &h,
            2.0,
            &format!("{name}: entropy"),
        );
        assert_eq!(statistics.counts.iter().sum::<u64>(), values.len() as u64);
        let tells = statistics.std.unwrap() > 0.0;
        assert_eq!(statistics.degenerate, !tells);
        entropies.push(tells.then_some(h));
    }
    let telling: Vec<Big> = entropies.iter().flatten().cloned().collect();
    assert_eq!(found.yardstick.paper_weights.is_none(), telling.is_empty());
    let mut shares = if telling.is_empty() {
        Vec::new()
    } else {
        twin_softmax(&telling)
    }
    .into_iter();
    let weights: Vec<Big> = entropies
        .iter()
        .map(|h| h.as_ref().and_then(|_| shares.next()).unwrap_or(Big::ZERO))
        .collect();
    for (weight, found) in weights
        .iter()
        .zip(found.yardstick.paper_weights.unwrap_or_default())
    {
        assert_ulps(found, weight, 2.0, &format!("{name}, {bins} bins: weight"));
    }

    for row in rows
        .iter()
        .filter(|row| row[PAPER[0]].is_some() && row[PAPER[1]].is_some())
    {
        let z = found.yardstick.z(row);
        let (mut score, mut weighty) = (big(0.0), big(0.0));
        for ((&signal, twin), weight) in PAPER.iter().zip(&twins).zip(&weights) {
            let (Some(value), Some(z)) = (row[signal], z[signal]) else {
                continue;
            };
            if found.population.signals[signal.column()].degenerate {
                assert_eq!(z.to_bits(), 0, "{name}: a signal without spread has z = 0");
                continue;
            }
            assert_conditioned(
                z,
                &twin.z(value),
                &twin.weighty(value),
                &format!("{name}: z of {value:e}"),
            );
            score += weight.clone() * twin.z(value);
            weighty += weight.clone() * twin.weighty(value);
        }
        let anomaly = found.yardstick.anomaly(Recipe::Paper, row).unwrap();
        assert_conditioned(anomaly, &score, &weighty, &format!("{name}: S_r"));
    }
    compare_robust(name, signals[0]);
}

/// Median, MAD and robust z of the same values.
fn compare_robust(name: &str, values: &[f64]) {
    let signal = Signal::PiecewiseResidual;
    let rows: Vec<BySignal<Option<f64>>> = values
        .iter()
        .map(|&value| {
            let mut row = BySignal::default();
            row[signal] = Some(value);
            row
        })
        .collect();
    let found = survey(&rows, NonZeroU16::MIN, Range::Full);
    let statistics = &found.population.signals[signal.column()];
    let middle = |mut sorted: Vec<Big>| {
        sorted.sort();
        let n = sorted.len();
        (sorted[n / 2].clone() + sorted[(n - 1) / 2].clone()) * big(0.5)
    };
    let median = middle(values.iter().map(|&v| big(v)).collect());
    assert_ulps(
        statistics.median.unwrap(),
        &median,
        2.0,
        &format!("{name}: median"),
    );
    let mad = middle(
        values
            .iter()
            .map(|&v| magnitude(&(big(v) - median.clone())))
            .collect(),
    );
    if mad > exact(f64::MAX) {
        return; // A deviation beyond the largest float counts as that (`standardise`).
    }
    // The rounded median moves every deviation by up to half its ulp.
    let slack = rounded(ulp(statistics.median.unwrap()) + ulp(statistics.mad.unwrap()));
    assert!(
        magnitude(&(big(statistics.mad.unwrap()) - mad.clone())) <= slack,
        "{name}: MAD"
    );
    if statistics.degenerate {
        return;
    }
    for row in &rows {
        let (value, z) = (
            big(row[signal].unwrap()),
            found.yardstick.z(row)[signal].unwrap(),
        );
        let exact_z = quotient(&(value.clone() - median.clone()), &mad).clamp(big(-3.0), big(6.0));
        let relative_mad = quotient(&slack, &mad);
        let weighty =
            quotient(&(magnitude(&value) + magnitude(&median)), &mad) + magnitude(&exact_z);
        let allowed = weighty * Big::from_parts(1.into(), -51)
            + (magnitude(&exact_z) + big(1.0)) * relative_mad * big(2.0);
        assert!(
            magnitude(&(big(z) - exact_z)) <= rounded(allowed + rounded(ulp(0.0))),
            "{name}: robust z {z:e}"
        );
    }
}

#[test]
fn hand_made_extremes() {
    let corpora = extremes();
    assert!(corpora.len() >= 60);
    for (i, (name, values)) in corpora.iter().enumerate() {
        // The other signal is the next corpus, as far as it goes: weights and sums of every mixture.
        let other = &corpora[(i + 7) % corpora.len()].1;
        for bins in [1, 2, 30] {
            compare(name, [values, values], bins);
            compare(
                name,
                [
                    values,
                    &other
                        .iter()
                        .copied()
                        .cycle()
                        .take(values.len())
                        .collect::<Vec<_>>(),
                ],
                bins,
            );
        }
    }
}

/// Spreads and offsets over the whole range of floats: value = offset + spread·u with u uniform,
/// cubed (heavy at 0) or with a long tail, spread = 2^±1000, offset 0 or up to 2^50 spreads.
#[test]
fn random_corpora() {
    let mut rng = Pcg64::from_seed([11; 32]);
    let mut below = |n: u64| ((u128::from(rng.next_u64()) * u128::from(n)) >> 64) as u64;
    for k in 0..RANDOM_CORPORA {
        let n = 1 + below(9) as usize;
        let mut signal = || {
            let spread = below(2001) as i32 - 1000;
            let offset = match below(3) {
                0 => 0.0,
                _ => libm::scalbn(below(1 << 50) as f64, -(below(50) as i32)),
            };
            let shape = below(4);
            (0..n)
                .map(|_| {
                    let u = below(1 << 53) as f64 / (1_u64 << 52) as f64 - 1.0;
                    let u = match shape {
                        0 => u,
                        1 => u * u * u,
                        2 => (u * 4.0).round(),
                        _ => u / (u * u + 1e-3),
                    };
                    libm::scalbn(offset + u, spread).clamp(-f64::MAX, f64::MAX)
                })
                .collect::<Vec<f64>>()
        };
        let (a, b) = (signal(), signal());
        let bins = [1, 2, 5, 30, 30, 64][below(6) as usize];
        compare(&format!("random corpus {k}"), [&a, &b], bins);
    }
}

/// Counts of a large corpus, where p and 1 − p have lost digits.
#[test]
fn entropies_of_large_counts() {
    for counts in [
        &[9_999_999, 1][..],
        &[1, 9_999_999],
        &[5_000_001, 4_999_999],
        &[1 << 40, 1, 3],
        &[1, 2, 4, 8, 16, 32, 64, 128, 256, 512],
        &[7; 30],
        &[1; 65_535],
        &[123_456_789, 1, 0, 0, 987_654_321, 17],
    ] {
        let found = entropy(counts).unwrap().value();
        assert_ulps(
            found,
            &twin_entropy(counts),
            2.0,
            &format!("{:?}", &counts[..2]),
        );
    }
}

#[test]
fn softmax_of_huge_and_close_entropies() {
    for entropies in [
        &[1e308, 1e308][..],
        &[-1e308, 1e308],
        &[1e-308, 0.0],
        &[700.0, 0.0],
        &[745.0, 0.0],
        &[1e4, 1e4 + 1e-9],
        &[1e15, 1e15 + 0.125],
        &[3.4, 3.4_f64.next_up()],
        &[0.0, 1e-17],
        &[0.0; 65],
    ] {
        let found = softmax_of_negated(
            &entropies
                .iter()
                .copied()
                .map(Double::from)
                .collect::<Vec<_>>(),
        );
        // exp of −2e308 has no place even in the twin; it is 0.
        if entropies == [-1e308, 1e308] {
            assert_eq!(found, [1.0, 0.0]);
            continue;
        }
        let twins = twin_softmax(&entropies.iter().copied().map(big).collect::<Vec<_>>());
        for (found, twin) in found.into_iter().zip(twins) {
            assert_ulps(found, &twin, 2.0, &format!("{entropies:?}"));
        }
    }
}

/// n = 0 has no statistics; NaN and infinities never reach one.
#[test]
fn nothing_and_what_is_no_number() {
    let found = survey(&[], NonZeroU16::MIN, Range::Full);
    let statistics = &found.population.signals[PAPER[0].column()];
    assert_eq!(
        (statistics.n, statistics.mean, statistics.entropy_nats),
        (0, None, None)
    );
    assert_eq!(found.yardstick.paper_weights, None);
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(super::moments::Moments::of(&[1.0, value]).is_err());
        let mut measured = plumbline_common::row::Measurement::without_score(
            plumbline_common::row::Status::Scored,
            "",
        );
        measured.reproj_px = Some(value);
        assert!(super::reject::reject_non_finite(&mut measured));
        assert_eq!(measured.reproj_px, None);
    }
}
