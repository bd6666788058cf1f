//! `evaluation.md`: the tables of the paper, for a person.

use std::fmt::Write;

use super::sets::SetRate;
use super::{Evaluation, Populations, Success};
use crate::reduce::auroc::Auroc;
use crate::reduce::outcome::Range;
use crate::reduce::success::SuccessRate;

/// Names listed; the JSON has them all.
const LISTED: usize = 20;

pub(super) fn markdown(evaluation: &Evaluation) -> String {
    let mut text = format!(
        "# Evaluation of {}\n\n{} rows, {} with a score.\n",
        cell(&evaluation.scores),
        evaluation.videos,
        evaluation.scored
    );
    if let Some(success) = &evaluation.success {
        text.push_str(&success_text(success));
    }
    if let Some(populations) = &evaluation.populations {
        text.push_str(&populations_text(populations));
    }
    text
}

/// A line per set, and what could not be compared.
pub(super) fn summary(evaluation: &Evaluation) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(success) = &evaluation.success {
        for rate in &success.sets {
            let SuccessRate {
                percent,
                standard_error,
                n,
                ..
            } = rate.rate;
            lines.push(format!(
                "{}: {}% of {n} videos",
                rate.set.name(),
                plus_minus(percent, standard_error)
            ));
        }
        if let Some(area) = &success.auroc_failure {
            lines.push(format!("AUROC for failure: {}", auroc(area)));
        }
        lines.push(format!(
            "{} videos compared; {} labelled without a score, {} scored without a label",
            success.compared,
            success.without_score.len(),
            success.without_label.len()
        ));
    }
    for population in evaluation.populations.iter().flat_map(|p| &p.populations) {
        let measures: Vec<String> = population
            .measures
            .iter()
            .map(|m| {
                format!(
                    "{} H {} w {}",
                    m.measure,
                    fixed(m.entropy_nats, 2),
                    fixed(m.weight, 2)
                )
            })
            .collect();
        lines.push(format!(
            "{}: {} scored, {}",
            population.population,
            population.n,
            measures.join(", ")
        ));
    }
    lines
}

fn success_text(success: &Success) -> String {
    let mut text = format!(
        "\n## Success by anomaly score\n\n{} judgements from {}; {} videos compared, mean over videos ± standard error (ddof 1 / √n), percent.\n\n",
        success.judgements,
        cell(&success.labels),
        success.compared
    );
    let names: Vec<&str> = success.sets.iter().map(|rate| rate.set.name()).collect();
    let mut table = Table::new(&["task"], &names);
    for task in &success.tasks {
        let name = task.task.as_deref().unwrap_or("(no task)");
        table.row(name, task.sets.iter().map(rate_cell).collect());
    }
    table.row(
        "**all tasks**",
        success.sets.iter().map(rate_cell).collect(),
    );
    text.push_str(&table.text);
    text.push('\n');
    for difference in &success.differences {
        let _ = writeln!(
            text,
            "- {} over {}: {} points",
            difference.of.name(),
            difference.over.name(),
            signed(difference.points, difference.standard_error)
        );
    }
    if let Some(area) = &success.auroc_failure {
        let _ = writeln!(
            text,
            "- AUROC of the anomaly score for failure: {}",
            auroc(area)
        );
    }
    if !success.real.is_empty() {
        text.push_str("\nAgainst the real world:\n\n");
        let mut table = Table::new(&["set"], &["real", "judged minus real, points"]);
        for gap in &success.real {
            let gap_text = signed(gap.gap_points, gap.standard_error);
            table.row(gap.set.name(), vec![rate_text(&gap.real), gap_text]);
        }
        text.push_str(&table.text);
    }
    let unscored = success.without_score.iter();
    let unscored = unscored.map(|missing| format!("{} ({})", missing.video, missing.reason));
    let lists = [
        ("labelled videos without a score", unscored.collect()),
        (
            "scored videos without a label",
            success.without_label.clone(),
        ),
        (
            "tasks with fewer than three compared videos",
            success.tasks_left_out.clone(),
        ),
    ];
    text.push('\n');
    for (what, names) in lists {
        text.push_str(&list(what, &names));
    }
    let _ = writeln!(
        text,
        "- rows without a judgement: {}",
        success.empty_judgements
    );
    text
}

