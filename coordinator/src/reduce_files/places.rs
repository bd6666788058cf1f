//! Ranks of all rows in bounded memory: an external distribution sort.
//!
//! Scores are distributed between exact quantiles into sections of at most so many rows, in row order,
//! which is the order of `video`; each section is sorted by score and row in memory, so that ties fall
//! by name. A score that fills a section alone needs no sorting. Places are then distributed back by
//! row.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::mpsc::sync_channel;

use plumbline_common::row::Decision;

use super::error::ReduceFilesError;
use super::float_file::FloatFile;
use super::intake::{GroupFile, NO_GROUP};
use crate::reduce::order::OrderStatistics;
use crate::reduce::select::{KeepRule, Place};
use crate::reduce::tally::Cuts;

/// Bytes of one record on its way to be sorted: score, row, group.
const SCORE_BYTES: usize = 20;

/// Bytes of one place: rank in the corpus and in the group.
const PLACE_BYTES: usize = 16;

/// Bytes of one place on its way back: row and place.
const RETURN_BYTES: usize = 8 + PLACE_BYTES;

/// Records gathered per section before they are written.
const BUFFERED: usize = 2048;

/// A row's score on its way.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scored {
    anomaly: f64,
    row: u64,
    group: u32,
}

/// The place of every row, by row index.
#[derive(Debug)]
pub(super) struct Places {
    file: File,
    ranked: u64,
    /// Ranked rows by group number; the last one counts those without a group.
    sizes: Vec<u64>,
    /// Where each group is cut.
    pub(super) cuts: Cuts<u32>,
}

impl Places {
    /// Ranks the rows that have a score (NaN: none), `section_rows` of them in memory at a time.
    pub(super) fn rank(
        anomalies: &FloatFile,
        groups: Option<&GroupFile>,
        keep: &KeepRule,
        scratch: &Path,
        section_rows: u64,
    ) -> Result<Self, ReduceFilesError> {
        let count = Count::of(anomalies, groups)?;
        let sections = Sections::between_quantiles(anomalies, count.ranked, section_rows)?;
        let mut scores = Distributor::create(scratch, sections.starts(), SCORE_BYTES)?;
        each_score(anomalies, groups, |scored| {
            let mut bytes = [0; SCORE_BYTES];
            bytes[..8].copy_from_slice(&scored.anomaly.to_le_bytes());
            bytes[8..16].copy_from_slice(&scored.row.to_le_bytes());
            bytes[16..].copy_from_slice(&scored.group.to_le_bytes());
            scores.push(sections.of(scored.anomaly), &bytes)
        })?;
        let scores = scores.finish()?;

        let rows = anomalies.rows();
        let returns: Vec<u64> = (0..rows.div_ceil(section_rows))
            .map(|k| k * section_rows)
            .collect();
        let mut places = Distributor::create(scratch, returns, RETURN_BYTES)?;
        let mut found = Self {
            file: tempfile::tempfile_in(scratch)?,
            ranked: count.ranked,
            sizes: count.sizes,
            cuts: Cuts::default(),
        };
        let mut rank = 0;
        let mut group_ranks = vec![0; found.sizes.len()];
        let mut place = |scored: Scored, found: &mut Self| -> io::Result<()> {
            rank += 1;
            let group = (scored.group as usize).min(group_ranks.len() - 1);
            group_ranks[group] += 1;
            let place = Place {
                rank,
                ranked: found.ranked,
                group_rank: group_ranks[group],
                group_size: found.sizes[group],
            };
            found.cuts.note(
                scored.group,
                scored.anomaly,
                keep.decide(&place, scored.anomaly),
            );
            let mut bytes = [0; RETURN_BYTES];
            bytes[..8].copy_from_slice(&scored.row.to_le_bytes());
            bytes[8..16].copy_from_slice(&place.rank.to_le_bytes());
            bytes[16..].copy_from_slice(&place.group_rank.to_le_bytes());
            places.push((scored.row / section_rows) as usize, &bytes)
        };
        std::thread::scope(|scope| {
            // One section is sorted while the one before is placed.
            let (sender, receiver) = sync_channel(0);
            let (scores, spans) = (&scores, &sections.spans);
            let sorter = scope.spawn(move || -> io::Result<()> {
                for &(start, count) in spans.iter().step_by(2) {
                    let mut section = Vec::with_capacity(count as usize);
                    scores.read(start, count, SCORE_BYTES, |bytes| {
                        section.push(scored(bytes));
                        Ok(())
                    })?;
                    section.sort_unstable_by(|a, b| {
                        a.anomaly.total_cmp(&b.anomaly).then(a.row.cmp(&b.row))
                    });
                    if sender.send(section).is_err() {
                        // Whoever places has failed, and says so.
                        break;
                    }
                }
                Ok(())
            });
            let mut place_all = || -> io::Result<()> {
                for (k, &(start, count)) in spans.iter().enumerate() {
                    if Sections::is_one_score(k) {
                        scores.read(start, count, SCORE_BYTES, |bytes| {
                            place(scored(bytes), &mut found)
                        })?;
                        continue;
                    }
                    // The sorter says itself why it ended early.
                    let Ok(section) = receiver.recv() else { break };
                    for scored in section {
                        place(scored, &mut found)?;
                    }
                }
                Ok(())
            };
            let placed = place_all();
            drop(receiver);
            sorter.join().map_err(|_| ReduceFilesError::Thread)??;
            Ok::<_, ReduceFilesError>(placed?)
        })?;
        let counts = places.counts();
        let places = places.finish()?;
        for (k, count) in counts.into_iter().enumerate() {
            let first = k as u64 * section_rows;
            let mut section = vec![0; ((rows - first).min(section_rows) as usize) * PLACE_BYTES];
            places.read(first, count, RETURN_BYTES, |bytes| {
                let at = (u64_at(bytes, 0) - first) as usize * PLACE_BYTES;
                section[at..at + PLACE_BYTES].copy_from_slice(&bytes[8..]);
                Ok(())
            })?;
            found
                .file
                .write_all_at(&section, first * PLACE_BYTES as u64)?;
        }
        Ok(found)
    }

