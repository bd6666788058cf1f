//! The paper's two measures: their histograms, entropies H and weights w per population, as the
//! paper's Table 2 has them, and how firm the weights are.

use std::collections::BTreeMap;

use maud::{Markup, PreEscaped, html};

use super::axis::Axis;
use super::chart::{self, Histogram};
use super::page::Section;
use super::{ReportInput, signal_columns, text};
use crate::reduce::outcome::{Population, Range, Recipe, SignalStatistics, WeightSensitivity};
use crate::reduce::recipe::Signal;

/// The measures by the name that the statistics have for them, and what a reader calls them.
const MEASURES: [(&str, &str, &str); 2] = [
    ("reproj_px", "Geometric", "reprojection residual, px"),
    (
        "aepe_worldscore_px",
        "Photometric",
        "forward/backward end-point error, px",
    ),
];
/// Groups listed; corpus.json has them all.
const GROUPS: usize = 60;

pub(super) fn section(input: &ReportInput<'_>) -> Section {
    let statistics = &input.corpus.statistics;
    let columns = signal_columns(input.rows);
    let known = |population: &Population| {
        MEASURES
            .iter()
            .any(|(name, ..)| population.signals.contains_key(*name))
    };
    let body = known(&statistics.corpus).then(|| {
        html! {
            p.lead {
                "Weights follow the entropy of each measure: the more its histogram is spread, the less it counts. "
                (statistics.bins) " equal bins over "
                @match statistics.range {
                    Range::Full => "the full range",
                    Range::Winsorised => "the 0.5–99.5% range",
                }
                "; the dashed line marks the mean. "
                @if statistics.reference.is_some() {
                    "This run is scored against a reference: these weights are for comparison only."
                } @else if statistics.recipe == Recipe::Balanced {
                    "This run’s score uses the balanced recipe: these weights are for comparison only."
                }
            }
            div.panels.wide { @for measure in MEASURES { (histogram(&statistics.corpus, measure, &columns)) } }
            (weights(&statistics.corpus, &statistics.groups))
            @if let Some(sensitivity) = &statistics.sensitivity {
                (firmness(&statistics.corpus.weights, sensitivity))
            }
        }
    });
    Section {
        id: "measures",
        title: "The paper’s two measures",
        body,
    }
}

fn histogram(
    corpus: &Population,
    (name, title, unit): (&str, &str, &str),
    columns: &[(Signal, &str)],
) -> Markup {
    let column = columns.iter().find(|(signal, _)| signal.column() == name);
    let Some(signal) = corpus.signals.get(name) else {
        return html! {};
    };
    html! {
        figure.panel {
            figcaption { span.name { (title) } code { (column.map_or(name, |(_, column)| *column)) } }
            @if let Some(bars) = as_the_entropy_saw_it(signal, title, unit) { (PreEscaped(bars)) }
            p.quiet {
                "H " (text::fixed(signal.entropy_nats, 2)) " nats · mean " (text::magnitude(signal.mean))
                " · σ " (text::magnitude(signal.std)) " · median " (text::magnitude(signal.median))
                @if signal.degenerate { " · no spread: weighs nothing" }
            }
        }
    }
}

/// The very bins behind the entropy.
fn as_the_entropy_saw_it(signal: &SignalStatistics, title: &str, unit: &str) -> Option<String> {
    let (lo, hi) = (*signal.edges.first()?, *signal.edges.last()?);
    #[expect(clippy::cast_precision_loss, reason = "shares on a page")]
    let count = |count: &u64| *count as f64;
    let all: f64 = signal.counts.iter().map(count).sum();
    let shares: Vec<f64> = signal
        .counts
        .iter()
        .map(|n| count(n) / all.max(1.0))
        .collect();
    let highest = shares.iter().copied().fold(0.0, f64::max);
    let says = format!(
        "{title} measure over {} bins, mean {}; the fullest bin holds {}% of the videos",
        text::length(signal.counts.len()),
        text::magnitude(signal.mean),
        text::fixed(Some(100.0 * highest), 0)
    );
    chart::histogram(&Histogram {
        axis: Axis::spanning(lo, hi),
        shares: &shares,
        outlines: &[],
        mark: signal.mean,
        unit,
        says: &says,
    })
}

fn weights(corpus: &Population, groups: &BTreeMap<String, Population>) -> Markup {
    let line = |name: Markup, population: &Population| {
        let entropy = |measure: &str| {
            let signal = population.signals.get(measure);
            text::fixed(signal.and_then(|signal| signal.entropy_nats), 2)
        };
        html! {
            tr {
                th scope="row" { (name) }
                td { (text::count(population.n)) }
                @for (measure, ..) in MEASURES { td { (entropy(measure)) } }
                @for (measure, ..) in MEASURES {
                    td { (text::fixed(population.weights.get(measure).copied(), 2)) }
                }
            }
        }
    };
    html! {
        h3 { "Entropies and weights" }
        div.scroll {
            table.numbers {
                thead {
                    tr {
                        th scope="col" { "Population" }
                        th scope="col" { "Scored" }
                        @for symbol in ["H", "w"] {
                            @for (_, title, _) in MEASURES { th scope="col" { i { (symbol) } " " (title.to_lowercase()) } }
                        }
                    }
                }
                tbody {
                    (line(html! { strong { "Whole corpus" } }, corpus))
                    @for (name, population) in groups.iter().take(GROUPS) { (line(text::name(name), population)) }
                }
            }
        }
        @if groups.len() > GROUPS {
            p.more { (GROUPS) " of " (text::length(groups.len())) " groups; corpus.json has them all." }
        }
    }
}

fn firmness(published: &BTreeMap<String, f64>, sensitivity: &WeightSensitivity) -> Markup {
    let bins = &sensitivity.freedman_diaconis_bins;
    let line = |name: &str,
                weights: &BTreeMap<String, f64>,
                bins: Option<&BTreeMap<String, u16>>| {
        html! {
            tr {
                th scope="row" { (name) }
                @for (measure, ..) in MEASURES {
                    td {
                        (text::fixed(weights.get(measure).copied(), 2))
                        @if let Some(bins) = bins.and_then(|bins| bins.get(measure)) { span.quiet { " (" (bins) " bins)" } }
                    }
                }
            }
        }
    };
    html! {
        h3 { "How firm the weights are" }
        div.scroll {
            table.numbers {
                thead {
                    tr {
                        th scope="col" { "Histogram" }
                        @for (_, title, _) in MEASURES { th scope="col" { i { "w" } " " (title.to_lowercase()) } }
                    }
                }
                tbody {
                    (line("As used", published, None))
                    (line("Freedman–Diaconis bins", &sensitivity.freedman_diaconis, Some(bins)))
                    (line("0.5–99.5% range", &sensitivity.winsorised, None))
                }
            }
        }
        p.more {
            "Leaving out one video changes a weight by at most "
            (text::fixed(Some(sensitivity.leave_one_out_max_change), 3))
            @if let Some(video) = &sensitivity.leave_one_out_video { " (" (text::name(video)) ")" }
            "."
        }
    }
}
