//! The section that `plumbline evaluate` adds to a report: success rates as bars with their standard
//! errors, and populations side by side.

use maud::{Markup, html};

use super::series::tenth;
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

/// Drawing units of the bars.
const WIDTH: f64 = 640.0;
const BAR: f64 = 22.0;
const STEP: f64 = 34.0;
/// Where bars start and end; names stand before, figures behind.
const LEFT: f64 = 70.0;
const RIGHT: f64 = 520.0;

/// The report with this evaluation in it, in place of an earlier one. Text in reports is escaped, so
/// that no name can look like the places searched for.
pub(super) fn added_to(report: &str, evaluation: &Evaluation) -> Option<String> {
    let mut page = report.to_owned();
    if let Some(start) = page.find(OPEN) {
        let end = start + page[start..].find(CLOSE)? + CLOSE.len();
        page.replace_range(start..end, "");
        page = page.replacen(LINK, "", 1);
    }
    page.insert_str(page.rfind("</main>")?, &section(evaluation));
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
        (bars(&success.sets))
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

fn bars(sets: &[SetRate]) -> Markup {
    let at = |percent: f64| LEFT + (RIGHT - LEFT) * percent.clamp(0.0, 100.0) / 100.0;
    let height = STEP * super::axis::as_float(sets.len());
    html! {
        svg.bars viewBox={ "0 0 " (WIDTH) " " (height) } role="img" aria-label="Success rates" style="max-width:720px;width:100%" {
            @for (index, SetRate { set, rate }) in sets.iter().enumerate() {
                @let top = super::axis::as_float(index) * STEP + (STEP - BAR) / 2.0;
                @let middle = top + BAR / 2.0;
                text x="0" y=(tenth(middle + 5.0)) style="fill:var(--ink);font-size:15px" { (set.name()) }
                rect x=(tenth(LEFT)) y=(tenth(top)) width=(tenth(at(rate.percent) - LEFT)) height=(tenth(BAR))
                    style="fill:var(--bar)" {}
                @if let Some(error) = rate.standard_error {
                    path style="stroke:var(--mark);stroke-width:2" d={
                        "M" (tenth(at(rate.percent - error))) " " (tenth(middle)) "H" (tenth(at(rate.percent + error)))
                    } {}
                }
                text x=(tenth(RIGHT + 8.0)) y=(tenth(middle + 5.0)) style="fill:var(--soft);font-size:13px" { (rate_text(rate)) }
            }
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
