//! `manifests/{keep,drop,review}.*`: what a trainer reads. `path` is the video's absolute path or
//! URI, as the corpus lists it; of a member or an episode that of the file which it is in.

use plumbline_common::row::{Decision, Row};

use crate::publish::table::Kind::{Float64, Text, UInt64};
use crate::publish::table::{Column, carried_columns};
use crate::reduce::decision_name;

/// A row and where its video lies.
#[derive(Debug, Clone, Copy)]
pub struct ManifestRow<'a> {
    /// The row.
    pub row: &'a Row,
    /// Absolute path or URI.
    pub location: &'a str,
}

/// The manifests, in the order in which they are written.
pub const DECISIONS: [Decision; 3] = [Decision::Keep, Decision::Drop, Decision::Review];

/// The columns of every manifest of these rows: the three share one schema, whatever falls into
/// each.
#[must_use]
pub fn manifest_columns<'a>(rows: &[Row]) -> Vec<Column<ManifestRow<'a>>> {
    let mut columns: Vec<Column<ManifestRow<'a>>> = vec![
        Column::field("video", Text, |r| r.row.video.as_str().into()),
        Column::field("path", Text, |r| r.location.into()),
        Column::field("group", Text, |r| r.row.group.as_deref().into()),
        Column::field("anomaly", Float64, |r| r.row.anomaly.into()),
        Column::field("rank", UInt64, |r| r.row.rank.into()),
        Column::field("decision", Text, |r| decision_name(r.row.decision).into()),
        Column::field("status", Text, |r| r.row.measured.status.as_str().into()),
        Column::field("status_reason", Text, |r| {
            r.row.measured.status_reason.as_deref().into()
        }),
    ];
    if rows.iter().any(|row| row.rung.is_some()) {
        columns.extend([
            Column::field("rung", Text, |r: &ManifestRow<'a>| {
                r.row.rung.as_deref().into()
            }),
            Column::field("flip_probability", Float64, |r: &ManifestRow<'a>| {
                r.row.flip_probability.into()
            }),
        ]);
    }
    let reserved: Vec<String> = columns.iter().map(|column| column.name.clone()).collect();
    let carried = carried_columns(rows.iter().map(|row| &row.carried), &reserved);
    columns.extend(
        carried
            .iter()
            .map(|column| Column::carried(column, |r: &ManifestRow<'a>| &r.row.carried)),
    );
    columns
}

/// The rows of one manifest, in the order of `rows`; `locations` is parallel to `rows`.
#[must_use]
pub fn manifest_rows<'a>(
    decision: Decision,
    rows: &'a [Row],
    locations: &'a [String],
) -> Vec<ManifestRow<'a>> {
    rows.iter()
        .zip(locations)
        .filter(|(row, _)| row.decision == decision)
        .map(|(row, location)| ManifestRow { row, location })
        .collect()
}
