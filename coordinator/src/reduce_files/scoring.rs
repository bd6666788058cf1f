//! The second pass: every row's score, from its signals and the statistics of its population.

use std::collections::BTreeMap;
use std::path::Path;

use super::error::{ReduceFilesError, joined};
use super::float_file::{FloatFile, shares};
use super::intake::{GroupFile, Intake, NO_GROUP};
use super::rows::Checked;
use crate::reduce::ReduceOptions;
use crate::reduce::moments::{Moments, Standard};
use crate::reduce::outcome::NormaliseWithin;
use crate::reduce::population::Surveyed;
use crate::reduce::recipe::{BySignal, Signal, Yardstick};
use crate::reduce::rewards::reward;

/// Which statistics a row is scored with.
pub(super) struct Yardsticks<'a> {
    corpus: &'a Yardstick,
    /// By group number.
    groups: Vec<Option<&'a Yardstick>>,
}

impl<'a> Yardsticks<'a> {
    pub(super) fn of(
        corpus: &'a Surveyed,
        groups: &'a BTreeMap<String, Surveyed>,
        intake: &Intake,
        options: &'a ReduceOptions,
    ) -> Self {
        let own = options.normalise_within == NormaliseWithin::Group && options.reference.is_none();
        let names = intake
            .groups
            .as_ref()
            .filter(|_| own)
            .map_or(&[][..], |groups| &groups.names);
        Self {
            corpus: options.yardstick(&corpus.yardstick),
            groups: names
                .iter()
                .map(|name| groups.get(name).map(|g| &g.yardstick))
                .collect(),
        }
    }

    pub(super) fn of_group(&self, group: u32) -> &Yardstick {
        self.groups
            .get(group as usize)
            .copied()
            .flatten()
            .unwrap_or(self.corpus)
    }
}

/// The signals of some rows, and their groups.
#[derive(Default)]
pub(super) struct Signals {
    columns: BySignal<Vec<f64>>,
    pub(super) groups: Vec<u32>,
    bytes: Vec<u8>,
}

impl Signals {
    /// Those of rows at hand, without their groups.
    pub(super) fn of_rows(rows: &Checked) -> Self {
        Self {
            columns: BySignal::from_fn(|signal| rows.signal(signal)),
            ..Self::default()
        }
    }

    /// Reads `rows` rows from a row on.
    fn read(&mut self, intake: &Intake, row: u64, rows: usize) -> Result<(), ReduceFilesError> {
        for signal in Signal::ALL {
            self.columns[signal].resize(rows, f64::NAN);
            intake.signals[signal].read(row, &mut self.columns[signal], &mut self.bytes)?;
        }
        self.read_groups(intake.groups.as_ref(), row, rows)
    }

    /// Reads the groups of `rows` rows from a row on.
    pub(super) fn read_groups(
        &mut self,
        groups: Option<&GroupFile>,
        row: u64,
        rows: usize,
    ) -> Result<(), ReduceFilesError> {
        self.groups.clear();
        self.groups.resize(rows, NO_GROUP);
        if let Some(groups) = groups {
            groups.read(row, &mut self.groups)?;
        }
        Ok(())
    }

    /// The values of one of them.
    pub(super) fn of(&self, row: usize) -> BySignal<Option<f64>> {
        BySignal::from_fn(|signal| Some(self.columns[signal][row]).filter(|value| !value.is_nan()))
    }
}

/// Scores by row index, NaN for a row without one, and the mean and spread of the rewards.
pub(super) fn score(
    intake: &Intake,
    yardsticks: &Yardsticks<'_>,
    options: &ReduceOptions,
    scratch: &Path,
    threads: usize,
) -> Result<(FloatFile, Option<Standard>), ReduceFilesError> {
    const ROWS: u64 = 1 << 15;
    let anomalies = FloatFile::create(scratch, intake.rows, threads)?;
    let share = |rows: std::ops::Range<u64>| -> Result<Moments, ReduceFilesError> {
        let mut rewards = Moments::default();
        let mut signals = Signals::default();
        let mut scores = Vec::new();
        let mut row = rows.start;
        while row < rows.end {
            let n = (rows.end - row).min(ROWS) as usize;
            signals.read(intake, row, n)?;
            scores.clear();
            for k in 0..n {
                let yardstick = yardsticks.of_group(signals.groups[k]);
                let anomaly = yardstick.anomaly(options.recipe, &signals.of(k));
                if let Some(anomaly) = anomaly {
                    // Finite, hence never refused.
                    let _ = rewards.add(reward(anomaly));
                }
                scores.push(anomaly.unwrap_or(f64::NAN));
            }
            anomalies.write(row, &scores)?;
            row += n as u64;
        }
        Ok(rewards)
    };
    let mut rewards = Moments::default();
    std::thread::scope(|scope| {
        let share = &share;
        let running: Vec<_> = shares(intake.rows, threads)
            .into_iter()
            .map(|rows| scope.spawn(move || share(rows)))
            .collect();
        for shared in running {
            rewards.merge(&joined(shared.join())?);
        }
        Ok::<_, ReduceFilesError>(())
    })?;
    Ok((anomalies, rewards.standard()))
}
