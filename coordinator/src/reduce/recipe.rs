//! The signals of a row and the recipes that combine them into S_r, the relative anomaly score.
//!
//! `paper`: S_r = Σ w_k z_k over the two measures, weights by entropy (the paper's equations), for a
//! row that lacks one with the weights of the others brought back to a sum of 1. `balanced`: the
//! mean over families of the mean of the family's robust z, over those that the row has. A signal
//! that is degenerate in the corpus counts in neither. Lower is better; no unit. Nothing fails: a
//! row without any signal that counts has no score, and in a corpus in which no signal of the recipe
//! tells rows apart every score is 0.

use plumbline_common::row::Measurement;

use super::outcome::Recipe;
use super::standardise::Ruler;

/// A measured column that may enter a recipe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Signal {
    /// s_3: DROID-SLAM's (`reproj_droid_px`) where a row has it, else `reproj_px`.
    ReprojPx,
    /// s_p.
    AepeWorldscorePx,
    /// P.
    PiecewiseResidual,
    /// T.
    AppearanceRatio,
    /// accs, the lower quartile over cells.
    LayerAcceleration,
    /// Sd.
    InteriorShear,
    /// sh, the lower quartile over cells.
    DetailChange,
}

/// The paper's two measures.
pub const PAPER: [Signal; 2] = [Signal::ReprojPx, Signal::AepeWorldscorePx];

/// Families of motion-balanced signals; each family counts once, however many signals it has.
pub const BALANCED: [&[Signal]; 2] = [
    &[Signal::PiecewiseResidual, Signal::AppearanceRatio],
    &[
        Signal::LayerAcceleration,
        Signal::InteriorShear,
        Signal::DetailChange,
    ],
];

impl Signal {
    /// All signals, in column order.
    pub const ALL: [Self; 7] = [
        Self::ReprojPx,
        Self::AepeWorldscorePx,
        Self::PiecewiseResidual,
        Self::AppearanceRatio,
        Self::LayerAcceleration,
        Self::InteriorShear,
        Self::DetailChange,
    ];

    /// The column that is taken before [`column`](Self::column) in rows that have it.
    #[must_use]
    pub fn preferred_column(self) -> Option<&'static str> {
        match self {
            Self::ReprojPx => Some("reproj_droid_px"),
            _ => None,
        }
    }

    /// Column name.
    #[must_use]
    pub fn column(self) -> &'static str {
        match self {
            Self::ReprojPx => "reproj_px",
            Self::AepeWorldscorePx => "aepe_worldscore_px",
            Self::PiecewiseResidual => "piecewise_residual",
            Self::AppearanceRatio => "appearance_ratio",
            Self::LayerAcceleration => "layer_acceleration_q25",
            Self::InteriorShear => "interior_shear",
            Self::DetailChange => "detail_change_q25",
        }
    }

    /// The clip's value.
    #[must_use]
    pub fn of(self, measured: &Measurement) -> Option<f64> {
        match self {
            Self::ReprojPx => measured.reproj_droid_px.or(measured.reproj_px),
            Self::AepeWorldscorePx => measured.aepe_worldscore_px,
            Self::PiecewiseResidual => measured.piecewise_residual,
            Self::AppearanceRatio => measured.appearance_ratio,
            Self::LayerAcceleration => measured.layer_acceleration_q25,
            Self::InteriorShear => measured.interior_shear,
            Self::DetailChange => measured.detail_change_q25,
        }
    }

    /// True for the signals of steps of constant visual motion: a clip has fewer of those than pairs.
    #[must_use]
    pub fn is_per_step(self) -> bool {
        matches!(
            self,
            Self::LayerAcceleration | Self::InteriorShear | Self::DetailChange
        )
    }

    /// True for the signals that are measured by median and MAD instead of μ and σ.
    #[must_use]
    pub fn is_robust(self) -> bool {
        !matches!(self, Self::ReprojPx | Self::AepeWorldscorePx)
    }
}

/// One number per signal, in the order of [`Signal::ALL`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BySignal<T>(pub [T; Signal::ALL.len()]);

