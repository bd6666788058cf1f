//! The last pass: rows again, with what they came to, into every table at once.
//!
//! One thread reads and completes the rows in pieces of a fixed size; each file has a thread that
//! encodes it. Pieces are cut by row index, so that neither the parts nor the threads show in a file.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use arrow_array::{
    ArrayRef, BooleanArray, Float64Array, RecordBatch, RecordBatchOptions, StringArray,
    UInt64Array, new_null_array,
};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use arrow_select::coalesce::BatchCoalescer;
use arrow_select::filter::filter_record_batch;
use plumbline_common::row::{Decision, Status};

use super::columns::Columns;
use super::error::{ReduceFilesError, joined};
use super::float_file::FloatFile;
use super::intake::{Intake, NO_GROUP};
use super::paths::Paths;
use super::places::{Places, decision};
use super::rows::{Checked, check, float_at, floats, shape_at};
use super::scoring::{Signals, Yardsticks};
use super::trainer_lists::Lists;
use crate::publish::encode::Format;
use crate::publish::encode::batches::BatchWriter;
use crate::publish::manifests::DECISIONS;
use crate::publish::rewards::reward_columns;
use crate::publish::trainer_lists::TrainerLists;
use crate::publish::{OutDir, PublishError};
use crate::reduce::recipe::{BySignal, Signal, signals_of};
use crate::reduce::rewards::{Spread, reward, soft_weight};
use crate::reduce::select::{Place, Standing};
use crate::reduce::tally::{Facts, Tally};
use crate::reduce::{ReduceOptions, decision_name, recipe_name};

/// Rows completed at a time: a few MB in every column table.
const PIECE_ROWS: usize = 1 << 15;

/// Pieces that wait for a writer.
const WAITING: usize = 1;

/// Everything that the rows are completed with.
pub(super) struct Completion<'a> {
    pub(super) intake: &'a Intake,
    pub(super) columns: &'a Columns,
    pub(super) yardsticks: &'a Yardsticks<'a>,
    pub(super) anomalies: &'a FloatFile,
    pub(super) rewards: Option<Spread>,
    pub(super) places: &'a Places,
    pub(super) options: &'a ReduceOptions,
}

/// One piece in every table.
#[derive(Clone)]
struct Piece {
    scores: RecordBatch,
    /// In the order of [`DECISIONS`].
    manifests: [RecordBatch; DECISIONS.len()],
    rewards: RecordBatch,
}

/// What of a piece goes into a file.
type Part = fn(&Piece) -> RecordBatch;

/// One file and what of a piece goes into it.
struct Sink {
    name: String,
    format: Format,
    schema: SchemaRef,
    of: Part,
}

/// Writes scores, manifests, rewards and lists for trainers; says which files and counts the rows.
pub(super) fn write(
    out: &OutDir,
    completion: &Completion<'_>,
    paths: Paths,
    formats: &BTreeSet<Format>,
) -> Result<(Vec<String>, Tally), ReduceFilesError> {
    let tables = Tables::of(completion.columns);
    let (sinks, stale) = tables.sinks(formats);
    let mut written: Vec<String> = sinks.iter().map(|sink| sink.name.clone()).collect();
    for name in stale {
        out.remove(&name)?;
    }
    let (tally, lists) = std::thread::scope(|scope| {
        let (senders, writers): (Vec<_>, Vec<_>) = sinks
            .into_iter()
            .map(|sink| {
                let (sender, receiver) = sync_channel(WAITING);
                (sender, scope.spawn(move || drain(out, &sink, &receiver)))
            })
            .unzip();
        let completed = completion.complete_all(out, &tables, paths, &senders);
        // The writers end when nobody sends any more.
        drop(senders);
        for writer in writers {
            joined(writer.join())?;
        }
        completed
    })?;
    written.extend(lists.publish(out)?);
    Ok((written, tally))
}

fn drain(out: &OutDir, sink: &Sink, pieces: &Receiver<Arc<Piece>>) -> Result<(), ReduceFilesError> {
    let put: Result<(), PublishError> = out.put_atomic_with(&sink.name, |writer| {
        let mut table = BatchWriter::new(sink.format, &sink.schema, writer)?;
        for piece in pieces {
            table.write(&(sink.of)(&piece))?;
        }
        table.finish()
    });
    Ok(put?)
}

