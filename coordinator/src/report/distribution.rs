//! How the anomaly scores of each group are spread: small histograms on one axis.

use maud::{Markup, PreEscaped, html};

use super::axis::{Axis, median};
use super::chart::{Histogram, histogram};
use super::page::Section;
use super::{Judged, text};

/// Groups drawn; more would be a wall.
const GROUPS: usize = 24;
/// Bins; the paper's belong to its measures.
const BINS: usize = 30;

pub(super) fn section(judged: &Judged<'_>) -> Section {
    let axis = Axis::trimmed(judged.worst_first.iter().map(|scored| scored.anomaly));
    Section {
        id: "groups",
        title: "Scores by group",
        body: axis
            .filter(|_| judged.grouped())
            .map(|axis| body(judged, axis)),
    }
}

fn body(judged: &Judged<'_>, axis: Axis) -> Markup {
    let groups = judged.groups.iter().take(GROUPS);
    let mut panels: Vec<(Option<&str>, Vec<f64>)> = groups
        .map(|(name, _)| {
            let of_group = judged
                .worst_first
                .iter()
                .filter(|scored| scored.row.group.as_deref() == *name);
            (*name, of_group.map(|scored| scored.anomaly).collect())
        })
        .collect();
    // The worst group first; both lists are sorted, so equal medians keep the order by size.
    let middle = |values: &[f64]| median(values).unwrap_or(f64::NEG_INFINITY);
    panels.sort_by(|a, b| middle(&b.1).total_cmp(&middle(&a.1)));
    html! {
        p.lead { "Anomaly scores, all groups on one axis, the group with the highest median first. The dashed line marks the median; each panel has its own height." }
        div.panels {
            @for (name, values) in &panels { (panel(*name, values, axis)) }
        }
        @if judged.groups.len() > GROUPS {
            p.more { "The " (GROUPS) " largest of " (text::length(judged.groups.len())) " groups are drawn; scores.* has them all." }
        }
    }
}

fn panel(name: Option<&str>, worst_first: &[f64], axis: Axis) -> Markup {
    let middle = median(worst_first);
    let says = format!(
        "Anomaly scores of {}, median {}",
        text::plain_name(name.unwrap_or("videos without a group"), 60),
        text::signed(middle)
    );
    let chart = histogram(&Histogram {
        axis,
        shares: &axis.shares(worst_first, BINS),
        outlines: &[],
        mark: middle,
        unit: "",
        says: &says,
    });
    html! {
        figure.panel {
            figcaption { span.name { (text::group(name)) } span.quiet { (text::length(worst_first.len())) } }
            @if let Some(chart) = chart { (PreEscaped(chart)) }
            p.quiet { "median " (text::signed(middle)) }
        }
    }
}
