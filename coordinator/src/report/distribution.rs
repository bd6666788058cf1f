//! How the anomaly scores are spread, in the corpus and in each group: small histograms on one
//! axis.

use maud::{Markup, html};

use super::axis::{Axis, as_float, median};
use super::page::Section;
use super::series::tenth;
use super::{Judged, text};
use crate::reduce::outcome::SignalStatistics;

/// Groups drawn; more would be a wall.
const GROUPS: usize = 24;
/// Bins of the anomaly histograms; the paper's bins belong to its measures.
const BINS: usize = 30;

/// Drawing units of one histogram.
const WIDTH: f64 = 300.0;
const HEIGHT: f64 = 84.0;

pub(super) fn section(judged: &Judged<'_>) -> Section {
    let axis = Axis::trimmed(judged.worst_first.iter().map(|scored| scored.anomaly));
    Section {
        id: "groups",
        title: if judged.grouped() {
            "Scores by group"
        } else {
            "Scores"
        },
        body: axis.map(|axis| body(judged, axis)),
    }
}

fn body(judged: &Judged<'_>, axis: Axis) -> Markup {
    let all: Vec<f64> = judged.worst_first.iter().map(|s| s.anomaly).collect();
    let mut panels: Vec<(Markup, Vec<f64>)> = Vec::new();
    if judged.grouped() {
        for (name, _) in judged.groups.iter().take(GROUPS) {
            let values = judged
                .worst_first
                .iter()
                .filter(|scored| scored.row.group.as_deref() == *name)
                .map(|scored| scored.anomaly)
                .collect();
            panels.push((text::group(*name), values));
        }
        // The worst group first; both lists are sorted, so equal medians keep the order by size.
        panels.sort_by(|a, b| middle(&b.1).total_cmp(&middle(&a.1)));
    }
    let beyond = all.iter().filter(|value| !axis.holds(**value)).count();
    html! {
        p.lead {
            "Anomaly scores" @if judged.grouped() { ", all groups on one axis, the group with the highest median first" }
            ". The line marks the median; each panel has its own height."
            @if beyond > 0 { " " (text::length(beyond)) " beyond the axis stand in the outer bars." }
        }
        div.panels {
            (panel(&html! { "All videos" }, &all, axis, "all"))
            @for (name, values) in &panels { (panel(name, values, axis, "")) }
        }
        @if judged.groups.len() > GROUPS {
            p.more { "The " (GROUPS) " largest of " (text::length(judged.groups.len())) " groups are drawn; scores.* has them all." }
        }
    }
}

fn middle(worst_first: &[f64]) -> f64 {
    median(worst_first).unwrap_or(f64::NEG_INFINITY)
}

fn panel(name: &Markup, worst_first: &[f64], axis: Axis, class: &str) -> Markup {
    let mut counts = vec![0_u64; BINS];
    for value in worst_first {
        if let Some(count) = counts.get_mut(axis.bin(*value, BINS)) {
            *count += 1;
        }
    }
    let middle = median(worst_first);
    html! {
        figure class={ "panel " (class) } {
            figcaption { span.name { (name) } span.quiet { (text::length(worst_first.len())) } }
            (histogram(&counts, axis, middle, 4))
            p.quiet { "median " (text::signed(middle)) }
        }
    }
}

/// The histogram of one of the paper's measures, as the entropy saw it.
pub(super) fn signal_histogram(signal: &SignalStatistics) -> Option<Markup> {
    let (lo, hi) = (*signal.edges.first()?, *signal.edges.last()?);
    let axis = Axis::spanning(lo, hi);
    Some(histogram(&signal.counts, axis, signal.mean, 7))
}

/// Bars over `axis`, a line at `mark`, and about `ticks` ticks below.
fn histogram(counts: &[u64], axis: Axis, mark: Option<f64>, ticks: usize) -> Markup {
    let highest = counts.iter().copied().max().unwrap_or(0).max(1);
    let bar = WIDTH / as_float(counts.len().max(1));
    // A bar never vanishes: a single outlier among thousands must show.
    const LEAST: f64 = 1.5;
    #[expect(clippy::cast_precision_loss, reason = "bar heights on a page")]
    let height = |count: u64| (HEIGHT * count as f64 / highest as f64).max(LEAST);
    html! {
        div.histogram {
            svg viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } preserveAspectRatio="none" aria-hidden="true" {
                @for (index, count) in counts.iter().enumerate() {
                    @if *count > 0 {
                        rect x=(tenth(as_float(index) * bar + bar * 0.06)) width=(tenth(bar * 0.88))
                            y=(tenth(HEIGHT - height(*count))) height=(tenth(height(*count))) {
                            title { (text::count(*count)) }
                        }
                    }
                }
                path.base d={ "M0 " (HEIGHT) "H" (WIDTH) } {}
                @if let Some(mark) = mark {
                    path.mark d={ "M" (tenth(axis.position(mark) * WIDTH)) " 0V" (HEIGHT) } {}
                }
            }
            div.ticks aria-hidden="true" {
                @for (value, label) in axis.ticks(ticks) {
                    span style={ "left:" (tenth(axis.position(value) * 100.0)) "%" } { (label) }
                }
            }
        }
    }
}