/// The schemas of all tables.
struct Tables {
    scores: SchemaRef,
    manifest: SchemaRef,
    /// Where the carried columns of a manifest lie among the scores.
    carried: Vec<usize>,
    rewards: SchemaRef,
}

/// A manifest's own columns; the carried ones follow.
const MANIFEST: [(&str, DataType); 8] = [
    ("video", DataType::Utf8),
    ("path", DataType::Utf8),
    ("group", DataType::Utf8),
    ("anomaly", DataType::Float64),
    ("rank", DataType::UInt64),
    ("decision", DataType::Utf8),
    ("status", DataType::Utf8),
    ("status_reason", DataType::Utf8),
];

impl Tables {
    fn of(columns: &Columns) -> Self {
        let scores = SchemaRef::clone(columns.schema());
        let carried: Vec<usize> = columns
            .all
            .iter()
            .enumerate()
            .filter(|(_, column)| column.carried && column.name != "path")
            .map(|(index, _)| index)
            .collect();
        let own = MANIFEST.map(|(name, data_type)| Field::new(name, data_type, true));
        let fields = own
            .into_iter()
            .chain(carried.iter().map(|&index| scores.field(index).clone()));
        let rewards: Vec<Field> = reward_columns()
            .iter()
            .map(|c| Field::new(&c.name, crate::publish::encode::data_type(c.kind), true))
            .collect();
        Self {
            manifest: Arc::new(Schema::new(fields.collect::<Vec<_>>())),
            carried,
            rewards: Arc::new(Schema::new(rewards)),
            scores,
        }
    }

    /// The files to write in these formats, and the names of those that would contradict them.
    fn sinks(&self, formats: &BTreeSet<Format>) -> (Vec<Sink>, Vec<String>) {
        let mut tables: Vec<(String, &SchemaRef, BTreeSet<Format>, Part)> = Vec::new();
        let also = |format| {
            let mut set = formats.clone();
            set.remove(&Format::Csv);
            set.insert(format);
            set
        };
        tables.push(("scores".to_owned(), &self.scores, formats.clone(), |p| {
            p.scores.clone()
        }));
        let of: [Part; DECISIONS.len()] = [
            |p| p.manifests[0].clone(),
            |p| p.manifests[1].clone(),
            |p| p.manifests[2].clone(),
        ];
        for (decision, of) in DECISIONS.into_iter().zip(of) {
            let stem = format!("manifests/{}", decision_name(decision));
            tables.push((stem, &self.manifest, also(Format::Jsonl), of));
        }
        tables.push((
            "rewards".to_owned(),
            &self.rewards,
            also(Format::Parquet),
            |p| p.rewards.clone(),
        ));
        let (mut sinks, mut stale) = (Vec::new(), Vec::new());
        for (stem, schema, formats, of) in tables {
            for format in Format::ALL {
                let name = format!("{stem}.{}", format.extension());
                if formats.contains(&format) {
                    sinks.push(Sink {
                        name,
                        format,
                        schema: SchemaRef::clone(schema),
                        of,
                    });
                } else {
                    stale.push(name);
                }
            }
        }
        (sinks, stale)
    }
}