impl<T> std::ops::Index<Signal> for BySignal<T> {
    type Output = T;
    fn index(&self, signal: Signal) -> &T {
        &self.0[signal as usize]
    }
}

impl<T> std::ops::IndexMut<Signal> for BySignal<T> {
    fn index_mut(&mut self, signal: Signal) -> &mut T {
        &mut self.0[signal as usize]
    }
}

impl<T> BySignal<T> {
    /// What `make` makes of each signal.
    pub fn from_fn(make: impl FnMut(Signal) -> T) -> Self {
        Self(Signal::ALL.map(make))
    }
}

impl<T> BySignal<T> {
    /// The same where making may fail.
    ///
    /// # Errors
    /// The first failure.
    pub fn try_from_fn<E>(mut make: impl FnMut(Signal) -> Result<T, E>) -> Result<Self, E> {
        let [a, b, c, d, e, f, g] = Signal::ALL;
        Ok(Self([
            make(a)?,
            make(b)?,
            make(c)?,
            make(d)?,
            make(e)?,
            make(f)?,
            make(g)?,
        ]))
    }
}

impl BySignal<Option<f64>> {
    /// The values of a measurement.
    #[must_use]
    pub fn of(measured: &Measurement) -> Self {
        Self(Signal::ALL.map(|signal| signal.of(measured)))
    }
}

/// What one population measures its rows with: a ruler per signal, and the paper's weights.
#[derive(Debug, Clone, PartialEq)]
pub struct Yardstick {
    /// One ruler per signal.
    pub rulers: BySignal<Ruler>,
    /// Weights of [`PAPER`]; 0 for a degenerate signal; `None` where neither says anything.
    pub paper_weights: Option<[f64; PAPER.len()]>,
}

impl Yardstick {
    /// z of each signal that the row has.
    #[must_use]
    pub fn z(&self, values: &BySignal<Option<f64>>) -> BySignal<Option<f64>> {
        BySignal(Signal::ALL.map(|s| values[s].and_then(|value| self.rulers[s].z(value))))
    }

    /// True where the signal enters the recipe's score.
    #[must_use]
    pub fn counts(&self, recipe: Recipe, signal: Signal) -> bool {
        match recipe {
            Recipe::Paper => self.paper_weight(signal) > 0.0,
            Recipe::Balanced => {
                BALANCED.iter().any(|family| family.contains(&signal))
                    && self.rulers[signal].tells()
            }
        }
    }

    /// S_r of a row by its values; `None` where it has none that count.
    #[must_use]
    pub fn anomaly(&self, recipe: Recipe, values: &BySignal<Option<f64>>) -> Option<f64> {
        self.anomaly_of_z(recipe, &self.z(values))
    }

    /// S_r of a row by its z-scores; `None` where it has none that count.
    #[must_use]
    pub fn anomaly_of_z(&self, recipe: Recipe, z: &BySignal<Option<f64>>) -> Option<f64> {
        if !signals_of(recipe).any(|signal| self.counts(recipe, signal)) {
            return signals_of(recipe)
                .any(|signal| z[signal].is_some())
                .then_some(0.0);
        }
        match recipe {
            Recipe::Paper => self.weighted_sum(z),
            Recipe::Balanced => mean(BALANCED.iter().filter_map(|family| {
                mean(
                    family
                        .iter()
                        .filter(|&&s| self.counts(recipe, s))
                        .filter_map(|&s| z[s]),
                )
            })),
        }
    }

    /// Σ w z over the signals present, their weights brought to a sum of 1 where one is missing.
    fn weighted_sum(&self, z: &BySignal<Option<f64>>) -> Option<f64> {
        let (mut sum, mut weight_present, mut missing) = (0.0, 0.0, false);
        for signal in PAPER {
            let weight = self.paper_weight(signal);
            match z[signal] {
                Some(z) => {
                    sum += weight * z;
                    weight_present += weight;
                }
                None => missing = true,
            }
        }
        // Against a reference, a value may lie so far out that the sum would overflow.
        match (weight_present > 0.0, missing) {
            (false, _) => None,
            (true, false) => Some(sum),
            (true, true) => Some(sum / weight_present),
        }
        .map(|sum: f64| sum.clamp(-f64::MAX, f64::MAX))
    }

