//! The schemas of all tables, and which files are written.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use arrow_array::{Array, ArrayRef, RecordBatch, new_null_array};
use arrow_schema::{DataType, Field, Schema, SchemaRef};

use super::{PIECE_ROWS, Piece};
use crate::publish::encode::{Format, data_type};
use crate::publish::manifests::DECISIONS;
use crate::publish::rewards::reward_columns;
use crate::reduce::decision_name;
use crate::reduce_files::columns::Columns;

/// What of a piece goes into a file.
pub(super) type Part = fn(&Piece) -> &RecordBatch;

/// One file and what of a piece goes into it.
pub(super) struct Sink {
    pub(super) name: String,
    pub(super) format: Format,
    pub(super) schema: SchemaRef,
    pub(super) of: Part,
}

/// The schemas of all tables.
pub(super) struct Tables {
    pub(super) scores: SchemaRef,
    pub(super) manifest: SchemaRef,
    /// Where the carried columns of a manifest lie among the scores.
    pub(super) carried: Vec<usize>,
    pub(super) rewards: SchemaRef,
    /// A piece of nulls of every type: columns that nothing fills share it.
    nulls: HashMap<DataType, ArrayRef>,
}

/// A manifest's own columns; the carried ones follow.
pub(super) const MANIFEST: [(&str, DataType); 8] = [
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
    pub(super) fn of(columns: &Columns) -> Self {
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
            .map(|c| Field::new(&c.name, data_type(c.kind), true))
            .collect();
        let manifest = Schema::new(fields.collect::<Vec<_>>());
        let rewards = Schema::new(rewards);
        let mut nulls = HashMap::new();
        for field in [&*scores, &manifest, &rewards]
            .into_iter()
            .flat_map(Schema::fields)
        {
            let of_type = nulls.entry(field.data_type().clone());
            of_type.or_insert_with(|| new_null_array(field.data_type(), PIECE_ROWS));
        }
        Self {
            manifest: Arc::new(manifest),
            carried,
            rewards: Arc::new(rewards),
            scores,
            nulls,
        }
    }

    /// A column without values, of at most [`PIECE_ROWS`] rows.
    pub(super) fn nulls(&self, data_type: &DataType, rows: usize) -> ArrayRef {
        match self
            .nulls
            .get(data_type)
            .filter(|nulls| rows <= nulls.len())
        {
            Some(nulls) => nulls.slice(0, rows),
            None => new_null_array(data_type, rows),
        }
    }

    /// The files to write in these formats, and the names of those that would contradict them.
    pub(super) fn sinks(&self, formats: &BTreeSet<Format>) -> (Vec<Sink>, Vec<String>) {
        let mut tables: Vec<(String, &SchemaRef, BTreeSet<Format>, Part)> = Vec::new();
        let also = |format| {
            let mut set = formats.clone();
            set.remove(&Format::Csv);
            set.insert(format);
            set
        };
        tables.push(("scores".to_owned(), &self.scores, formats.clone(), |p| {
            &p.scores
        }));
        let of: [Part; DECISIONS.len()] = [
            |p| &p.manifests[0],
            |p| &p.manifests[1],
            |p| &p.manifests[2],
        ];
        for (decision, of) in DECISIONS.into_iter().zip(of) {
            let stem = format!("manifests/{}", decision_name(decision));
            tables.push((stem, &self.manifest, also(Format::Jsonl), of));
        }
        tables.push((
            "rewards".to_owned(),
            &self.rewards,
            also(Format::Parquet),
            |p| &p.rewards,
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
