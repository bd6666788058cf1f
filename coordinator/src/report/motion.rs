//! Motion against anomaly, by group, with Spearman's ρ: how much of the score follows motion.

use maud::{Markup, PreEscaped, html};

use super::axis::{Axis, as_float};
use super::chart::{Point, marker, scatter};
use super::facet::{COLOURED, Facet};
use super::page::Section;
use super::{Judged, text};

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
                @if step > 1 { "Every " (step) "th of " (text::length(points.len())) " videos is drawn. " }
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
            format!("Spearman ρ between motion and anomaly is {rho:+.2}: {meaning}")
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

/// Spearman's ρ: Pearson's correlation of average ranks. `None` where either side has no spread.
fn spearman(pairs: &[(f64, f64)]) -> Option<f64> {
    let x = ranks(pairs.iter().map(|pair| pair.0));
    let y = ranks(pairs.iter().map(|pair| pair.1));
    let mean = (as_float(pairs.len()) + 1.0) / 2.0;
    let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in x.iter().zip(&y) {
        xy += (x - mean) * (y - mean);
        xx += (x - mean) * (x - mean);
        yy += (y - mean) * (y - mean);
    }
    (xx > 0.0 && yy > 0.0).then(|| xy / (xx.sqrt() * yy.sqrt()))
}

/// Ranks from 1; equal values share the mean of theirs.
fn ranks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sorted: Vec<(f64, usize)> = values.enumerate().map(|(i, value)| (value, i)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut ranks = vec![0.0; sorted.len()];
    let mut before = 0;
    for tie in sorted.chunk_by(|a, b| a.0 == b.0) {
        let rank = as_float(before) + (as_float(tie.len()) + 1.0) / 2.0;
        for (_, index) in tie {
            if let Some(slot) = ranks.get_mut(*index) {
                *slot = rank;
            }
        }
        before += tie.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spearman_of_known_sequences() {
        let up: Vec<_> = (0..10).map(|i| (f64::from(i), f64::from(i * i))).collect();
        assert_eq!(spearman(&up), Some(1.0));
        let down: Vec<_> = up.iter().map(|(x, y)| (*x, -y)).collect();
        assert_eq!(spearman(&down), Some(-1.0));
        assert_eq!(spearman(&[(1.0, 2.0), (1.0, 3.0)]), None);
        // Ranks (1, 2.5, 2.5, 4) against (1, 3, 2, 4): 4.5 / √(4.5 · 5).
        let tied = [(0.0, 0.0), (1.0, 5.0), (1.0, 4.0), (2.0, 9.0)];
        let rho = spearman(&tied).unwrap();
        assert!((rho - 4.5 / (4.5_f64 * 5.0).sqrt()).abs() < 1e-15);
    }
}