    /// The places of rows, from a row on, `None` for a row without a score; `groups` are theirs.
    pub(super) fn read(&self, row: u64, groups: &[u32]) -> io::Result<Vec<Option<Place>>> {
        let mut bytes = vec![0; groups.len() * PLACE_BYTES];
        self.file
            .read_exact_at(&mut bytes, row * PLACE_BYTES as u64)?;
        let places = bytes
            .chunks_exact(PLACE_BYTES)
            .zip(groups)
            .map(|(bytes, &group)| {
                let rank = u64_at(bytes, 0);
                (rank > 0).then(|| Place {
                    rank,
                    ranked: self.ranked,
                    group_rank: u64_at(bytes, 8),
                    group_size: self.sizes[(group as usize).min(self.sizes.len() - 1)],
                })
            });
        Ok(places.collect())
    }
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut eight = [0; 8];
    eight.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(eight)
}

fn scored(bytes: &[u8]) -> Scored {
    let mut four = [0; 4];
    four.copy_from_slice(&bytes[16..20]);
    Scored {
        anomaly: f64::from_bits(u64_at(bytes, 0)),
        row: u64_at(bytes, 8),
        group: u32::from_le_bytes(four),
    }
}

/// Goes through the rows that have a score, in row order.
fn each_score(
    anomalies: &FloatFile,
    groups: Option<&GroupFile>,
    mut each: impl FnMut(Scored) -> io::Result<()>,
) -> io::Result<()> {
    let mut numbers = Vec::new();
    anomalies.pieces(0..anomalies.rows(), |first, piece| {
        numbers.clear();
        numbers.resize(piece.len(), NO_GROUP);
        if let Some(groups) = groups {
            groups.read(first, &mut numbers)?;
        }
        for ((row, &anomaly), &group) in (first..).zip(piece.iter()).zip(&numbers) {
            if !anomaly.is_nan() {
                each(Scored {
                    // + 0 makes −0 equal to 0, as the tie rule has it.
                    anomaly: anomaly + 0.0,
                    row,
                    group,
                })?;
            }
        }
        Ok(())
    })
}

/// Ranked rows, in all and by group number.
struct Count {
    ranked: u64,
    sizes: Vec<u64>,
}

impl Count {
    fn of(anomalies: &FloatFile, groups: Option<&GroupFile>) -> io::Result<Self> {
        let mut sizes = vec![0; groups.map_or(0, |groups| groups.names.len()) + 1];
        let without = sizes.len() - 1;
        each_score(anomalies, groups, |scored| {
            sizes[(scored.group as usize).min(without)] += 1;
            Ok(())
        })?;
        Ok(Self {
            ranked: sizes.iter().sum(),
            sizes,
        })
    }
}

/// Sections of the order: between two splitters, and each splitter by itself.
struct Sections {
    splitters: Vec<f64>,
    /// First record and number of records of each section.
    spans: Vec<(u64, u64)>,
}

