//! Every video in one table: the page's script sorts, filters and opens its rows. Without a script the
//! highest scores stand there.

use maud::{Markup, html};
use plumbline_common::row::Row;

use super::page::Section;
use super::{ReportInput, faults, text};
use crate::reduce::decision_name;

/// Rows for readers whose browser runs no scripts.
const PLAIN_ROWS: usize = 50;
const HEADINGS: [&str; 7] = [
    "video",
    "group",
    "status",
    "decision",
    "anomaly",
    "motion_px",
    "faults",
];

pub(super) fn section(input: &ReportInput<'_>, listed: &[&Row]) -> Section {
    let total = input.rows.len();
    Section {
        id: "table",
        title: "All videos",
        body: (total > 0).then(|| {
            html! {
                @if total > listed.len() {
                    p.lead {
                        "The " (text::length(listed.len())) " of " (text::length(total))
                        " videos with the highest anomaly scores, or with none; scores.parquet has every row."
                    }
                }
                form #filters hidden role="search" aria-label="Filter videos" {}
                details #columns hidden { summary { "Columns" } div.choices {} }
                p #left-out .more hidden {}
                div #videos-region .scroll.tall tabindex="0" role="region" aria-label="All videos" {
                    table #videos .dense {
                        thead { tr { @for title in HEADINGS { th.left scope="col" { (title) } } } }
                        tbody { @for row in listed.iter().take(PLAIN_ROWS) { (line(row)) } }
                    }
                }
                @if listed.len() > PLAIN_ROWS {
                    noscript { p.more { "The first " (PLAIN_ROWS) "; with scripts allowed this table holds them all, sortable and filterable." } }
                }
                div #pages hidden {
                    button #before type="button" { "Previous" }
                    output #shown aria-live="polite" {}
                    button #after type="button" { "Next" }
                }
                (dialog())
            }
        }),
    }
}

fn line(row: &Row) -> Markup {
    let decision = decision_name(row.decision);
    html! {
        tr {
            td.left.long { (text::name(row.video.as_str())) }
            td.left.long { @if row.group.is_some() { (text::group(row.group.as_deref())) } @else { (text::MISSING) } }
            td.left { (row.measured.status.as_str()) }
            td.left { span class={ "tag " (decision) } { (decision) } }
            td { b { (text::signed(row.anomaly)) } }
            td { (text::magnitude(row.measured.motion_px)) }
            td.left { (faults::told(&row.measured, 3).unwrap_or_default()) }
        }
    }
}

/// One video opened; the script fills it.
fn dialog() -> Markup {
    html! {
        dialog #video aria-labelledby="video-name" {
            header {
                h2 #video-name tabindex="-1" {}
                div.buttons {
                    button #video-before type="button" { "Previous" }
                    button #video-after type="button" { "Next" }
                    button #video-close type="button" { "Close" }
                }
            }
            p #video-why {}
            div #video-pictures {}
            div #video-series {}
            div #video-faults {}
            h3 { "Where the score comes from" }
            div #video-parts {}
            details open { summary { "Every column" } dl #video-columns {} }
        }
    }
}