fn populations_text(found: &Populations) -> String {
    let mut text = format!(
        "\n## Populations by {}\n\nEach by itself: {} equal bins over {}; H in nats.\n\n",
        cell(&found.column),
        found.bins,
        match found.range {
            Range::Full => "the full range",
            Range::Winsorised => "the winsorised range",
        }
    );
    let measures = found
        .populations
        .first()
        .map(|first| first.measures.as_slice());
    let measures: Vec<&str> = measures
        .unwrap_or_default()
        .iter()
        .map(|m| m.measure.as_str())
        .collect();
    let of =
        |what: &str| -> Vec<String> { measures.iter().map(|m| format!("{what} {m}")).collect() };
    let mut columns = vec!["n".to_owned()];
    columns.extend(["mean", "H", "w"].iter().flat_map(|what| of(what)));
    columns.push("mean anomaly".to_owned());
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let mut table = Table::new(&["population"], &columns);
    for population in &found.populations {
        let mut cells = vec![population.n.to_string()];
        cells.extend(population.measures.iter().map(|m| fixed(m.mean, 3)));
        cells.extend(population.measures.iter().map(|m| fixed(m.entropy_nats, 2)));
        cells.extend(population.measures.iter().map(|m| fixed(m.weight, 2)));
        cells.push(fixed(population.anomaly_mean, 3));
        table.row(&population.population, cells);
    }
    text.push_str(&table.text);
    text.push('\n');
    if let (Some(area), [first, second]) = (
        &found.auroc_first_above_second,
        found.populations.as_slice(),
    ) {
        let _ = writeln!(
            text,
            "- AUROC of the anomaly score, {} above {}: {}",
            cell(&first.population),
            cell(&second.population),
            auroc(area)
        );
    }
    if found.without > 0 {
        let _ = writeln!(
            text,
            "- scored rows without a population: {}",
            found.without
        );
    }
    text
}

/// `66.0 ± 6.6 (50)`.
pub(crate) fn rate_text(rate: &SuccessRate) -> String {
    format!(
        "{} ({})",
        plus_minus(rate.percent, rate.standard_error),
        rate.n
    )
}

fn rate_cell(rate: &SetRate) -> String {
    rate_text(&rate.rate)
}

/// `0.84 [0.71, 0.93] (29 against 30)`.
pub(crate) fn auroc(area: &Auroc) -> String {
    let (lo, hi) = area.interval_95;
    format!(
        "{:.2} [{lo:.2}, {hi:.2}] ({} against {})",
        area.area, area.positives, area.negatives
    )
}

fn plus_minus(value: f64, error: Option<f64>) -> String {
    match error {
        Some(error) => format!("{value:.1} ± {error:.1}"),
        None => format!("{value:.1}"),
    }
}

pub(crate) fn signed(value: f64, error: Option<f64>) -> String {
    let sign = if value > 0.0 { "+" } else { "" };
    format!("{sign}{}", plus_minus(value, error))
}

fn fixed(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.decimals$}"))
}

/// `- what: n: first, second, …`
fn list(what: &str, names: &[String]) -> String {
    let mut line = format!("- {what}: {}", names.len());
    if !names.is_empty() {
        let shown: Vec<String> = names.iter().take(LISTED).map(|name| cell(name)).collect();
        let _ = write!(line, ": {}", shown.join(", "));
        if names.len() > LISTED {
            line.push_str(", … (all in evaluation.json)");
        }
    }
    line.push('\n');
    line
}

/// Text that cannot break a table: no line ends, no column separators, no markup.
fn cell(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '|' | '*' | '`' | '<' | '>' | '[' | ']' | '\\' => safe.extend(['\\', c]),
            c if c.is_control() => safe.extend(c.escape_default()),
            c => safe.push(c),
        }
    }
    safe
}

struct Table {
    text: String,
}

impl Table {
    fn new(names: &[&str], numbers: &[&str]) -> Self {
        let all: Vec<&str> = names.iter().chain(numbers).copied().collect();
        let rule: Vec<&str> = names
            .iter()
            .map(|_| "---")
            .chain(numbers.iter().map(|_| "---:"))
            .collect();
        Self {
            text: format!("| {} |\n| {} |\n", all.join(" | "), rule.join(" | ")),
        }
    }

    fn row(&mut self, name: &str, cells: Vec<String>) {
        let name = if name.starts_with("**") {
            name.to_owned()
        } else {
            cell(name)
        };
        let _ = writeln!(self.text, "| {name} | {} |", cells.join(" | "));
    }
}
