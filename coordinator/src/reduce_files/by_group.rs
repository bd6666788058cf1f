//! The statistics of each group, without holding more than a few groups in memory.
//!
//! Groups are gathered into buckets of at most so many rows (a larger group has one of its own); each
//! signal is distributed into one scratch file with a section per bucket, and the buckets are surveyed
//! one by one.

use std::collections::BTreeMap;
use std::path::Path;

use super::ReduceFilesOptions;
use super::error::ReduceFilesError;
use super::float_file::FloatFile;
use super::intake::{GroupFile, Intake, NO_GROUP};
use crate::reduce::population::{Surveyed, survey};
use crate::reduce::recipe::{BySignal, Signal};
use crate::reduce::values::InMemory;

/// Values gathered per bucket before they are written.
const BUFFERED: usize = 4096;

/// Groups that are surveyed together.
#[derive(Debug, Default)]
struct Bucket {
    /// Their numbers.
    groups: Vec<u32>,
    rows: u64,
}

/// Surveys every group with a scored row, by name.
pub(super) fn survey_groups(
    intake: &Intake,
    options: &ReduceFilesOptions,
    scratch: &Path,
) -> Result<BTreeMap<String, Surveyed>, ReduceFilesError> {
    let Some(groups) = &intake.groups else {
        return Ok(BTreeMap::new());
    };
    let buckets = Distribution::of(groups, options.budget.bucket_rows);
    let signals = BySignal::try_from_fn(|signal| {
        let file = FloatFile::create(scratch, buckets.rows, options.threads)?;
        let values = &intake.signals[signal];
        buckets.distribute(groups, values, &file, &|_, value| value)?;
        Ok::<_, ReduceFilesError>(file)
    })?;
    let members = FloatFile::create(scratch, buckets.rows, options.threads)?;
    let any = &intake.signals[Signal::ReprojPx];
    buckets.distribute(groups, any, &members, &|group, _| f64::from(group))?;

    let mut found = BTreeMap::new();
    let mut row = 0;
    for bucket in &buckets.buckets {
        let rows = row..row + bucket.rows;
        row = rows.end;
        let signals = BySignal::from_fn(|signal| signals[signal].section(rows.clone()));
        let mut insert = |group: u32, surveyed: Surveyed| {
            found.insert(groups.names[group as usize].clone(), surveyed);
        };
        if let [only] = bucket.groups.as_slice() {
            let n = groups.scored[*only as usize];
            insert(
                *only,
                survey(n, &signals, options.reduce.bins, options.reduce.range)?,
            );
            continue;
        }
        let mut numbers = Vec::with_capacity(bucket.rows as usize);
        members.section(rows).pieces(0..bucket.rows, |_, piece| {
            numbers.extend(piece.iter().map(|&number| number as u32));
            Ok(())
        })?;
        let mut apart: BTreeMap<u32, BySignal<Vec<f64>>> = BTreeMap::new();
        for signal in Signal::ALL {
            signals[signal].pieces(0..bucket.rows, |row, piece| {
                for (number, &value) in numbers[row as usize..].iter().zip(piece.iter()) {
                    apart.entry(*number).or_default()[signal].push(value);
                }
                Ok(())
            })?;
        }
        for &group in &bucket.groups {
            let values = apart.remove(&group).unwrap_or_default();
            let values: BySignal<InMemory> = BySignal(values.0.map(InMemory::from_iter));
            let n = groups.scored[group as usize];
            let Ok(surveyed) = survey(n, &values, options.reduce.bins, options.reduce.range);
            insert(group, surveyed);
        }
    }
    Ok(found)
}

/// Which group goes into which bucket.
struct Distribution {
    buckets: Vec<Bucket>,
    /// By group number; none for a group without a scored row.
    bucket_of: Vec<Option<usize>>,
    rows: u64,
}

impl Distribution {
    fn of(groups: &GroupFile, bucket_rows: u64) -> Self {
        let mut buckets = Vec::new();
        let mut open = Bucket::default();
        for (group, (&rows, &scored)) in groups.rows.iter().zip(&groups.scored).enumerate() {
            if scored == 0 {
                continue;
            }
            if rows > bucket_rows {
                buckets.push(Bucket {
                    groups: vec![group as u32],
                    rows,
                });
                continue;
            }
            if open.rows + rows > bucket_rows {
                buckets.push(std::mem::take(&mut open));
            }
            open.groups.push(group as u32);
            open.rows += rows;
        }
        if !open.groups.is_empty() {
            buckets.push(open);
        }
        let mut bucket_of = vec![None; groups.rows.len()];
        for (k, bucket) in buckets.iter().enumerate() {
            for &group in &bucket.groups {
                bucket_of[group as usize] = Some(k);
            }
        }
        Self {
            rows: buckets.iter().map(|bucket| bucket.rows).sum(),
            buckets,
            bucket_of,
        }
    }

    /// Writes what `make` makes of each row's group and value into the section of its bucket.
    fn distribute(
        &self,
        groups: &GroupFile,
        values: &FloatFile,
        out: &FloatFile,
        make: &dyn Fn(u32, f64) -> f64,
    ) -> Result<(), ReduceFilesError> {
        let mut starts = Vec::with_capacity(self.buckets.len());
        let mut row = 0;
        for bucket in &self.buckets {
            starts.push(row);
            row += bucket.rows;
        }
        let mut buffers: Vec<Vec<f64>> = vec![Vec::with_capacity(BUFFERED); starts.len()];
        let mut numbers = Vec::new();
        values.pieces(0..values.rows(), |row, piece| {
            numbers.resize(piece.len(), NO_GROUP);
            groups.read(row, &mut numbers)?;
            for (&group, &value) in numbers.iter().zip(piece.iter()) {
                let Some(&Some(bucket)) = self.bucket_of.get(group as usize) else {
                    continue;
                };
                let buffer = &mut buffers[bucket];
                buffer.push(make(group, value));
                if buffer.len() == BUFFERED {
                    out.write(starts[bucket], buffer)?;
                    starts[bucket] += buffer.len() as u64;
                    buffer.clear();
                }
            }
            Ok(())
        })?;
        for (buffer, start) in buffers.iter().zip(starts) {
            out.write(start, buffer)?;
        }
        Ok(())
    }
}
