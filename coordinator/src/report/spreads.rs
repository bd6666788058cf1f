//! How every measure is spread: the whole corpus, its parts, and the reference it is scored against.
//!
//! Which measures there are, the columns of the rows say: one more column is one more chart.

use maud::{Markup, PreEscaped, html};

use super::axis::{Axis, median};
use super::chart::{Histogram, Ink, Outline, histogram};
use super::facet::{COLOURED, Facet};
use super::page::Section;
use super::{Judged, ReportInput, signal_columns, text};
use crate::publish::scores::score_columns;
use crate::publish::table::{Cell, Column, Kind};
use crate::reduce::distribution::Distribution;
use crate::reduce::recipe::Signal;
use crate::reduce::recipe_name;
use crate::reduce::reference::Frozen;
use plumbline_common::row::Row;

/// Bins of a chart; those behind the entropies are in “The paper’s two measures”.
const BINS: usize = 30;
/// Columns of numbers that are no measures.
const OTHERS: [&str; 7] = [
    "fps",
    "duration_s",
    "anomaly_lo",
    "anomaly_hi",
    "percentile",
    "reward",
    "rank",
];
/// Fewest values for a chart.
const FEWEST: usize = 2;

/// One measure.
struct Measure<'a> {
    name: &'a str,
    /// Value per scored video, by part.
    values: Vec<(&'a Row, f64)>,
    reference: Option<&'a Distribution>,
}

pub(super) fn section(input: &ReportInput<'_>, judged: &Judged<'_>) -> Section {
    let columns = score_columns(input.rows);
    let signals = signal_columns(input.rows);
    let measures: Vec<Measure<'_>> = columns
        .iter()
        .filter(|column| is_measure(column))
        .map(|column| measure(column, input, judged, &signals))
        .filter(|measure| measure.values.len() >= FEWEST)
        .collect();
    Section {
        id: "spread",
        title: "Distributions",
        body: (!measures.is_empty()).then(|| body(input, judged, &measures, &signals)),
    }
}

fn is_measure(column: &Column<Row>) -> bool {
    column.kind == Kind::Float64
        && !column.is_carried()
        && !column.name.starts_with("z_")
        && !OTHERS.contains(&column.name.as_str())
}

fn measure<'a>(
    column: &'a Column<Row>,
    input: &ReportInput<'a>,
    judged: &Judged<'a>,
    signals: &[(Signal, &str)],
) -> Measure<'a> {
    let values = judged
        .worst_first
        .iter()
        .filter_map(|scored| match column.cell(scored.row) {
            Cell::Float(value) => Some((scored.row, value)),
            _ => None,
        });
    Measure {
        name: &column.name,
        values: values.collect(),
        reference: input
            .reference
            .and_then(|reference| in_reference(reference, &column.name, input, signals)),
    }
}

fn in_reference<'a>(
    reference: &'a Frozen,
    name: &str,
    input: &ReportInput<'_>,
    signals: &[(Signal, &str)],
) -> Option<&'a Distribution> {
    if name == "anomaly" {
        let recipe = recipe_name(input.corpus.statistics.recipe);
        return reference
            .scores
            .get(recipe)
            .map(|scores| &scores.distribution);
    }
    let (signal, _) = signals.iter().find(|(_, column)| *column == name)?;
    reference.signals.get(signal.column())
}

fn body<'a>(
    input: &ReportInput<'a>,
    judged: &Judged<'a>,
    measures: &[Measure<'a>],
    signals: &[(Signal, &str)],
) -> Markup {
    let facets = Facet::all(judged, input.corpus.source.len());
    // Scores and what goes into them first; the rest on demand.
    let known = &input.corpus.statistics.corpus.signals;
    let leads = |measure: &&Measure<'a>| {
        let mut told = signals
            .iter()
            .filter(|(signal, _)| known.contains_key(signal.column()));
        measure.name == "anomaly" || told.any(|(_, column)| *column == measure.name)
    };
    let (mut leading, others): (Vec<_>, Vec<_>) = measures.iter().partition(leads);
    leading.sort_by_key(|measure| measure.name != "anomaly");
    let reference = input.reference.is_some();
    html! {
        p.lead {
            "Share of the scored videos per bin, in percent, each part of its own whole. Axes leave out the outer 0.5%: what lies beyond stands in the outer bins. The dashed line is the median of all videos."
        }
        @if facets.is_empty() { (panels(&leading, &others, None, reference)) }
        @for facet in &facets {
            h3 { "By " (facet.label) }
            (panels(&leading, &others, Some(facet), reference))
        }
    }
}

