//! A piece of rows, completed: what the statistics and the places make of each row.

use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, StringArray};
use arrow_select::filter::filter_record_batch;

use super::made::Made;
use super::tables::Tables;
use super::{Completion, Piece};
use crate::publish::manifests::DECISIONS;
use crate::reduce::recipe::{BySignal, Signal, signals_of};
use crate::reduce::recipe_name;
use crate::reduce::tally::{Facts, Tally};
use crate::reduce_files::error::ReduceFilesError;
use crate::reduce_files::intake::NO_GROUP;
use crate::reduce_files::places::decision;
use crate::reduce_files::rows::{Checked, float_at, floats, shape_at};
use crate::reduce_files::scoring::Signals;
use crate::reduce_files::trainer_lists::Lists;

impl Completion<'_> {
    /// What some rows come to, in every table; the first of them is row `first_row` of all.
    pub(super) fn complete(
        &self,
        tables: &Tables,
        checked: Checked,
        first_row: u64,
        paths: Option<StringArray>,
        tally: &mut Tally,
        lists: &mut Lists<'_>,
    ) -> Result<Piece, ReduceFilesError> {
        let rows = checked.batch.num_rows();
        let recipe = self.options.recipe;
        let mut signals = Signals::of_rows(&checked);
        signals.read_groups(self.groups, first_row, rows)?;
        let Checked {
            batch,
            statuses,
            rejected,
        } = checked;
        let mut anomalies = vec![f64::NAN; rows];
        self.anomalies
            .read(first_row, &mut anomalies, &mut Vec::new())?;
        let places = self.places.read(first_row, &signals.groups)?;

        let old = ["anomaly", "anomaly_lo", "anomaly_hi"].map(|name| floats(&batch, name));
        let group_names = self.groups.map_or(&[][..], |groups| &groups.names);
        let mut z: BySignal<Vec<Option<f64>>> = BySignal::from_fn(|_| Vec::with_capacity(rows));
        let mut intervals = Vec::with_capacity(rows);
        let mut decisions = Vec::with_capacity(rows);
        let mut rejected = rejected.into_iter().peekable();
        let mut last_cut = None;
        for row in 0..rows {
            let group = signals.groups[row];
            let values = signals.of(row);
            let of_row = self.yardsticks.of_group(group).z(&values);
            for signal in Signal::ALL {
                z[signal].push(of_row[signal]);
            }
            let anomaly = Some(anomalies[row]).filter(|anomaly| !anomaly.is_nan());
            // The interval belongs to the score as it was: it stands where that has not changed.
            let same = anomaly.is_some_and(|a| {
                float_at(old[0], row).is_some_and(|old| old.to_bits() == a.to_bits())
            });
            let interval = float_at(old[1], row)
                .zip(float_at(old[2], row))
                .filter(|_| same);
            let decision = decision(places[row].as_ref(), anomalies[row], &self.options.keep);
            let cut = match last_cut {
                Some((of, cut)) if of == group => cut,
                _ => self.places.cuts.cut(&group, &self.options.keep),
            };
            last_cut = Some((group, cut));
            tally.note(&Facts {
                status: statuses[row],
                group: group_names.get(group as usize).map(String::as_str),
                anomaly,
                interval,
                lacks_signal: signals_of(recipe).any(|signal| values[signal].is_none()),
                shape: if group == NO_GROUP {
                    None
                } else {
                    shape_at(&batch, row)
                },
                decision,
                rejected: rejected.next_if_eq(&row).is_some(),
                cut,
            });
            intervals.push(interval);
            decisions.push(decision);
        }

        let made = Made {
            z: BySignal(z.0.map(|z| Arc::new(Float64Array::from(z)) as ArrayRef)),
            anomalies: anomalies
                .iter()
                .map(|&a| Some(a).filter(|a| !a.is_nan()))
                .collect(),
            intervals,
            places: &places,
            decisions: &decisions,
            paths: paths.map(|paths| Arc::new(paths) as ArrayRef),
            groups: signals
                .groups
                .iter()
                .map(|&g| group_names.get(g as usize))
                .collect(),
            recipe: recipe_name(recipe),
            options: self.options,
        };
        let failed = |error| ReduceFilesError::Encode(arrow_schema::ArrowError::into(error));
        let scores = made.scores(tables, &batch).map_err(failed)?;
        let (full, rewards) = (
            made.manifest(tables, &scores).map_err(failed)?,
            made.rewards(tables, &scores, self.rewards)
                .map_err(failed)?,
        );
        lists.note(&scores, &decisions, &made.anomalies, self.rewards)?;
        let mut manifests = Vec::with_capacity(DECISIONS.len());
        for decision in DECISIONS {
            let mask: BooleanArray = decisions.iter().map(|&d| Some(d == decision)).collect();
            manifests.push(filter_record_batch(&full, &mask).map_err(failed)?);
        }
        Ok(Piece {
            scores,
            manifests: manifests.try_into().map_err(|_| ReduceFilesError::Thread)?,
            rewards,
        })
    }
}
