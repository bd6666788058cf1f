//! What a run measured, and what that comes to: with one profile, or up a ladder of them.

use plumbline_common::id::VideoId;
use plumbline_common::message::Thumbnails;

use super::{measured_video, unreadable};
use crate::cascade::record::CascadeRecord;
use crate::collect::{Journal, JournalError};
use crate::corpus::Entry;
use crate::publish::CostRow;
use crate::reduce::ladder::{self, OnRung, RungOfRows};
use crate::reduce::{self, MeasuredVideo, ReduceOptions, Reduced};

/// Journals, with what is to be made of them.
pub(crate) enum Journals {
    /// One profile measured everything.
    Plain(Journal),
    /// Several did.
    Cascade(Box<Cascaded>),
}

/// A finished cascade.
pub(crate) struct Cascaded {
    /// By rung.
    pub(crate) journals: Vec<Journal>,
    /// By rung.
    pub(crate) rungs: Vec<RungOfRows>,
    /// The rung of each entry's row, and the probability that the top decides otherwise.
    pub(crate) rows: Vec<(usize, Option<f64>)>,
    /// What is told of it.
    pub(crate) record: CascadeRecord,
}

/// Every entry with its measurement, in the corpus' order, so that nothing is lost; and what each
/// measurement cost.
pub(crate) fn collected(
    entries: &[Entry],
    journal: &Journal,
) -> Result<(Vec<MeasuredVideo>, Vec<CostRow>), JournalError> {
    let mut videos = Vec::with_capacity(entries.len());
    let mut costs = Vec::with_capacity(entries.len());
    for entry in entries {
        let record = journal.read(&entry.video)?;
        costs.extend(record.as_ref().map(|record| CostRow::of(record, None)));
        let measurement = match record {
            Some(record) => record.outcome.measurement,
            None => unreadable(entry),
        };
        videos.push(measured_video(entry, measurement));
    }
    Ok((videos, costs))
}

impl Journals {
    /// Rows of every entry, in the corpus' order, so that nothing is lost; and what each measurement cost.
    pub(crate) fn reduce(
        &self,
        entries: &[Entry],
        options: &ReduceOptions,
    ) -> Result<(Reduced, Vec<CostRow>), JournalError> {
        match self {
            Self::Plain(journal) => {
                let (videos, costs) = collected(entries, journal)?;
                Ok((reduce::reduce(videos, options), costs))
            }
            Self::Cascade(cascaded) => {
                let mut costs = Vec::new();
                let mut videos = Vec::with_capacity(entries.len());
                for (entry, &(rung, flip)) in entries.iter().zip(&cascaded.rows) {
                    let mut measurement = None;
                    for (at, journal) in cascaded.journals.iter().enumerate() {
                        let Some(record) = journal.read(&entry.video)? else {
                            continue;
                        };
                        let name = cascaded
                            .record
                            .profiles
                            .get(at)
                            .map(|rung| rung.name.clone());
                        costs.push(CostRow::of(&record, name));
                        if at == rung {
                            measurement = Some(record.outcome.measurement);
                        }
                    }
                    let measurement = measurement.unwrap_or_else(|| unreadable(entry));
                    videos.push(OnRung {
                        video: measured_video(entry, measurement),
                        rung,
                        flip,
                    });
                }
                let reduced = ladder::reduce(videos, &cascaded.rungs, options);
                Ok((reduced, costs))
            }
        }
    }

    /// Pictures of a video, by the dearest profile that looked at it.
    pub(crate) fn thumbnails(&self, video: &VideoId) -> Option<Thumbnails> {
        let journals = match self {
            Self::Plain(journal) => std::slice::from_ref(journal),
            Self::Cascade(cascaded) => &cascaded.journals,
        };
        let mut dearest_first = journals.iter().rev();
        dearest_first.find_map(|journal| journal.read(video).ok()??.outcome.thumbnails)
    }

    /// What is told of a cascade.
    pub(crate) fn record(&self) -> Option<&CascadeRecord> {
        match self {
            Self::Plain(_) => None,
            Self::Cascade(cascaded) => Some(&cascaded.record),
        }
    }
}
