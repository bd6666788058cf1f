//! What a cascade measured with which profile, and how sure its decisions are.

use maud::{Markup, html};

use super::page::Section;
use super::{ReportInput, text};
use crate::cascade::record::{CascadeRecord, RungRecord};
use crate::reduce::decision_name;

/// Rows whose decision is least certain.
const UNCERTAIN: usize = 12;

pub(super) fn section(input: &ReportInput<'_>) -> Section {
    let body = input
        .corpus
        .cascade
        .as_ref()
        .map(|cascade| html! { (told(cascade)) (rungs(cascade)) (uncertain(input)) });
    Section {
        id: "cascade",
        title: "What was measured how",
        body,
    }
}

fn told(cascade: &CascadeRecord) -> Markup {
    html! {
        p.lead {
            "Only videos whose decision was uncertain were measured with the top profile (budget "
            code { (cascade.budget) } "). It ended since: " (cascade.ended) ". "
            @if let Some(flips) = cascade.expected_flips {
                "Measured throughout with the top profile, " (text::fixed(Some(flips), 1)) " decisions are expected to be others. "
            }
            @if let Some(found) = cascade.measured_agreement {
                "Of the sample, each part judged by what the others say, " (text::count(found.agreed)) " of "
                (text::videos(found.videos)) " have the top profile’s decision. "
            }
            @if !cascade.reproducible {
                "The budget is in seconds: another run, or another machine, may measure other videos."
            }
        }
    }
}

fn rungs(cascade: &CascadeRecord) -> Markup {
    html! {
        div.scroll {
            table.numbers {
                thead { tr { @for name in ["Profile", "Measured", "Frames", "Rows from it", "Digest"] { th scope="col" { (name) } } } }
                tbody { @for rung in &cascade.profiles { (line(rung)) } }
            }
        }
    }
}

fn line(rung: &RungRecord) -> Markup {
    html! {
        tr {
            th scope="row" { (text::name(&rung.name)) }
            td { (text::count(rung.measured)) }
            td { (text::count(rung.measured_frames)) }
            td { (text::count(rung.rows)) }
            td { code { (rung.digest.get(..12).unwrap_or(&rung.digest)) } }
        }
    }
}

/// The rows that would gain most by the top profile.
fn uncertain(input: &ReportInput<'_>) -> Markup {
    let flips = input.rows.iter();
    let mut rows: Vec<_> = flips
        .filter_map(|row| Some((row.flip_probability.filter(|flip| *flip > 0.0)?, row)))
        .collect();
    rows.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.video.cmp(&b.1.video)));
    html! {
        @if !rows.is_empty() {
            h3 { "Least certain" }
            div.scroll {
                table.numbers {
                    thead { tr { @for name in ["Video", "Decision", "Anomaly", "Flips with probability"] { th scope="col" { (name) } } } }
                    tbody {
                        @for (flip, row) in rows.into_iter().take(UNCERTAIN) {
                            tr {
                                th scope="row" { (text::name(row.video.as_str())) }
                                td { span class={ "tag " (decision_name(row.decision)) } { (decision_name(row.decision)) } }
                                td { (text::signed(row.anomaly)) }
                                td { (text::fixed(Some(flip), 3)) }
                            }
                        }
                    }
                }
            }
        }
    }
}
