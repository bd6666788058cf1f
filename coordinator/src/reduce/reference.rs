//! Frozen corpus statistics: what a single video, or a stream of them, is scored against (design
//! section 8, reference mode).
//!
//! Everything that a score is made of is frozen: per signal the ruler (μ in two floats and σ; median
//! and MAD) and the paper's weights with the histograms behind them; and per recipe the scores of the
//! reference's own rows, which percentiles and soft rewards are taken from. Scored against its own
//! reference, a corpus gets the bits that it gets by itself. Only reading values can fail.

#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;
use std::num::NonZeroU16;

use serde::{Deserialize, Serialize};

use super::distribution::Distribution;
use super::drift::{Comparison, drift};
use super::moments::Standard;
use super::outcome::{Population, Range, Recipe};
use super::population::Surveyed;
use super::recipe::{BySignal, PAPER, Signal, Yardstick};
use super::rewards::Spread;
use super::select::Standing;
use super::standardise::Ruler;
use super::tally::tells_nothing;
use super::values::Values;
use super::{ReduceOptions, recipe_name};

/// The statistics as they are written down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frozen {
    /// Digest of the profile that measured the rows; absent where they do not say.
    pub profile_digest: Option<String>,
    /// Histogram bins behind the entropies.
    pub bins: NonZeroU16,
    /// Histogram range behind them.
    pub range: Range,
    /// Statistics, histograms and weights, as `corpus.json` has them.
    pub population: Population,
    /// What z-scores are taken with, by column name.
    pub rulers: BTreeMap<String, Ruler>,
    /// Each signal's distribution, by column name.
    pub signals: BTreeMap<String, Distribution>,
    /// The reference's own scores, by recipe; a recipe that none of its signals bears out is absent.
    pub scores: BTreeMap<String, FrozenScores>,
}

/// The scores of one recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrozenScores {
    /// Mean of S_r.
    pub mean: f64,
    /// Population σ of S_r.
    pub std: f64,
    /// S_r.
    pub distribution: Distribution,
}

impl FrozenScores {
    /// Mean and spread of the rewards −S_r.
    #[must_use]
    pub fn rewards(&self) -> Spread {
        Spread {
            mean: 0.0 - self.mean,
            std: self.std,
        }
    }
}

impl Frozen {
    /// Freezes a population that was surveyed with bins, range and profile of `options`; `scores` gives the scores of its rows by a recipe, and mean and
    /// spread of the rewards.
    ///
    /// # Errors
    /// Where values cannot be read.
    pub fn freeze<V: Values, E: From<V::Error>>(
        surveyed: &Surveyed,
        signals: &BySignal<V>,
        options: &ReduceOptions,
        scores: &mut dyn FnMut(Recipe) -> Result<(V, Option<Standard>), E>,
    ) -> Result<Self, E> {
        let mut frozen = Self {
            profile_digest: Some(options.profile_digest.clone())
                .filter(|digest| !digest.is_empty()),
            bins: options.bins,
            range: options.range,
            population: surveyed.population.clone(),
            rulers: BTreeMap::new(),
            signals: BTreeMap::new(),
            scores: BTreeMap::new(),
        };
        for signal in Signal::ALL {
            let name = signal.column().to_owned();
            let ruler = surveyed.yardstick.rulers[signal];
            frozen.rulers.insert(name.clone(), ruler);
            let distribution = Distribution::of(&signals[signal])?;
            frozen.signals.insert(name, distribution);
        }
        for recipe in [Recipe::Paper, Recipe::Balanced] {
            if tells_nothing(&frozen.population, recipe) {
                continue;
            }
            if let (values, Some(rewards)) = scores(recipe)? {
                let of_recipe = FrozenScores {
                    mean: 0.0 - rewards.mean,
                    std: rewards.std,
                    distribution: Distribution::of(&values)?,
                };
                frozen
                    .scores
                    .insert(recipe_name(recipe).to_owned(), of_recipe);
            }
        }
        Ok(frozen)
    }