impl Completion<'_> {
    /// Reads all rows, completes them and sends them to every writer.
    fn complete_all(
        &self,
        out: &OutDir,
        tables: &Tables,
        mut paths: Paths,
        writers: &[SyncSender<Arc<Piece>>],
    ) -> Result<(Tally, TrainerLists), ReduceFilesError> {
        let names = self.columns.read();
        let mut tally = Tally::default();
        let mut lists = Lists::of(out, self.columns);
        let mut row = 0;
        let mut send = |batch: RecordBatch, file: &str| -> Result<bool, ReduceFilesError> {
            let rows = batch.num_rows() as u64;
            let paths = paths.of(&batch);
            let checked = check(batch, file)?;
            let piece = self.complete(tables, checked, row, paths, &mut tally, &mut lists)?;
            row += rows;
            let piece = Arc::new(piece);
            // A writer that is gone has failed, and says so itself.
            Ok(writers
                .iter()
                .all(|writer| writer.send(Arc::clone(&piece)).is_ok()))
        };
        let mut pieces: Option<BatchCoalescer> = None;
        for table in &self.intake.tables {
            for batch in table.read(&names, None, PIECE_ROWS)? {
                let batch = self.columns.conform(&batch?, &names, &table.name)?;
                let pieces =
                    pieces.get_or_insert_with(|| BatchCoalescer::new(batch.schema(), PIECE_ROWS));
                if pieces.is_empty() && batch.num_rows() == PIECE_ROWS {
                    // A whole piece as it is; anything else is cut and joined, which copies it.
                    if !send(batch, &table.name)? {
                        return Ok((tally, lists.lists));
                    }
                    continue;
                }
                pieces
                    .push_batch(batch)
                    .map_err(|error| ReduceFilesError::source(&table.name, error))?;
                while let Some(piece) = pieces.next_completed_batch() {
                    if !send(piece, &table.name)? {
                        return Ok((tally, lists.lists));
                    }
                }
            }
        }
        if let Some(mut pieces) = pieces {
            let finished = pieces.finish_buffered_batch();
            finished.map_err(|error| ReduceFilesError::source("the rows", error))?;
            while let Some(piece) = pieces.next_completed_batch() {
                if !send(piece, "the rows")? {
                    return Ok((tally, lists.lists));
                }
            }
        }
        Ok((tally, lists.lists))
    }

    fn complete(
        &self,
        tables: &Tables,
        checked: Checked,
        first_row: u64,
        paths: Option<StringArray>,
        tally: &mut Tally,
        lists: &mut Lists<'_>,
    ) -> Result<Piece, ReduceFilesError> {
        let Checked {
            batch,
            statuses,
            rejected,
        } = checked;
        let rows = batch.num_rows();
        let recipe = self.options.recipe;
        let mut signals = Signals::default();
        signals.read(self.intake, first_row, rows)?;
        let mut anomalies = vec![f64::NAN; rows];
        self.anomalies
            .read(first_row, &mut anomalies, &mut Vec::new())?;
        let places = self.places.read(first_row, &signals.groups)?;

        let old = ["anomaly", "anomaly_lo", "anomaly_hi"].map(|name| floats(&batch, name));
        let group_names = self
            .intake
            .groups
            .as_ref()
            .map_or(&[][..], |groups| &groups.names);
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

/// What the reduce adds to a piece of rows.
struct Made<'a> {
    z: BySignal<ArrayRef>,
    /// Where the videos lie, as far as anything says so.
    paths: Option<ArrayRef>,
    anomalies: Vec<Option<f64>>,
    intervals: Vec<Option<(f64, f64)>>,
    places: &'a [Option<Place>],
    decisions: &'a [Decision],
    groups: Vec<Option<&'a String>>,
    recipe: &'a str,
    options: &'a ReduceOptions,
}

type Batch = Result<RecordBatch, arrow_schema::ArrowError>;

