//! The page: what to use, the fronts, the table, and how far each number can be trusted.
//!
//! Styled and guarded as the report is (`report/page.rs`): self-contained, no request, light and dark, all
//! text escaped.

use maud::{Markup, PreEscaped, html};
use plumbline_worker::explain::scatter::ScatterPanel;

use super::picture::{COST_TITLE, panels};
use super::{PointResult, Tradeoff, table};
use crate::reduce::recipe::Signal;
use crate::report::chart::fronts as fronts_of;
use crate::report::page::{self, Section};
use crate::report::text;

/// The page.
pub(super) fn render(found: &Tradeoff) -> String {
    let title = found.source.join(", ");
    let sections = [
        answer(found),
        fronts(found),
        points(found),
        measures(found),
        faults(found),
        provenance(found),
    ];
    page::assemble("What each second buys on", &title, sections, None)
}

fn answer(found: &Tradeoff) -> Section {
    let sentence = table::sentence(found);
    let top = found.points.iter().find(|point| point.top);
    Section {
        id: "answer",
        title: "What to use",
        body: Some(html! {
            p.lead { (text::visible(&capitalised(&sentence))) }
            @if let Some(warning) = table::warning(found) {
                div.warnings { (capitalised(&warning)) "." }
            }
            @if let Some(top) = top {
                div.reading {
                    div {
                        h3 { "The top point is a yardstick, not the truth" }
                        p {
                            "Order, score error and flips are against " (text::name(&top.name)) ". Of its own "
                            (text::length(top.agreement.flips.videos as usize)) " decisions on this sample, "
                            (text::length(found.top_uncertain))
                            " lie within its intervals: another take of the same video might be decided the other way."
                        }
                    }
                    div {
                        h3 { "What does not depend on it" }
                        p {
                            "Rendered scenes have exact flow, cameras and depths, and known faults. Where a cheaper point is as good there, what it lacks against the top one is difference, not error."
                        }
                    }
                    div {
                        h3 { "How far the sample reaches" }
                        p {
                            (text::length(found.sample.len())) " of " (text::length(found.corpus_videos))
                            " videos were measured at every point. Intervals of time and flips are 90%, from this sample alone; "
                            (table::reach(found)) "."
                        }
                    }
                }
            }
        }),
    }
}

fn capitalised(sentence: &str) -> String {
    let mut chars = sentence.chars();
    chars.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(chars).collect()
    })
}

fn fronts(found: &Tradeoff) -> Section {
    let panels = panels(found);
    Section {
        id: "fronts",
        title: "Fronts",
        body: (!panels.is_empty()).then(|| {
            html! {
                p.lead { "Each point by what it costs and what it gives; the line joins those that no other beats." }
                div.panels.wide { @for panel in &panels { (plot(panel)) } }
            }
        }),
    }
}

/// A panel's drawing, and its points as numbers for those who do not see it.
fn plot(panel: &ScatterPanel) -> Markup {
    html! {
        figure.panel.scatter {
            @if let Some(chart) = fronts_of(panel, COST_TITLE) { (PreEscaped(chart)) }
            details.numbers {
                summary { "Numbers" }
                div.scroll tabindex="0" role="region" aria-label=(panel.title) { table {
                    thead { tr {
                        th scope="col" { "point" }
                        th scope="col" { "CPU s" }
                        th scope="col" { "value" }
                        th scope="col" { "front" }
                    } }
                    tbody { @for mark in &panel.marks { tr {
                        th scope="row" { (mark.name) }
                        td { (text::magnitude(Some(libm::pow(10.0, mark.x)))) }
                        td { (text::magnitude(Some(mark.y))) }
                        td { @if mark.on_front { "yes" } }
                    } } }
                } }
            }
        }
    }
}