    fn paper_weight(&self, signal: Signal) -> f64 {
        let weights = self.paper_weights.unwrap_or_default();
        PAPER
            .iter()
            .zip(weights)
            .find(|&(&s, _)| s == signal)
            .map_or(0.0, |(_, weight)| weight)
    }
}

/// The signals of a recipe.
pub fn signals_of(recipe: Recipe) -> impl Iterator<Item = Signal> {
    let (paper, balanced): (&[Signal], &[&[Signal]]) = match recipe {
        Recipe::Paper => (&PAPER, &[]),
        Recipe::Balanced => (&[], &BALANCED),
    };
    paper
        .iter()
        .chain(balanced.iter().copied().flatten())
        .copied()
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0_u32);
    for value in values {
        sum += value;
        n += 1;
    }
    (n > 0).then(|| sum / f64::from(n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::moments::Moments;
    use crate::reduce::standardise::RobustStandard;

    /// μ = 2, σ = 1 for the paper's; median 3, MAD 1 for the balanced.
    fn yardstick() -> Yardstick {
        let standard = Ruler::Standard(Moments::of(&[1.0, 3.0]).unwrap().standard().unwrap());
        let robust = Ruler::Robust(RobustStandard {
            median: 3.0,
            mad: 1.0,
        });
        Yardstick {
            rulers: BySignal([standard, standard, robust, robust, robust, robust, robust]),
            paper_weights: Some([0.75, 0.25]),
        }
    }

    const NONE: Option<f64> = None;

    /// A row that lacks the last three signals.
    fn by([s3, sp, p, t]: [Option<f64>; 4]) -> BySignal<Option<f64>> {
        BySignal([s3, sp, p, t, NONE, NONE, NONE])
    }

    #[test]
    fn columns_are_indexed_in_order() {
        for (i, signal) in Signal::ALL.into_iter().enumerate() {
            assert_eq!(signal as usize, i);
        }
    }

    #[test]
    fn paper_weighs_what_a_row_has() {
        let score = |a, b| yardstick().anomaly(Recipe::Paper, &by([a, b, NONE, NONE]));
        assert_eq!(score(Some(3.0), Some(0.0)), Some(0.75 - 0.5));
        assert_eq!(score(Some(4.0), None), Some(2.0));
        assert_eq!(score(None, Some(4.0)), Some(2.0));
        assert_eq!(score(None, None), None);
    }

    #[test]
    fn balanced_is_a_mean() {
        let score = |p, t| yardstick().anomaly(Recipe::Balanced, &by([NONE, NONE, p, t]));
        assert_eq!(score(Some(4.0), Some(1.0)), Some(-0.5));
        assert_eq!(score(Some(99.0), None), Some(6.0));
        assert_eq!(score(None, None), None);
    }

    #[test]
    fn degenerate_signals_do_not_count() {
        let flat = Ruler::Standard(Moments::of(&[2.0]).unwrap().standard().unwrap());
        let mut y = yardstick();
        y.rulers[Signal::ReprojPx] = flat;
        y.paper_weights = Some([0.0, 1.0]);
        assert_eq!(
            y.anomaly(Recipe::Paper, &by([Some(2.0), Some(5.0), NONE, NONE])),
            Some(3.0)
        );
        // The only signal that the row has says nothing.
        assert_eq!(
            y.anomaly(Recipe::Paper, &by([Some(2.0), NONE, NONE, NONE])),
            None
        );
        // No signal of the recipe says anything: scores are 0, where there is a signal at all.
        y.paper_weights = None;
        assert_eq!(
            y.anomaly(Recipe::Paper, &by([Some(2.0), NONE, NONE, NONE])),
            Some(0.0)
        );
        assert_eq!(y.anomaly(Recipe::Paper, &by([NONE; 4])), None);
    }
}
