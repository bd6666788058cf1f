//! Motion against anomaly, by group, with Spearman's ρ: how much of the score follows motion.

use maud::{Markup, PreEscaped, html};

use super::axis::Axis;
use super::chart::{Point, marker, scatter};
use super::facet::{COLOURED, Facet};
use super::page::Section;
use super::{Judged, text};
use crate::agreement::spearman;

/// Points drawn; beyond, every k-th by rank, so that the cloud keeps its shape.
const POINTS: usize = 2_000;
/// Fewest videos for a correlation worth stating.
const FEWEST: usize = 8;

pub(super) fn section(judged: &Judged<'_>) -> Section {
    let groups = Facet::all(judged, 1).into_iter().next();
    let points: Vec<Point> = judged
        .worst_first
        .iter()
        .filter_map(|scored| {
            Some(Point {
                x: scored
                    .row
                    .measured
                    .motion_px
                    .filter(|motion| motion.is_finite())?,
                y: scored.anomaly,
                series: groups
                    .as_ref()
                    .map_or(0, |groups| groups.series(scored.row)),
            })
        })
        .collect();
    let axes = Axis::trimmed(points.iter().map(|point| point.x))
        .zip(Axis::trimmed(points.iter().map(|point| point.y)));
    Section {
        id: "motion",
        title: "Motion",
        body: axes.map(|(x, y)| body(groups.as_ref(), &points, x.padded(0.03), y.padded(0.05))),
    }
}

fn body(groups: Option<&Facet<'_>>, points: &[Point], x: Axis, y: Axis) -> Markup {
    let pairs: Vec<(f64, f64)> = points.iter().map(|point| (point.x, point.y)).collect();
    let step = points.len().div_ceil(POINTS).max(1);
    let drawn: Vec<Point> = points.iter().step_by(step).copied().collect();
    let pinned = points
        .iter()
        .filter(|point| !(x.holds(point.x) && y.holds(point.y)))
        .count();
    let verdict = verdict(&pairs);
    let says = format!("Anomaly score over mean motion. {verdict}");
    html! {
        p.lead { (verdict) }
        figure.scatter {
            @if let Some(groups) = groups { (legend(groups)) }
            @if let Some(chart) = scatter(&drawn, (x, "mean motion, px per frame"), (y, "anomaly score"), &says) {
                (PreEscaped(chart))
            }
            figcaption {
                @if step > 1 { "One in " (step) " of the " (text::length(points.len())) " videos is drawn. " }
                @if pinned > 0 { (text::length(pinned)) " beyond the axes stand at their edge." }
            }
        }
    }
}

fn verdict(pairs: &[(f64, f64)]) -> String {
    /// Below, motion explains less than a tenth of the ranks' variance; above the second, a quarter.
    const WEAK: f64 = 0.3;
    const STRONG: f64 = 0.5;
    match spearman(pairs).filter(|_| pairs.len() >= FEWEST) {
        None => "Too few videos, or no spread, to say whether the score follows motion.".to_owned(),
        Some(rho) => {
            let meaning = match rho.abs() {
                size if size < WEAK => "the score says little about motion in this corpus.",
                size if size < STRONG => {
                    "part of the score follows motion: compare videos that move alike."
                }
                _ => {
                    "much of the score follows motion: compare only videos that move alike, or use the balanced recipe."
                }
            };
            format!(
                "Spearman ρ between motion and anomaly is {}: {meaning}",
                text::signed(Some(rho))
            )
        }
    }
}

fn legend(groups: &Facet<'_>) -> Markup {
    let key = |series: usize| html! { @if let Some(mark) = marker(series) { (PreEscaped(mark)) } };
    let rest = groups.names.len().saturating_sub(COLOURED);
    html! {
        ul.legend {
            @for (series, (name, _)) in groups.names.iter().take(COLOURED).enumerate() {
                li { (key(series)) (text::group(*name)) }
            }
            @if rest > 0 { li { (key(COLOURED)) (text::length(rest)) " more" } }
        }
    }
}
