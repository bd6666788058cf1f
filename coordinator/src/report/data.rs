//! The rows as the page's script reads them: columns of `scores.*`, packed, in one JSON block.
//!
//! Which columns there are, the rows say. Floats keep five digits, texts are shown forms of bounded
//! length; one value for all rows is stored once, few texts as a dictionary. What would press the page
//! beyond its size is left out, the last columns first, and named.

use std::collections::{BTreeMap, HashMap};

use plumbline_common::row::{Decision, Row, Status};
use serde_json::{Map, Value, json};

use super::{ReportInput, text};
use crate::publish::scores::score_columns;
use crate::publish::table::{Cell, Column, Kind};
use crate::reduce::outcome::{CorpusStatistics, Recipe};
use crate::reduce::recipe::{BALANCED, PAPER, Signal};

/// Rows on the page.
pub(super) const ROWS: usize = 5_000;
/// Of those, places for videos without a score where there are too many of both.
const UNSCORED: usize = 500;
/// Largest block.
const BYTES: usize = 3_600_000;
/// Longest text of a cell, characters.
pub(super) const TEXT_CHARS: usize = 240;
/// Longest list of a cell.
const LIST: usize = 24;
/// Most different texts of a dictionary.
const DICTIONARY: usize = 1_000;

/// The rows on the page: those with a score, the worst first, then the others by name.
pub(crate) fn listed(rows: &[Row]) -> Vec<&Row> {
    let (mut scored, mut others): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| {
        row.measured.status == Status::Scored && row.anomaly.is_some_and(f64::is_finite)
    });
    let score = |row: &Row| row.anomaly.unwrap_or(f64::NEG_INFINITY);
    scored.sort_by(|a, b| {
        score(b)
            .total_cmp(&score(a))
            .then_with(|| b.video.cmp(&a.video))
    });
    let for_others = others
        .len()
        .min(UNSCORED.max(ROWS.saturating_sub(scored.len())));
    scored.truncate(ROWS - for_others);
    others.truncate(for_others);
    scored.extend(others);
    scored
}

/// The block, safe inside a script element.
pub(super) fn block(input: &ReportInput<'_>, listed: &[&Row]) -> String {
    let mut columns = Vec::new();
    let mut left_out = Vec::new();
    let mut bytes = 0;
    for column in score_columns(input.rows) {
        let packed = pack(&column, listed);
        let size = packed.to_string().len();
        if bytes + size > BYTES {
            left_out.push(Value::from(text::plain_name(&column.name, TEXT_CHARS)));
            continue;
        }
        bytes += size;
        columns.push(packed);
    }
    let files: Vec<Value> = listed
        .iter()
        .map(|row| {
            input
                .beside
                .get(&row.video)
                .map_or(Value::Null, |beside| beside.told())
        })
        .collect();
    let per_row = |of: &dyn Fn(&Row) -> Option<String>| -> Map<String, Value> {
        let told = listed.iter().enumerate();
        told.filter_map(|(index, row)| Some((index.to_string(), Value::from(of(row)?))))
            .collect()
    };
    let statistics = &input.corpus.statistics;
    let block = json!({
        "rows": listed.len(),
        "columns": columns,
        "left_out": left_out,
        "files": if files.iter().all(Value::is_null) { Value::Null } else { files.into() },
        "players": Packed::of(listed.iter().map(|row| (input.player)(&row.video).map_or(Value::Null, Value::from)).collect()),
        "heat_maps": per_row(&|row| input.heat_maps.get(&row.video).cloned()),
        "keep": text::visible(&statistics.keep),
        "cuts": cuts(input.rows),
        "parts": parts(statistics),
    });
    // No end of the element, and no comment, can begin inside.
    block.to_string().replace('<', "\\u003c")
}

/// The values of a column, as few bytes as is simple.
struct Packed;

impl Packed {
    fn of(values: Vec<Value>) -> Value {
        if let Some(first) = values.first()
            && values.iter().all(|value| value == first)
        {
            return json!({ "same": first });
        }
        let mut places: HashMap<String, usize> = HashMap::new();
        let mut dictionary = Vec::new();
        if values
            .iter()
            .all(|value| value.is_string() || value.is_null())
        {
            let mut at = Vec::with_capacity(values.len());
            for value in &values {
                let place = *places.entry(value.to_string()).or_insert_with(|| {
                    dictionary.push(value.clone());
                    dictionary.len() - 1
                });
                at.push(place);
            }
            if dictionary.len() <= DICTIONARY.min(values.len() / 2) {
                return json!({ "of": dictionary, "at": at });
            }
        }
        json!({ "values": values })
    }
}

