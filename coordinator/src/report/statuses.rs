//! What was not scored, and why: counts per status, then the videos.

use std::collections::BTreeMap;

use maud::{Markup, html};
use plumbline_common::row::{Row, Status};

use super::page::Section;
use super::text;

/// Videos listed; the counts above them are complete.
const ROWS: usize = 500;
/// Distinct reasons counted on the page: reasons may quote figures of their video.
const REASONS: usize = 40;

pub(super) fn section(rows: &[Row]) -> Section {
    let unscored: Vec<&Row> = rows
        .iter()
        .filter(|row| row.measured.status != Status::Scored || row.anomaly.is_none())
        .collect();
    Section {
        id: "unscored",
        title: "Not scored",
        body: (!unscored.is_empty()).then(|| body(&unscored)),
    }
}

fn body(unscored: &[&Row]) -> Markup {
    // Reasons that differ in figures alone are one; the first of them stands where it is the only one.
    let mut counts: BTreeMap<(Status, String), (u64, &str)> = BTreeMap::new();
    for row in unscored {
        let alike = (row.measured.status, without_figures(reason(row)));
        counts.entry(alike).or_insert((0, reason(row))).0 += 1;
    }
    let mut counts: Vec<(Status, String, u64)> = counts
        .into_iter()
        .map(|((status, alike), (count, first))| match count {
            1 => (status, first.to_owned(), 1),
            _ => (status, alike, count),
        })
        .collect();
    counts.sort_by(|a, b| b.2.cmp(&a.2).then_with(|| (a.0, &a.1).cmp(&(b.0, &b.1))));
    let listed = counts.len().min(REASONS);
    html! {
        p.lead { "These " (text::length(unscored.len())) " take no part in the statistics; they are in manifests/review with their reason." }
        div.scroll {
            table.numbers {
                thead { tr { th scope="col" { "Status" } th.left scope="col" { "Reason" } th scope="col" { "Videos" } } }
                tbody {
                    @for (status, reason, count) in counts.iter().take(listed) {
                        tr {
                            th scope="row" { (label(*status)) }
                            td.left.long { (text::plain_name(reason, 300)) }
                            td { (text::count(*count)) }
                        }
                    }
                }
            }
        }
        @if counts.len() > listed {
            p.more { (text::length(counts.len() - listed)) " rarer reasons are in scores.*." }
        }
        details open[unscored.len() <= 12] {
            summary { "The videos" }
            div.scroll.tall tabindex="0" role="region" aria-label="Videos without a score" {
                table.numbers.dense {
                    thead { tr { th.left scope="col" { "Video" } th.left scope="col" { "Group" } th.left scope="col" { "Status" } th.left scope="col" { "Reason" } } }
                    tbody {
                        @for row in unscored.iter().take(ROWS) {
                            tr {
                                td.left.long { (text::name(row.video.as_str())) }
                                td.left.long { @if row.group.is_some() { (text::group(row.group.as_deref())) } @else { (text::MISSING) } }
                                td.left { (label(row.measured.status)) }
                                td.left.long { (text::plain_name(reason(row), 300)) }
                            }
                        }
                    }
                }
            }
            @if unscored.len() > ROWS {
                p.more { "The first " (ROWS) " of " (text::length(unscored.len())) "; manifests/review.jsonl has them all." }
            }
        }
    }
}

fn reason(row: &Row) -> &str {
    match &row.measured.status_reason {
        Some(reason) => reason,
        None if row.measured.status == Status::Scored => {
            "measured, but the recipe’s signals are undefined for it"
        }
        None => "no reason given",
    }
}

/// "only 1.7% at frame 10" as "only …% at frame …".
fn without_figures(reason: &str) -> String {
    let mut text = String::with_capacity(reason.len());
    let mut rest = reason;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, figure) = rest.split_at(start);
        let digits = figure.trim_start_matches(|c: char| c.is_ascii_digit());
        // A decimal point belongs to the figure, a full stop does not.
        let decimals = digits
            .strip_prefix('.')
            .filter(|after| after.starts_with(|c: char| c.is_ascii_digit()))
            .map(|after| after.trim_start_matches(|c: char| c.is_ascii_digit()));
        text.push_str(before);
        text.push('…');
        rest = decimals.unwrap_or(digits);
    }
    text.push_str(rest);
    text
}

fn label(status: Status) -> String {
    status.as_str().replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_alike_without_their_figures() {
        assert_eq!(
            without_figures("frame 103: 1.7% of 12. Longer than 4"),
            "frame …: …% of …. Longer than …"
        );
        assert_eq!(without_figures("no figure"), "no figure");
        assert_eq!(without_figures(""), "");
    }
}
