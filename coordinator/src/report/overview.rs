//! The first screen: counts, warnings, and how to read a score.

use maud::{Markup, html};
use plumbline_common::row::{Decision, Status};

use super::page::Section;
use super::{ReportInput, text};
use crate::reduce::outcome::Recipe;

/// Warnings shown in full; a broken corpus could have one per group.
const WARNINGS: usize = 20;

pub(super) fn section(input: &ReportInput<'_>) -> Section {
    Section {
        id: "overview",
        title: "Overview",
        body: Some(html! {
            (counts(input))
            (warnings(&input.corpus.statistics.warnings))
            (how_to_read(input))
        }),
    }
}

fn counts(input: &ReportInput<'_>) -> Markup {
    let total = input.rows.len();
    let scored = input
        .rows
        .iter()
        .filter(|row| row.measured.status == Status::Scored)
        .count();
    let decided = |decision| {
        input
            .rows
            .iter()
            .filter(|row| row.decision == decision)
            .count()
    };
    let (keep, drop, review) = (
        decided(Decision::Keep),
        decided(Decision::Drop),
        decided(Decision::Review),
    );
    let card = |class: &str, label: &str, value: usize, note: &str| {
        html! {
            div class={ "card " (class) } {
                span.label { (label) }
                strong { (text::length(value)) }
                span.note { (note) }
            }
        }
    };
    html! {
        div.cards {
            (card("", "Videos", total, "in the source"))
            (card("", "Scored", scored, &share(scored, total)))
            (card("keep", "Keep", keep, &share(keep, total)))
            (card("drop", "Drop", drop, &share(drop, total)))
            (card("review", "Review", review, "no score to decide by"))
        }
        @if total > 0 {
            div.split role="img" aria-label={ (keep) " keep, " (drop) " drop, " (review) " review" } {
                @for (class, value) in [("keep", keep), ("drop", drop), ("review", review)] {
                    @if value > 0 { span class=(class) style={ "flex-grow:" (value) } {} }
                }
            }
        }
    }
}

fn share(part: usize, total: usize) -> String {
    if total == 0 {
        return "of none".to_owned();
    }
    let percent = 100.0 * super::axis::as_float(part) / super::axis::as_float(total);
    format!("{percent:.1}% of all")
}

fn warnings(warnings: &[String]) -> Markup {
    html! {
        @if !warnings.is_empty() {
            div.warnings role="note" {
                h3 { "Read first" }
                ul {
                    @for warning in warnings.iter().take(WARNINGS) {
                        li { (text::visible(warning)) }
                    }
                }
                @if warnings.len() > WARNINGS {
                    p { "… and " (text::length(warnings.len() - WARNINGS)) " more in corpus.json." }
                }
            }
        }
    }
}

fn how_to_read(input: &ReportInput<'_>) -> Markup {
    let statistics = &input.corpus.statistics;
    let recipe = match statistics.recipe {
        Recipe::Paper => {
            "It combines the two z-scored measures, geometric and photometric, by entropy weights."
        }
        Recipe::Balanced => {
            "It is the mean of two families of motion-balanced signals, each as a robust z-score."
        }
    };
    let population = match statistics.reference {
        Some(_) => "the frozen reference",
        None => "this corpus",
    };
    html! {
        div.reading {
            div {
                h3 { "Lower is better" }
                p { "The anomaly score says how far a video stands from " (population) ": near 0 is usual, positive is less consistent. " (recipe) }
            }
            div {
                h3 { "It is relative" }
                p { "A score ranks the videos of this run. It is no absolute grade: do not compare scores of different runs, unless both were scored against one frozen reference." }
            }
            div {
                h3 { "Compare within a source" }
                p { "Camera, resolution and robot leave traces in every measure. Read groups side by side before you rank across them." }
            }
            div {
                h3 { "Motion stands beside" }
                p { "Errors grow with motion. Where a video moves much more than its peers, part of its score is that; the motion chart below says how much." }
            }
        }
    }
}
