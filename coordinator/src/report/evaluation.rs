//! The section that `plumbline evaluate` adds to a report: success rates as bars with their standard
//! errors, and populations side by side.

use maud::{Markup, PreEscaped, html};

use super::chart::{Bar, bars as bars_chart};
use super::text;
use crate::evaluate::document::{auroc, rate_text, signed};
use crate::evaluate::sets::SetRate;
use crate::evaluate::{Evaluation, Populations, Success};

/// The section's anchor; also how an earlier one is found.
const OPEN: &str = "<section id=\"evaluation\">";
const CLOSE: &str = "</section>";
const LINK: &str = "<a href=\"#evaluation\">Evaluation</a>";

/// Tasks listed; evaluation.json has them all.
const TASKS: usize = 60;

/// The report with this evaluation in it, in place of an earlier one. Text in reports is escaped, so
/// that no name can look like the places searched for.
pub(super) fn added_to(report: &str, evaluation: &Evaluation) -> Option<String> {
    let mut page = report.to_owned();
    if let Some(start) = page.find(OPEN) {
        let end = start + page[start..].find(CLOSE)? + CLOSE.len();
        page.replace_range(start..end, "");
        page = page.replacen(LINK, "", 1);
    }
    added(page, &section(evaluation))
}

/// The report with the evaluation that an earlier one of the same scores shows.
pub(super) fn taken_over(earlier: &str, report: &str) -> Option<String> {
    let start = earlier.find(OPEN)?;
    let end = start + earlier[start..].find(CLOSE)? + CLOSE.len();
    added(report.to_owned(), &earlier[start..end])
}

fn added(mut page: String, section: &str) -> Option<String> {
    page.insert_str(page.rfind("</main>")?, section);
    page.insert_str(page.find("</nav>")?, LINK);
    Some(page)
}

fn section(evaluation: &Evaluation) -> String {
    let section = html! {
        section id="evaluation" {
            h2 { "Evaluation" }
            @if let Some(success) = &evaluation.success { (rates(success)) }
            @if let Some(populations) = &evaluation.populations { (side_by_side(populations)) }
        }
    };
    section.into_string()
}

fn rates(success: &Success) -> Markup {
    html! {
        p.lead {
            "Success as judged, of the videos with the lowest, middle and highest anomaly scores of each task, "
            "of as many drawn at random, and of all " (text::length(success.compared)) " compared; percent, with standard errors."
        }
        figure.scatter.shares {
            @if let Some(chart) = chart(&success.sets) { (PreEscaped(chart)) }
        }
        (rate_table(&success.sets))
        p.more {
            @for (index, difference) in success.differences.iter().enumerate() {
                @if index > 0 { " · " }
                (difference.of.name()) " over " (difference.over.name()) " "
                (signed(difference.points, difference.standard_error)) " points"
            }
            @if let Some(area) = &success.auroc_failure { " · AUROC for failure " (auroc(area)) }
        }
        @if !success.real.is_empty() {
            p.more {
                "Judged minus real: "
                @for (index, gap) in success.real.iter().enumerate() {
                    @if index > 0 { " · " }
                    (gap.set.name()) " " (signed(gap.gap_points, gap.standard_error)) " points"
                }
            }
        }
        p.more {
            "Left out: " (text::length(success.without_score.len())) " labelled videos without a score, "
            (text::length(success.without_label.len())) " scored videos without a label; evaluation.json lists them."
        }
        h3 { "By task" }
        div.scroll {
            table.numbers {
                thead { tr {
                    th scope="col" { "Task" }
                    @for rate in &success.sets { th scope="col" { (rate.set.name()) } }
                } }
                tbody {
                    @for task in success.tasks.iter().take(TASKS) {
                        tr {
                            th scope="row" { (text::group(task.task.as_deref())) }
                            @for rate in &task.sets { td { (rate_text(&rate.rate)) } }
                        }
                    }
                }
            }
        }
        @if success.tasks.len() > TASKS {
            p.more { (TASKS) " of " (text::length(success.tasks.len())) " tasks; evaluation.json has them all." }
        }
    }
}

fn chart(sets: &[SetRate]) -> Option<String> {
    let bars: Vec<Bar<'_>> = sets
        .iter()
        .map(|SetRate { set, rate }| Bar {
            name: set.name(),
            percent: rate.percent,
            standard_error: rate.standard_error,
        })
        .collect();
    bars_chart(
        &bars,
        "Success rates in percent with standard errors; the table below has the numbers",
    )
}

/// The same numbers for those who do not see the chart.
fn rate_table(sets: &[SetRate]) -> Markup {
    html! {
        table.numbers {
            thead { tr { @for SetRate { set, .. } in sets { th scope="col" { (set.name()) } } } }
            tbody { tr { @for SetRate { rate, .. } in sets { td { (rate_text(rate)) } } } }
        }
    }
}

fn side_by_side(found: &Populations) -> Markup {
    html! {
        h3 { "Populations by " (text::name(&found.column)) }
        div.scroll {
            table.numbers {
                thead { tr {
                    th scope="col" { "Population" }
                    th scope="col" { "Scored" }
                    @for symbol in ["H", "w"] {
                        @for title in ["geometric", "photometric"] { th scope="col" { i { (symbol) } " " (title) } }
                    }
                    th scope="col" { "Mean anomaly" }
                } }
                tbody {
                    @for population in found.populations.iter().take(TASKS) {
                        tr {
                            th scope="row" { (text::name(&population.population)) }
                            td { (text::count(population.n)) }
                            @for measure in &population.measures { td { (text::fixed(measure.entropy_nats, 2)) } }
                            @for measure in &population.measures { td { (text::fixed(measure.weight, 2)) } }
                            td { (text::signed(population.anomaly_mean)) }
                        }
                    }
                }
            }
        }
        @if let (Some(area), [first, second]) = (&found.auroc_first_above_second, found.populations.as_slice()) {
            p.more {
                "AUROC of the anomaly score, " (text::name(&first.population)) " above " (text::name(&second.population))
                ": " (auroc(area)) "."
            }
        }
    }
}
