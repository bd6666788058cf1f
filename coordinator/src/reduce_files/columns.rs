//! The columns of rows in files: ours by name, every other one carried through.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow_array::{Array, ArrayRef, RecordBatch, RecordBatchOptions, new_null_array};
use arrow_cast::{CastOptions, cast_with_options};
use arrow_schema::{DataType, Field, Schema, SchemaRef};

use super::error::ReduceFilesError;
use super::table::Table;
use crate::publish::encode::data_type;
use crate::publish::scores::score_columns;
use crate::publish::table::{Kind, Seen};

/// Columns that the reduce makes anew, without a look at what the rows bring.
const MADE: [&str; 12] = [
    "z_reproj_px",
    "z_aepe_worldscore_px",
    "z_piecewise_residual",
    "z_appearance_ratio",
    "z_layer_acceleration_q25",
    "z_interior_shear",
    "z_detail_change_q25",
    "rank",
    "percentile",
    "decision",
    "reward",
    "recipe",
];

/// Columns that are made where the rows have none.
const NEEDED: [&str; 3] = ["video", "status", "status_reason"];

/// One column of the rows as they are read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ReadColumn {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) carried: bool,
}

/// The columns in the order of `scores.*`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    pub(super) all: Vec<ReadColumn>,
    schema: SchemaRef,
}

/// Which carried columns a part has, in its order, and what is in them.
pub(super) type CarriedSeen = Vec<(String, Seen)>;

/// Our own columns. Those of a cascade are not among them: its profiles' rows share no statistics here.
fn own_columns() -> Vec<(String, Kind)> {
    score_columns(&[])
        .into_iter()
        .map(|column| (column.name, column.kind))
        .collect()
}

/// What a Parquet part carries, where `own` are the names that are ours.
pub(super) fn carried_of(schema: &Schema, own: &[String]) -> CarriedSeen {
    schema
        .fields()
        .iter()
        .filter(|field| !own.contains(field.name()))
        .map(|field| (field.name().clone(), seen(field.data_type())))
        .collect()
}

fn seen(data_type: &DataType) -> Seen {
    match data_type {
        DataType::Null => Seen::default(),
        DataType::Boolean => Seen::of_kind(Kind::Bool),
        DataType::UInt64 => Seen::of_kind(Kind::UInt64),
        integer if integer.is_integer() => Seen::of_kind(Kind::Int64),
        float if float.is_floating() => Seen::of_kind(Kind::Float64),
        _ => Seen::of_kind(Kind::Text),
    }
}

impl Columns {
    /// Ours, and what the parts carry: in their order where all parts agree, else by name, so that
    /// neither the order nor the number of parts shows.
    pub(super) fn of(parts: &[CarriedSeen]) -> Self {
        let names = |part: &CarriedSeen| {
            part.iter()
                .map(|(name, _)| name.clone())
                .collect::<Vec<_>>()
        };
        let mut merged: BTreeMap<String, Seen> = BTreeMap::new();
        for (name, seen) in parts.iter().flatten() {
            merged.entry(name.clone()).or_default().merge(*seen);
        }
        let agreed = parts
            .first()
            .map(names)
            .filter(|first| parts.iter().all(|part| names(part) == *first));
        let carried: Vec<String> = agreed.unwrap_or_else(|| merged.keys().cloned().collect());
        let mut all = Vec::new();
        for (name, kind) in own_columns() {
            let group = name == "group";
            all.push(ReadColumn {
                name,
                kind,
                carried: false,
            });
            if group {
                all.extend(carried.iter().map(|name| ReadColumn {
                    name: name.clone(),
                    kind: merged.get(name).copied().unwrap_or_default().kind(),
                    carried: true,
                }));
            }
        }
        let fields: Vec<Field> = all
            .iter()
            .map(|column| Field::new(&column.name, data_type(column.kind), true))
            .collect();
        Self {
            all,
            schema: Arc::new(Schema::new(fields)),
        }
    }

    /// The schema of `scores.parquet`.
    pub(super) fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// Names that are read from files.
    pub(super) fn read(&self) -> Vec<&str> {
        let names = self.all.iter().map(|column| column.name.as_str());
        names.filter(|name| !MADE.contains(name)).collect()
    }

    /// Those of [`Self::read`] that any table has, and those that a row must have: the others need not
    /// be moved.
    pub(super) fn in_any(&self, tables: &[Table]) -> Vec<&str> {
        let there = |name: &&str| {
            let mut schemas = tables.iter().map(Table::schema);
            NEEDED.contains(name) || schemas.any(|schema| schema.column_with_name(name).is_some())
        };
        self.read().into_iter().filter(there).collect()
    }

    /// The schema of what [`Self::conform`] makes.
    pub(super) fn schema_of(&self, names: &[&str]) -> SchemaRef {
        let fields = self.schema.fields().iter();
        let named = fields.filter(|field| names.contains(&field.name().as_str()));
        Arc::new(Schema::new(named.cloned().collect::<Vec<_>>()))
    }

    /// A batch as a file has it, with these columns in our types; nulls where the file has none.
    pub(super) fn conform(
        &self,
        batch: &RecordBatch,
        names: &[&str],
        file: &str,
    ) -> Result<RecordBatch, ReduceFilesError> {
        let schema = self.schema_of(names);
        let fields = schema.fields().iter();
        let arrays = fields.map(|field| match batch.column_by_name(field.name()) {
            None => Ok(new_null_array(field.data_type(), batch.num_rows())),
            Some(array) => cast(array, field, file),
        });
        let arrays = arrays.collect::<Result<Vec<_>, _>>()?;
        let options = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
        RecordBatch::try_new_with_options(schema, arrays, &options)
            .map_err(|error| ReduceFilesError::source(file, error))
    }
}

fn cast(array: &ArrayRef, field: &Field, file: &str) -> Result<ArrayRef, ReduceFilesError> {
    if array.data_type() == field.data_type() {
        return Ok(Arc::clone(array));
    }
    let options = CastOptions {
        safe: false,
        ..CastOptions::default()
    };
    cast_with_options(array, field.data_type(), &options).map_err(|error| {
        ReduceFilesError::source(
            file,
            format!(
                "the column `{}` holds {}, where {} is needed ({error}); rename or convert it",
                field.name(),
                array.data_type(),
                field.data_type()
            ),
        )
    })
}