    /// What is wrong with statistics that no freeze wrote.
    fn flaw(&self) -> Option<String> {
        for signal in Signal::ALL {
            let name = signal.column();
            let (Some(ruler), Some(distribution)) = (self.rulers.get(name), self.signals.get(name))
            else {
                return Some(format!("{name} is missing"));
            };
            if !ruler.is_usable() || !distribution.is_consistent() {
                return Some(format!("the statistics of {name} make no sense"));
            }
        }
        let scores = self.scores.values();
        let sound = |s: &FrozenScores| {
            s.mean.is_finite()
                && s.std.is_finite()
                && s.std >= 0.0
                && s.distribution.is_consistent()
        };
        if !scores.clone().all(sound) {
            return Some("the scores make no sense".to_owned());
        }
        let weights = || {
            PAPER
                .iter()
                .filter_map(|s| self.population.weights.get(s.column()))
        };
        if weights().any(|weight| !(0.0..=1.0).contains(weight)) {
            return Some("the weights make no sense".to_owned());
        }
        None
    }
}

/// A reference in use.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    frozen: Frozen,
    yardstick: Yardstick,
    digest: String,
}

impl Reference {
    /// Puts frozen statistics to use; `digest` names them.
    ///
    /// # Errors
    /// What is wrong with them, where they make no sense.
    pub fn new(frozen: Frozen, digest: String) -> Result<Self, String> {
        if let Some(flaw) = frozen.flaw() {
            return Err(flaw);
        }
        let ruler = |signal: Signal| frozen.rulers.get(signal.column()).copied();
        let weight = |signal: Signal| frozen.population.weights.get(signal.column()).copied();
        let [a, b] = PAPER.map(weight);
        let yardstick = Yardstick {
            rulers: BySignal::from_fn(|signal| ruler(signal).unwrap_or(Ruler::Absent)),
            paper_weights: a.zip(b).map(|(a, b)| [a, b]),
        };
        Ok(Self {
            frozen,
            yardstick,
            digest,
        })
    }

    /// The statistics.
    #[must_use]
    pub fn frozen(&self) -> &Frozen {
        &self.frozen
    }

    /// What rows are measured with.
    #[must_use]
    pub fn yardstick(&self) -> &Yardstick {
        &self.yardstick
    }

    /// The reference's own scores by a recipe; `None` for a recipe that it cannot score by.
    #[must_use]
    pub fn scores(&self, recipe: Recipe) -> Option<&FrozenScores> {
        self.frozen.scores.get(recipe_name(recipe))
    }

    /// Where a score stands among the reference's own.
    #[must_use]
    pub fn standing(&self, recipe: Recipe, anomaly: f64) -> Option<Standing> {
        let scores = &self.scores(recipe)?.distribution;
        Some(Standing {
            better: scores.count_below(anomaly),
            of: scores.n,
        })
    }

    /// How a corpus that was scored against it compares.
    ///
    /// # Errors
    /// Where values cannot be read.
    pub fn compare<V: Values>(
        &self,
        recipe: Recipe,
        signals: &BySignal<V>,
        anomalies: &V,
    ) -> Result<Comparison, V::Error> {
        let mut found = BTreeMap::new();
        for signal in Signal::ALL {
            if let Some(distribution) = self.frozen.signals.get(signal.column()) {
                let shift = drift(distribution, &signals[signal])?;
                found.insert(signal.column().to_owned(), shift);
            }
        }
        if let Some(scores) = self.scores(recipe) {
            let shift = drift(&scores.distribution, anomalies)?;
            found.insert("anomaly".to_owned(), shift);
        }
        Ok(Comparison {
            digest: self.digest.clone(),
            n: self.frozen.population.n,
            weights: self.frozen.population.weights.clone(),
            drift: found,
        })
    }
}