impl Made<'_> {
    fn standings(&self) -> impl Iterator<Item = Option<Standing>> {
        let rows = self.places.iter().zip(&self.anomalies);
        rows.map(|(place, &anomaly)| Some(self.options.standing(place.as_ref()?, anomaly?)))
    }

    fn column(&self, name: &str) -> Option<ArrayRef> {
        let floats =
            |values: Vec<Option<f64>>| -> ArrayRef { Arc::new(Float64Array::from(values)) };
        if let Some(signal) = name.strip_prefix("z_")
            && let Some(signal) = Signal::ALL.into_iter().find(|s| s.column() == signal)
        {
            return Some(Arc::clone(&self.z[signal]));
        }
        let ranked = || self.places.iter();
        Some(match name {
            "group" => Arc::new(self.groups.iter().copied().collect::<StringArray>()),
            "anomaly" => floats(self.anomalies.clone()),
            "anomaly_lo" => floats(self.intervals.iter().map(|i| i.map(|i| i.0)).collect()),
            "anomaly_hi" => floats(self.intervals.iter().map(|i| i.map(|i| i.1)).collect()),
            "rank" => Arc::new(ranked().map(|p| p.map(|p| p.rank)).collect::<UInt64Array>()),
            "percentile" => floats(self.standings().map(|s| Some(s?.percentile())).collect()),
            "decision" => Arc::new(
                self.decisions
                    .iter()
                    .map(|&d| Some(decision_name(d)))
                    .collect::<StringArray>(),
            ),
            "reward" => floats(self.anomalies.iter().map(|a| a.map(reward)).collect()),
            "recipe" => Arc::new(
                self.decisions
                    .iter()
                    .map(|_| Some(self.recipe))
                    .collect::<StringArray>(),
            ),
            _ => return None,
        })
    }

    fn scores(&self, tables: &Tables, read: &RecordBatch) -> Batch {
        let rows = read.num_rows();
        let arrays = tables.scores.fields().iter().map(|field| {
            self.column(field.name())
                .or_else(|| read.column_by_name(field.name()).cloned())
                .unwrap_or_else(|| new_null_array(field.data_type(), rows))
        });
        batch(&tables.scores, arrays.collect(), rows)
    }

    fn manifest(&self, tables: &Tables, scores: &RecordBatch) -> Batch {
        let rows = scores.num_rows();
        let own = MANIFEST.iter().map(|(name, data_type)| {
            let array = match *name {
                "path" => self.paths.clone(),
                name => scores.column_by_name(name).cloned(),
            };
            array.unwrap_or_else(|| new_null_array(data_type, rows))
        });
        let carried = tables
            .carried
            .iter()
            .map(|&index| Arc::clone(scores.column(index)));
        batch(&tables.manifest, own.chain(carried).collect(), rows)
    }

    fn rewards(&self, tables: &Tables, scores: &RecordBatch, spread: Option<Spread>) -> Batch {
        let rows = scores.num_rows();
        let raw = || self.anomalies.iter().map(|a| a.map(reward));
        let places = || self.places.iter();
        let arrays = tables.rewards.fields().iter().map(|field| -> ArrayRef {
            match field.name().as_str() {
                "raw" => Arc::new(raw().collect::<Float64Array>()),
                "percentile" => Arc::new(
                    self.standings()
                        .map(|s| Some(s?.reward()))
                        .collect::<Float64Array>(),
                ),
                "soft" => Arc::new(
                    raw()
                        .map(|r| Some(soft_weight(r?, spread?)))
                        .collect::<Float64Array>(),
                ),
                "group_rank" => Arc::new(
                    places()
                        .map(|p| p.map(|p| p.group_rank))
                        .collect::<UInt64Array>(),
                ),
                "group_size" => Arc::new(
                    places()
                        .map(|p| p.map(|p| p.group_size))
                        .collect::<UInt64Array>(),
                ),
                "best_of_group" => Arc::new(
                    places()
                        .map(|p| p.map(|p| p.group_rank == 1))
                        .collect::<BooleanArray>(),
                ),
                name => scores
                    .column_by_name(name)
                    .cloned()
                    .unwrap_or_else(|| new_null_array(field.data_type(), rows)),
            }
        });
        let all = batch(&tables.rewards, arrays.collect(), rows)?;
        let ranked: BooleanArray = self
            .places
            .iter()
            .map(|place| Some(place.is_some()))
            .collect();
        filter_record_batch(&all, &ranked)
    }
}

fn batch(schema: &SchemaRef, arrays: Vec<ArrayRef>, rows: usize) -> Batch {
    let options = RecordBatchOptions::new().with_row_count(Some(rows));
    RecordBatch::try_new_with_options(SchemaRef::clone(schema), arrays, &options)
}

/// Statuses that leave a row without a remark in the exit code.
pub(super) fn complete(statuses: &std::collections::BTreeMap<String, u64>) -> bool {
    let fine = [Status::Scored, Status::Static].map(Status::as_str);
    statuses
        .iter()
        .all(|(name, &count)| count == 0 || fine.contains(&name.as_str()))
}