fn panels<'a>(
    leading: &[&Measure<'a>],
    others: &[&Measure<'a>],
    facet: Option<&Facet<'a>>,
    reference: bool,
) -> Markup {
    let all = |measures: &[&Measure<'a>]| {
        html! { div.panels { @for measure in measures { (panel(measure, facet)) } } }
    };
    html! {
        (key(facet, reference))
        (all(leading))
        @if !others.is_empty() {
            details {
                summary { "Other columns (" (text::length(others.len())) ")" }
                (all(others))
            }
        }
    }
}

/// What the lines mean.
fn key(facet: Option<&Facet<'_>>, reference: bool) -> Markup {
    let swatch = |ink: &str| html! { span.swatch style={ "background:var(--" (ink) ")" } {} };
    html! {
        ul.legend {
            li { (swatch("bar")) "all videos" }
            @if let Some(facet) = facet {
                @for (series, (name, size)) in facet.names.iter().take(COLOURED).enumerate() {
                    li { (swatch(&format!("s{series}"))) (text::group(*name)) span.quiet { (text::length(*size)) } }
                }
                @if facet.names.len() > COLOURED { li.quiet { "the " (COLOURED) " largest of " (text::length(facet.names.len())) } }
            }
            @if reference { li { (swatch("ink")) "reference" } }
        }
    }
}

/// One population of a panel.
struct Population {
    name: String,
    shares: Vec<f64>,
    ink: Option<Ink>,
    middle: Option<f64>,
}

fn panel<'a>(measure: &Measure<'a>, facet: Option<&Facet<'a>>) -> Markup {
    let values: Vec<f64> = measure.values.iter().map(|(_, value)| *value).collect();
    let Some(axis) = Axis::trimmed(values.iter().copied()) else {
        return html! {};
    };
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        median(&values)
    };
    let mut populations = vec![Population {
        name: "all".to_owned(),
        shares: axis.shares(&values, BINS),
        ink: None,
        middle: middle(values),
    }];
    for (series, (name, _)) in facet
        .iter()
        .flat_map(|facet| facet.names.iter().take(COLOURED))
        .enumerate()
    {
        let of_part = measure
            .values
            .iter()
            .filter(|(row, _)| facet.is_some_and(|facet| facet.series(row) == series));
        let of_part: Vec<f64> = of_part.map(|(_, value)| *value).collect();
        if of_part.is_empty() {
            continue;
        }
        populations.push(Population {
            name: text::plain_name(name.unwrap_or("no group"), 40),
            shares: axis.shares(&of_part, BINS),
            ink: Some(Ink::Series(series)),
            middle: middle(of_part),
        });
    }
    if let Some(reference) = measure.reference {
        populations.push(Population {
            name: "reference".to_owned(),
            shares: reference_shares(reference, axis),
            ink: Some(Ink::Text),
            middle: reference_median(reference),
        });
    }
    let says = format!(
        "Distribution of {}; the table below has the numbers",
        measure.name
    );
    let outlines = populations.iter().filter_map(|population| {
        Some(Outline {
            ink: population.ink?,
            shares: population.shares.clone(),
        })
    });
    let chart = histogram(&Histogram {
        axis,
        shares: populations.first().map_or(&[], |all| &all.shares),
        outlines: &outlines.collect::<Vec<_>>(),
        mark: populations.first().and_then(|all| all.middle),
        unit: "",
        says: &says,
    });
    html! {
        figure.panel {
            figcaption { code { (measure.name) } span.quiet { (text::length(measure.values.len())) } }
            @if let Some(chart) = chart { (PreEscaped(chart)) }
            p.quiet {
                "median"
                @for population in &populations { " · " (population.name) " " (text::magnitude(population.middle)) }
            }
            (table(axis, &populations))
        }
    }
}

/// The same numbers for those who do not see the chart.
fn table(axis: Axis, populations: &[Population]) -> Markup {
    let edge = |bin: usize| {
        let share = super::axis::as_float(bin) / super::axis::as_float(BINS);
        text::magnitude(Some(axis.lo + (axis.hi - axis.lo) * share))
    };
    html! {
        details.numbers {
            summary { "Numbers" }
            div.scroll {
                table.numbers {
                    thead { tr { th scope="col" { "From" } @for population in populations { th scope="col" { (population.name) } } } }
                    tbody {
                        @for bin in 0..BINS {
                            tr {
                                th scope="row" { (edge(bin)) }
                                @for population in populations {
                                    td { (text::fixed(population.shares.get(bin).map(|share| 100.0 * share), 1)) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// The reference's rows over the bins of this chart, those beyond its ends in the outer ones.
fn reference_shares(reference: &Distribution, axis: Axis) -> Vec<f64> {
    let all = reference.n as f64;
    let step = (axis.hi - axis.lo) / super::axis::as_float(BINS);
    let below = |edge: usize| match edge {
        0 => 0.0,
        BINS => all,
        edge => reference.count_below(axis.lo + step * super::axis::as_float(edge)),
    };
    (0..BINS)
        .map(|bin| (below(bin + 1) - below(bin)) / all.max(1.0))
        .collect()
}

/// The middle of the reference's rows, to the thousandth part that it keeps.
fn reference_median(reference: &Distribution) -> Option<f64> {
    let kept = reference
        .at_most
        .iter()
        .position(|at_most| 2 * at_most >= reference.n)?;
    reference.values.get(kept).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::values::InMemory;

    /// The slow twin counts the rows themselves.
    #[test]
    fn a_reference_is_binned_as_its_rows_would_be() {
        let values: Vec<f64> = (0..500).map(|k| f64::from(k * k % 503) / 10.0).collect();
        let rows: InMemory = values.iter().copied().collect();
        let Ok(reference) = Distribution::of(&rows);
        // No edge falls on a value, where half of it would count on either side.
        let axis = Axis::spanning(5.013, 41.017);
        for (bin, (found, twin)) in reference_shares(&reference, axis)
            .iter()
            .zip(axis.shares(&values, BINS))
            .enumerate()
        {
            assert!((found - twin).abs() < 1e-12, "bin {bin}: {found} {twin}");
        }
        let mut sorted = values;
        sorted.sort_by(f64::total_cmp);
        assert!(
            reference_median(&reference)
                .is_some_and(|middle| (middle - median(&sorted).unwrap()).abs() < 0.2)
        );
    }
}
