//! Every scored video in one table, the worst first, sortable and filterable where scripts run.

use maud::{Markup, html};

use super::page::Section;
use super::{Judged, ReportInput, Scored, text};
use crate::publish::scores::scene_name;
use crate::reduce::decision_name;

/// Rows on the page: what a browser sorts at once and a reader still searches.
const ROWS: usize = 2_000;

/// Heading and whether the column holds numbers.
const HEADINGS: [(&str, bool); 15] = [
    ("Rank", true),
    ("Video", false),
    ("Group", false),
    ("Decision", false),
    ("Anomaly", true),
    ("5%", true),
    ("95%", true),
    ("z reproj.", true),
    ("z end\u{2011}pt.", true),
    ("z piecew.", true),
    ("z appear.", true),
    ("Motion px", true),
    ("Reproj. px", true),
    ("Scene", false),
    ("Peak", true),
];

pub(super) fn section(input: &ReportInput<'_>, judged: &Judged<'_>) -> Section {
    let total = judged.worst_first.len();
    Section {
        id: "table",
        title: "All scored videos",
        body: (total > 0).then(|| {
            html! {
                @if total > ROWS {
                    p.lead { "The " (text::length(ROWS)) " highest anomaly scores of " (text::length(total)) "; scores.parquet has every row." }
                }
                label #filter hidden { "Filter " input type="search" placeholder="video, group, decision"; output {} }
                div.scroll.tall tabindex="0" role="region" aria-label="All scored videos" {
                    table #videos .numbers .dense {
                        thead { tr { @for (title, number) in HEADINGS { th scope="col" .left[!number] { (title) } } } }
                        tbody { @for scored in judged.worst_first.iter().take(ROWS) { (line(input, scored)) } }
                    }
                }
            }
        }),
    }
}

fn line(input: &ReportInput<'_>, scored: &Scored<'_>) -> Markup {
    let row = scored.row;
    let measured = &row.measured;
    let decision = decision_name(row.decision);
    html! {
        tr {
            td { (text::optional(row.rank)) }
            td.left.long {
                (text::name(row.video.as_str()))
                @if let Some(file) = input.heat_maps.get(&row.video) { " " a href=(file) { "heat map" } }
            }
            td.left.long { @if row.group.is_some() { (text::group(row.group.as_deref())) } @else { (text::MISSING) } }
            td.left { span class={ "tag " (decision) } { (decision) } }
            td { b { (text::signed(row.anomaly)) } }
            td { (text::signed(row.anomaly_lo)) }
            td { (text::signed(row.anomaly_hi)) }
            td { (text::signed(row.z_reproj_px)) }
            td { (text::signed(row.z_aepe_worldscore_px)) }
            td { (text::signed(row.z_piecewise_residual)) }
            td { (text::signed(row.z_appearance_ratio)) }
            td { (text::magnitude(measured.motion_px)) }
            td { (text::magnitude(measured.reproj_px)) }
            td.left { (measured.scene.map_or(text::MISSING, scene_name).replace('_', " ")) }
            td { (text::optional(measured.paper_peak_frame)) }
        }
    }
}
