//! Motion against anomaly, by group, with Spearman's ρ: how much of the score follows motion.

use maud::{Markup, html};

use super::axis::Axis;
use super::page::Section;
use super::series::tenth;
use super::{Judged, text};
use crate::agreement::spearman;

/// Points drawn; beyond, every k-th by rank, so that the cloud keeps its shape.
const POINTS: usize = 2_000;
/// Groups with a colour and a mark of their own; the others share the last.
const COLOURS: usize = 6;
/// Fewest videos for a correlation worth stating.
const FEWEST: usize = 8;
/// Drawing units.
const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 380.0;
/// Half the size of a mark.
const MARK: f64 = 3.4;

struct Point {
    motion_px: f64,
    anomaly: f64,
    series: usize,
}

pub(super) fn section(judged: &Judged<'_>) -> Section {
    let points: Vec<Point> = judged
        .worst_first
        .iter()
        .filter_map(|scored| {
            let motion_px = scored.row.measured.motion_px.filter(|m| m.is_finite())?;
            let series = judged
                .groups
                .iter()
                .take(COLOURS)
                .position(|(name, _)| *name == scored.row.group.as_deref())
                .unwrap_or(COLOURS);
            Some(Point {
                motion_px,
                anomaly: scored.anomaly,
                series,
            })
        })
        .collect();
    let axes = Axis::trimmed(points.iter().map(|point| point.motion_px))
        .zip(Axis::trimmed(points.iter().map(|point| point.anomaly)));
    Section {
        id: "motion",
        title: "Motion",
        body: axes.map(|(x, y)| body(judged, &points, x.padded(0.03), y.padded(0.05))),
    }
}

fn body(judged: &Judged<'_>, points: &[Point], x: Axis, y: Axis) -> Markup {
    let pairs: Vec<(f64, f64)> = points.iter().map(|p| (p.motion_px, p.anomaly)).collect();
    let step = points.len().div_ceil(POINTS).max(1);
    let pinned = points
        .iter()
        .filter(|point| !(x.holds(point.motion_px) && y.holds(point.anomaly)))
        .count();
    html! {
        p.lead { (verdict(&pairs)) }
        figure.scatter {
            @if judged.grouped() { (legend(judged)) }
            div.plot {
                div.yticks aria-hidden="true" {
                    @for (value, label) in y.ticks(6) {
                        span style={ "top:" (tenth(100.0 - y.position(value) * 100.0)) "%" } { (label) }
                    }
                }
                svg viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } role="img" aria-label="Anomaly score over mean motion" {
                    @for (value, _) in y.ticks(6) {
                        path.grid d={ "M0 " (tenth(HEIGHT - y.position(value) * HEIGHT)) "H" (WIDTH) } {}
                    }
                    @for (value, _) in x.ticks(6) {
                        path.grid d={ "M" (tenth(x.position(value) * WIDTH)) " 0V" (HEIGHT) } {}
                    }
                    @for point in points.iter().step_by(step) {
                        path class={ "s" (point.series) } d=(mark(
                            point.series,
                            x.position(point.motion_px) * WIDTH,
                            HEIGHT - y.position(point.anomaly) * HEIGHT,
                        )) {}
                    }
                }
                div.ticks aria-hidden="true" {
                    @for (value, label) in x.ticks(6) {
                        span style={ "left:" (tenth(x.position(value) * 100.0)) "%" } { (label) }
                    }
                }
            }
            figcaption {
                "Across: mean motion, px per frame. Up: anomaly score."
                @if step > 1 { " Every " (step) "th of " (text::length(points.len())) " videos is drawn." }
                @if pinned > 0 { " " (text::length(pinned)) " beyond the axes stand at their edge." }
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
            format!("Spearman ρ between motion and anomaly is {rho:+.2}: {meaning}")
        }
    }
}

fn legend(judged: &Judged<'_>) -> Markup {
    let rest = judged.groups.len().saturating_sub(COLOURS);
    html! {
        ul.legend {
            @for (series, (name, _)) in judged.groups.iter().take(COLOURS).enumerate() {
                li { (key(series)) (text::group(*name)) }
            }
            @if rest > 0 { li { (key(COLOURS)) (text::length(rest)) " more" } }
        }
    }
}

fn key(series: usize) -> Markup {
    html! { svg viewBox="0 0 12 12" aria-hidden="true" { path class={ "s" (series) } d=(mark(series, 6.0, 6.0)) {} } }
}

/// A mark of its own per group, so that colour is not alone in telling them apart.
fn mark(series: usize, x: f64, y: f64) -> String {
    let r = MARK;
    let at = |dx: f64, dy: f64| format!("{} {}", tenth(x + dx), tenth(y + dy));
    match series {
        0 => format!(
            "M{}a{r} {r} 0 1 0 {} 0a{r} {r} 0 1 0 -{} 0z",
            at(-r, 0.0),
            2.0 * r,
            2.0 * r
        ),
        1 => format!("M{}h{}v{}h-{}z", at(-r, -r), 2.0 * r, 2.0 * r, 2.0 * r),
        2 => format!("M{}L{}L{}z", at(0.0, -r), at(r, r), at(-r, r)),
        3 => format!(
            "M{}L{}L{}L{}z",
            at(0.0, -r * 1.3),
            at(r * 1.3, 0.0),
            at(0.0, r * 1.3),
            at(-r * 1.3, 0.0)
        ),
        4 => format!("M{}L{}L{}z", at(0.0, r), at(r, -r), at(-r, -r)),
        5 => format!("M{}h{}v{}h-{}z", at(-r, -r / 2.0), 2.0 * r, r, 2.0 * r),
        _ => format!("M{}h{}v{}h-{}z", at(-r / 2.0, -r / 2.0), r, r, r),
    }
}