fn pack(column: &Column<Row>, rows: &[&Row]) -> Value {
    let values: Vec<Value> = rows.iter().map(|row| value(column.cell(row))).collect();
    let kind = match column.kind {
        Kind::UInt32 | Kind::UInt64 | Kind::Int64 | Kind::Float64 => "number",
        Kind::Bool => "flag",
        Kind::Text => "text",
        Kind::ListUInt32 | Kind::ListText => "list",
    };
    let mut packed = Packed::of(values);
    if let Some(packed) = packed.as_object_mut() {
        packed.insert(
            "name".to_owned(),
            text::plain_name(&column.name, TEXT_CHARS).into(),
        );
        packed.insert("kind".to_owned(), kind.into());
    }
    packed
}

fn value(cell: Cell<'_>) -> Value {
    let shown = |text: &str| Value::from(text::plain_name(text, TEXT_CHARS));
    match cell {
        Cell::Null => Value::Null,
        Cell::Text(text) => shown(text),
        Cell::Unsigned(count) => count.into(),
        Cell::Float(value) => rounded(value),
        Cell::Bool(flag) => flag.into(),
        Cell::Counts(counts) => counts.iter().take(LIST).copied().collect(),
        Cell::Texts(texts) => texts.iter().take(LIST).map(|text| shown(text)).collect(),
        Cell::Carried(Value::String(text)) => shown(text),
        Cell::Carried(Value::Number(number)) => number.as_f64().map_or(Value::Null, rounded),
        Cell::Carried(Value::Bool(flag)) => (*flag).into(),
        Cell::Carried(other) => shown(&other.to_string()),
    }
}

/// Five digits: finer than any screen, and half the bytes. Whole numbers stay whole.
fn rounded(value: f64) -> Value {
    if value.fract() == 0.0 && value.abs() < 1e15 {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a whole number below 10^15"
        )]
        return (value as i64).into();
    }
    format!("{value:.4e}")
        .parse::<f64>()
        .map_or(Value::Null, Value::from)
}

/// Per group the highest score that is kept and the lowest that is dropped.
fn cuts(rows: &[Row]) -> Map<String, Value> {
    let mut cuts: BTreeMap<&str, (Option<f64>, Option<f64>)> = BTreeMap::new();
    for row in rows {
        let Some(anomaly) = row.anomaly.filter(|anomaly| anomaly.is_finite()) else {
            continue;
        };
        let (kept, dropped) = cuts
            .entry(row.group.as_deref().unwrap_or_default())
            .or_default();
        match row.decision {
            Decision::Keep => *kept = Some(kept.map_or(anomaly, |cut| cut.max(anomaly))),
            Decision::Drop => *dropped = Some(dropped.map_or(anomaly, |cut| cut.min(anomaly))),
            Decision::Review => {}
        }
    }
    let told = cuts.into_iter().take(ROWS);
    told.map(|(group, (kept, dropped))| {
        let value = |cut: Option<f64>| cut.map_or(Value::Null, rounded);
        (
            text::plain_name(group, TEXT_CHARS),
            json!([value(kept), value(dropped)]),
        )
    })
    .collect()
}

/// How much each z-score counts in the anomaly score of a row that has them all, by column; null for
/// those of the other recipe.
fn parts(statistics: &CorpusStatistics) -> Map<String, Value> {
    let weight = |signal: Signal| match statistics.recipe {
        Recipe::Paper => {
            let weight = statistics.weights().get(signal.column()).copied();
            PAPER.contains(&signal).then(|| weight.unwrap_or(0.0))
        }
        Recipe::Balanced => {
            let family = BALANCED.iter().find(|family| family.contains(&signal));
            family.map(|family| 1.0 / (BALANCED.len() * family.len()) as f64)
        }
    };
    let column = |signal: Signal| format!("z_{}", signal.column());
    Signal::ALL
        .iter()
        .map(|&signal| {
            let weight = weight(signal).map_or(Value::Null, rounded);
            (column(signal), weight)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_packed_and_read_back() {
        let same = Packed::of(vec![json!(1), json!(1)]);
        assert_eq!(same, json!({ "same": 1 }));
        let texts = ["a", "b", "a", "a"].map(Value::from).to_vec();
        assert_eq!(
            Packed::of(texts),
            json!({ "of": ["a", "b"], "at": [0, 1, 0, 0] })
        );
        let mixed = vec![json!(1), Value::Null];
        assert_eq!(Packed::of(mixed.clone()), json!({ "values": mixed }));
        assert_eq!(rounded(1.234_567), json!(1.2346));
        assert_eq!(rounded(-3.0), json!(-3));
        assert_eq!(rounded(1e300), json!(1e300));
    }
}
