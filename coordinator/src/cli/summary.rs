//! What a finished run says: a table on standard error, JSON on standard output.

use std::collections::BTreeMap;

use comfy_table::{CellAlignment, Table, presets};
use plumbline_common::row::{Decision, Row, Status};
use serde_json::{Value, json};

use crate::cascade::record::CascadeRecord;
use crate::progress::say;
use crate::publish::REPORT_FILE;
use crate::reduce::order::OrderStatistics;
use crate::reduce::values::InMemory;
use crate::run::Finished;

/// Groups shown on the terminal; the report has them all.
const MAX_GROUPS: usize = 20;

/// Rows without a score shown on the terminal; `scores.*` has them all.
const MAX_REASONS: usize = 10;

#[derive(Default)]
struct Counts {
    videos: usize,
    scored: usize,
    keep: usize,
    drop: usize,
    review: usize,
    anomalies: Vec<f64>,
}

impl Counts {
    fn add(&mut self, row: &Row) {
        self.videos += 1;
        self.scored += usize::from(row.measured.status == Status::Scored);
        match row.decision {
            Decision::Keep => self.keep += 1,
            Decision::Drop => self.drop += 1,
            Decision::Review => self.review += 1,
        }
        self.anomalies.extend(row.anomaly);
    }

    fn median(&self) -> Option<f64> {
        let anomalies: InMemory = self.anomalies.iter().copied().collect();
        let Ok(order) = OrderStatistics::find(&anomalies, self.anomalies.len() as u64, &[], 0);
        order.median()
    }
}

/// Prints the table.
pub(super) fn table(finished: &Finished) {
    let rows = &finished.reduced.rows;
    let mut groups: BTreeMap<&str, Counts> = BTreeMap::new();
    let mut all = Counts::default();
    for row in rows {
        groups
            .entry(row.group.as_deref().unwrap_or("(none)"))
            .or_default()
            .add(row);
        all.add(row);
    }
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header([
        "group",
        "videos",
        "scored",
        "keep",
        "drop",
        "review",
        "median anomaly",
    ]);
    let hidden = groups.len().saturating_sub(MAX_GROUPS);
    if groups.len() > 1 {
        for (group, counts) in groups.iter().take(MAX_GROUPS) {
            table.add_row(cells(&printable(group), counts));
        }
    }
    table.add_row(cells("all", &all));
    for column in 1..7 {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    say(&table.to_string());
    if hidden > 0 {
        say(&format!("and {hidden} more groups, in the report"));
    }
    tell_unscored(rows);
    for warning in &finished.reduced.statistics.warnings {
        say(&format!("note: {warning}"));
    }
    if let Some(cascade) = &finished.cascade {
        for rung in &cascade.profiles {
            say(&format!(
                "{}: {} measured, {} rows",
                rung.name, rung.measured, rung.rows
            ));
        }
    }
    let measured = finished.measured_now;
    let each = match measured {
        0 => String::new(),
        _ => format!(
            " ({:.2} s of compute each)",
            finished.compute_s / measured as f64
        ),
    };
    say(&format!(
        "{measured} measured now in {:.1} s{each}",
        finished.elapsed_s
    ));
    say(&format!(
        "report: {}",
        finished.out.join(REPORT_FILE).display()
    ));
}

fn cells(name: &str, counts: &Counts) -> [String; 7] {
    let median = counts
        .median()
        .map_or("-".to_owned(), |median| format!("{median:+.3}"));
    [
        name.to_owned(),
        counts.videos.to_string(),
        counts.scored.to_string(),
        counts.keep.to_string(),
        counts.drop.to_string(),
        counts.review.to_string(),
        median,
    ]
}

fn tell_unscored(rows: &[Row]) {
    let unscored: Vec<&Row> = rows
        .iter()
        .filter(|row| row.measured.status != Status::Scored)
        .collect();
    for row in unscored.iter().take(MAX_REASONS) {
        let reason = row.measured.status_reason.as_deref().unwrap_or_default();
        let status = row.measured.status.as_str();
        say(&format!(
            "{status}: {}: {}",
            printable(row.video.as_str()),
            printable(reason)
        ));
    }
    if unscored.len() > MAX_REASONS {
        say(&format!(
            "and {} more without a score, in manifests/review.jsonl",
            unscored.len() - MAX_REASONS
        ));
    }
}

/// A name on one line of a terminal: control characters are shown, not obeyed.
pub(super) fn printable(text: &str) -> String {
    text.chars()
        .flat_map(|c| {
            if c.is_control() {
                c.escape_default().collect::<Vec<_>>()
            } else {
                vec![c]
            }
        })
        .collect()
}

/// The machine-readable summary.
pub(super) fn json(finished: &Finished) -> Value {
    let statistics = &finished.reduced.statistics;
    json!({
        "out": finished.out.to_string_lossy(),
        "run": finished.run,
        "files": finished.files,
        "videos": finished.reduced.rows.len(),
        "measured_now": finished.measured_now,
        "statuses": statistics.statuses,
        "decisions": statistics.decisions,
        "recipe": statistics.recipe,
        "weights": statistics.weights(),
        "reference": statistics.reference,
        "warnings": statistics.warnings,
        "cascade": finished.cascade.as_ref().map(told),
        "elapsed_s": finished.elapsed_s,
        "compute_s": finished.compute_s,
    })
}

/// A cascade without what `corpus.json` has at length.
fn told(cascade: &CascadeRecord) -> Value {
    let rungs = cascade
        .profiles
        .iter()
        .map(|rung| json!({ "name": rung.name, "measured": rung.measured, "rows": rung.rows }));
    json!({
        "budget": cascade.budget,
        "reproducible": cascade.reproducible,
        "ended": cascade.ended,
        "sample": cascade.sample,
        "expected_flips": cascade.expected_flips,
        "expected_agreement": cascade.expected_agreement,
        "measured_agreement": cascade.measured_agreement,
        "profiles": rungs.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::printable;

    #[test]
    fn control_characters_do_not_reach_the_terminal() {
        assert_eq!(printable("a\n\u{1b}[31mb ü"), "a\\n\\u{1b}[31mb ü");
    }
}