fn points(found: &Tradeoff) -> Section {
    let labelled = found
        .points
        .iter()
        .any(|point| point.auroc_failure.is_some());
    Section {
        id: "points",
        title: "Points",
        body: Some(html! {
            p.lead {
                "The cheapest first; * is the front of cost and Spearman's ρ. Scores are by the recipe "
                (crate::reduce::recipe_name(found.recipe)) ", decisions by the keep rule " (text::visible(&found.keep)) "."
            }
            div.scroll tabindex="0" role="region" aria-label="Points" {
                table.numbers.dense {
                    thead { tr {
                        @for (k, heading) in table::HEADINGS.iter().enumerate() { th scope="col" .left[k == 0] { (heading) } }
                        @if labelled { th scope="col" { "AUROC failure" } }
                        th scope="col" { "flips within intervals" }
                        th scope="col" { "planned CPU" }
                        th scope="col" { "planned wall" }
                        th.left scope="col" { "--profile" }
                    } }
                    tbody { @for point in &found.points { (line(point, labelled)) } }
                }
            }
        }),
    }
}

fn line(point: &PointResult, labelled: bool) -> Markup {
    let plan = point.plan.as_ref();
    html! {
        tr {
            @for (k, cell) in table::cells(point).iter().enumerate() {
                @if k == 0 { th.left scope="row" { (text::name(cell)) } } @else { td { (cell) } }
            }
            @if labelled { td { (text::fixed(point.auroc_failure.map(|found| found.area), 3)) } }
            td { (text::length(point.agreement.flips_within_interval as usize)) }
            td { (plan.map_or(text::MISSING.to_owned(), |plan| table::duration(plan.cpu_s))) }
            td { (plan.map_or(text::MISSING.to_owned(), |plan| table::duration(plan.wall_s))) }
            td.left { (text::name(&point.profile)) }
        }
    }
}

fn measures(found: &Tradeoff) -> Section {
    Section {
        id: "measures",
        title: "Which measures move",
        body: Some(html! {
            p.lead { "Spearman's ρ of each recipe and measure against the top point: what a cheaper point loses, it loses here." }
            div.scroll tabindex="0" role="region" aria-label="Measures" {
                table.numbers.dense {
                    thead { tr {
                        th.left scope="col" { "point" }
                        th scope="col" { "paper" }
                        th scope="col" { "balanced" }
                        @for signal in Signal::ALL { th scope="col" { (signal.column().replace('_', " ")) } }
                    } }
                    tbody { @for point in &found.points { tr {
                        th.left scope="row" { (text::name(&point.name)) }
                        @for recipe in ["paper", "balanced"] {
                            td { (text::fixed(point.spearman_by_recipe.get(recipe).copied().flatten(), 3)) }
                        }
                        @for signal in Signal::ALL {
                            td { (text::fixed(point.agreement.spearman_by_signal.get(signal.column()).copied().flatten(), 3)) }
                        }
                    } } }
                }
            }
        }),
    }
}

fn faults(found: &Tradeoff) -> Section {
    let kinds: std::collections::BTreeSet<&String> = found
        .points
        .iter()
        .filter_map(|point| point.faults.as_ref())
        .flat_map(|faults| faults.kinds.keys())
        .collect();
    Section {
        id: "faults",
        title: "Known faults",
        body: (!kinds.is_empty()).then(|| {
            html! {
                p.lead { "AUROC of the detector meant for each kind, and how often its worst frame is the fault's (within one): rendered clips against their clean twins. No detector is meant for morphs; they are left out of the means." }
                div.scroll tabindex="0" role="region" aria-label="Known faults" {
                    table.numbers.dense {
                        thead { tr {
                            th.left scope="col" { "point" }
                            @for kind in &kinds { th scope="col" { (kind.replace('_', " ")) } }
                        } }
                        tbody { @for point in &found.points { @if let Some(faults) = &point.faults { tr {
                            th.left scope="row" { (text::name(&point.name)) }
                            @for kind in &kinds {
                                td { @if let Some(found) = faults.kinds.get(*kind) {
                                    (format!("{:.2} / {:.2}", found.auroc, found.temporal_hit))
                                } @else { (text::MISSING) } }
                            }
                        } } } }
                    }
                }
            }
        }),
    }
}

fn provenance(found: &Tradeoff) -> Section {
    Section {
        id: "provenance",
        title: "Provenance",
        body: Some(html! {
            div.scroll { table {
                tbody {
                    tr { th scope="row" { "program" } td.left { "plumbline " (env!("CARGO_PKG_VERSION")) } }
                    @for point in &found.points {
                        tr { th scope="row" { (text::name(&point.name)) } td.left { (point.profile_digest) } }
                    }
                }
            } }
        }),
    }
}