impl Sections {
    fn between_quantiles(
        anomalies: &FloatFile,
        ranked: u64,
        section_rows: u64,
    ) -> Result<Self, ReduceFilesError> {
        let parts = ranked.div_ceil(section_rows).max(1);
        let quantiles: Vec<f64> = (1..parts).map(|k| k as f64 / parts as f64).collect();
        let order = OrderStatistics::find(anomalies, ranked, &quantiles, 0)?;
        let mut splitters: Vec<f64> = quantiles
            .iter()
            .filter_map(|&q| order.quantile(q))
            .collect();
        splitters.dedup();
        let mut sections = Self {
            spans: vec![(0, 0); 2 * splitters.len() + 1],
            splitters,
        };
        anomalies.pieces(0..anomalies.rows(), |_, piece| {
            for &anomaly in piece.iter().filter(|anomaly| !anomaly.is_nan()) {
                let section = sections.of(anomaly);
                sections.spans[section].1 += 1;
            }
            Ok(())
        })?;
        let mut start = 0;
        for span in &mut sections.spans {
            span.0 = start;
            start += span.1;
        }
        Ok(sections)
    }

    /// Even sections lie between splitters, odd ones are a splitter.
    fn of(&self, anomaly: f64) -> usize {
        let below = self
            .splitters
            .partition_point(|&splitter| splitter < anomaly);
        2 * below + usize::from(self.splitters.get(below) == Some(&anomaly))
    }

    fn is_one_score(section: usize) -> bool {
        section % 2 == 1
    }

    fn starts(&self) -> Vec<u64> {
        self.spans.iter().map(|span| span.0).collect()
    }
}

/// Records of one size, distributed into sections of one scratch file.
struct Distributor {
    file: File,
    /// Where the next record of each section goes.
    next: Vec<u64>,
    starts: Vec<u64>,
    buffers: Vec<Vec<u8>>,
    record_bytes: usize,
}

impl Distributor {
    fn create(scratch: &Path, starts: Vec<u64>, record_bytes: usize) -> io::Result<Self> {
        Ok(Self {
            file: tempfile::tempfile_in(scratch)?,
            next: starts.clone(),
            buffers: vec![Vec::with_capacity(BUFFERED * record_bytes); starts.len()],
            starts,
            record_bytes,
        })
    }

    fn push(&mut self, section: usize, record: &[u8]) -> io::Result<()> {
        let buffer = &mut self.buffers[section];
        buffer.extend_from_slice(record);
        if buffer.len() >= BUFFERED * self.record_bytes {
            self.flush(section)?;
        }
        Ok(())
    }

    fn flush(&mut self, section: usize) -> io::Result<()> {
        let buffer = &mut self.buffers[section];
        self.file
            .write_all_at(buffer, self.next[section] * self.record_bytes as u64)?;
        self.next[section] += (buffer.len() / self.record_bytes) as u64;
        buffer.clear();
        Ok(())
    }

    /// Records of each section so far.
    fn counts(&self) -> Vec<u64> {
        let buffered = self
            .buffers
            .iter()
            .map(|buffer| (buffer.len() / self.record_bytes) as u64);
        let written = self
            .next
            .iter()
            .zip(&self.starts)
            .map(|(next, start)| next - start);
        written.zip(buffered).map(|(a, b)| a + b).collect()
    }

    fn finish(mut self) -> io::Result<Distributed> {
        for section in 0..self.buffers.len() {
            self.flush(section)?;
        }
        Ok(Distributed { file: self.file })
    }
}

struct Distributed {
    file: File,
}

impl Distributed {
    /// Hands on `count` records from a record on.
    fn read(
        &self,
        start: u64,
        count: u64,
        record_bytes: usize,
        mut each: impl FnMut(&[u8]) -> io::Result<()>,
    ) -> io::Result<()> {
        let mut record = start;
        let end = start + count;
        let mut bytes = Vec::new();
        while record < end {
            let n = (end - record).min(BUFFERED as u64);
            bytes.resize(n as usize * record_bytes, 0);
            self.file
                .read_exact_at(&mut bytes, record * record_bytes as u64)?;
            bytes.chunks_exact(record_bytes).try_for_each(&mut each)?;
            record += n;
        }
        Ok(())
    }
}

/// What becomes of a row by its place.
pub(super) fn decision(place: Option<&Place>, anomaly: f64, keep: &KeepRule) -> Decision {
    place.map_or(Decision::Review, |place| keep.decide(place, anomaly))
}
