//! The trade-off on a terminal: a line per point, and the sentence that answers the question.

use comfy_table::{CellAlignment, Table, presets};

use super::{PointResult, Question, Shape, Tradeoff};

const HOUR_S: f64 = 3600.0;
const MINUTE_S: f64 = 60.0;
/// Measurements that waited longer than this, wall over processor time, shared their cores.
const MOST_WAITING: f64 = 1.25;
/// z of a 90% interval.
const Z_90: f64 = 1.6449;

/// Headings of the table.
pub(super) const HEADINGS: [&str; 13] = [
    "point",
    "front",
    "CPU s/video",
    "cost",
    "Spearman",
    "Kendall",
    "error 50%",
    "error 95%",
    "flips",
    "flow EPE px",
    "pose %",
    "depth",
    "faults AUROC/hit",
];

/// The table, with a column for labels where there are any.
#[must_use]
pub fn table(found: &Tradeoff) -> String {
    let labelled = found
        .points
        .iter()
        .any(|point| point.auroc_failure.is_some());
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    let mut headings = HEADINGS.map(str::to_owned).to_vec();
    if labelled {
        headings.push("AUROC failure".to_owned());
    }
    table.set_header(headings);
    for point in &found.points {
        let mut cells = cells(point);
        if labelled {
            cells.push(fixed(point.auroc_failure.map(|found| found.area), 3));
        }
        table.add_row(cells);
    }
    for column in 2..HEADINGS.len() + usize::from(labelled) {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table.trim_fmt()
}

/// A point's line.
pub(super) fn cells(point: &PointResult) -> Vec<String> {
    let agreement = &point.agreement;
    let truth = point.truth.as_ref();
    let faults = point.faults.as_ref();
    vec![
        if point.top {
            format!("{} (top)", point.name)
        } else {
            point.name.clone()
        },
        if point.on_front {
            "*".to_owned()
        } else {
            String::new()
        },
        format!("{:.3}", point.cpu_s_per_video),
        format!("{:.2}", point.relative_cost),
        fixed(agreement.spearman, 3),
        fixed(agreement.kendall, 3),
        fixed(agreement.score_error_median, 3),
        fixed(agreement.score_error_p95, 3),
        format!("{} of {}", agreement.flips.count(), agreement.flips.videos),
        fixed(truth.and_then(|truth| truth.flow_epe_px), 3),
        fixed(truth.and_then(|truth| truth.pose_error_percent), 2),
        fixed(truth.and_then(|truth| truth.depth_error), 3),
        format!(
            "{}/{}",
            fixed(faults.and_then(|found| found.auroc), 2),
            fixed(faults.and_then(|found| found.temporal_hit), 2)
        ),
    ]
}

fn fixed(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// What to use for the question, or what it would need.
#[must_use]
pub fn sentence(found: &Tradeoff) -> String {
    let asked = asked(&found.question);
    let of = |name: &String| found.points.iter().find(|point| point.name == *name);
    if let Some(point) = found.recommended.as_ref().and_then(of) {
        let takes = point.plan.map_or(String::new(), |plan| {
            let (lo, hi) = plan.wall_interval_90_s;
            format!(
                " It takes about {} ({} to {}).",
                duration(plan.wall_s),
                duration(lo),
                duration(hi)
            )
        });
        let expect = if point.top {
            "no flips, since it is the point that the others are held against".to_owned()
        } else {
            let flips = &point.agreement.flips;
            let (share, lo, hi) = wilson(flips.count(), flips.videos);
            let videos = found.question.videos as f64;
            format!(
                "{:.0} flips ({:.0} to {:.0}) against {}",
                share * videos,
                lo * videos,
                hi * videos,
                top_name(found)
            )
        };
        return format!("for {asked} use {}; expect {expect}.{takes}", point.profile);
    }
    let cheapest = found
        .points
        .iter()
        .filter_map(|point| Some((point, point.plan?)))
        .min_by(|a, b| a.1.wall_s.total_cmp(&b.1.wall_s));
    match cheapest {
        Some((point, plan)) => format!(
            "no point does {asked}: the cheapest, {}, takes about {} (up to {})",
            point.profile,
            duration(plan.wall_s),
            duration(plan.wall_interval_90_s.1)
        ),
        None => format!("nothing was measured that {asked} could be planned by"),
    }
}

/// What to know of the times, where there is something.
#[must_use]
pub fn warning(found: &Tradeoff) -> Option<String> {
    (found.waiting > MOST_WAITING).then(|| {
        format!(
            "this machine was busy: measurements took {:.1} times what they computed; times to plan by are those of an idle one (--no-resume measures again)",
            found.waiting
        )
    })
}

fn top_name(found: &Tradeoff) -> &str {
    let top = found.points.iter().find(|point| point.top);
    top.map_or("the top point", |point| &point.name)
}

fn asked(question: &Question) -> String {
    let plural =
        |n: u64, what: &str| format!("{} {what}{}", thousands(n), if n == 1 { "" } else { "s" });
    let shape = question.shape.map_or(String::new(), |shape| {
        let Shape {
            frames,
            width,
            height,
        } = shape;
        format!(" of {frames} frames at {width}x{height}")
    });
    format!(
        "{}{shape}, {} and {}",
        plural(question.videos, "video"),
        plural(question.cores.into(), "core"),
        if question.hours == 1.0 {
            "1 hour".to_owned()
        } else {
            format!("{} hours", question.hours)
        }
    )
}

fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Seconds as a person says them.
pub(super) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 2.0 * MINUTE_S => format!("{s:.0} s"),
        s if s < 2.0 * HOUR_S => format!("{:.0} min", s / MINUTE_S),
        s => format!("{:.1} h", s / HOUR_S),
    }
}

/// A share of n and its 90% interval (Wilson 1927), which holds for small counts, too.
pub(super) fn wilson(count: u64, n: u64) -> (f64, f64, f64) {
    if n == 0 {
        return (0.0, 0.0, 1.0);
    }
    let (n, share) = (n as f64, count as f64 / n as f64);
    let z2 = Z_90 * Z_90;
    let middle = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z_90 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    (share, (middle - half).max(0.0), (middle + half).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilsons_interval_of_known_counts() {
        // Wilson's interval for 0 of n is [0, z²/(n + z²)].
        let (share, lo, hi) = wilson(0, 20);
        assert_eq!((share, lo), (0.0, 0.0));
        assert!((hi - Z_90 * Z_90 / (20.0 + Z_90 * Z_90)).abs() < 1e-12);
        let (_, lo, hi) = wilson(10, 20);
        assert!((0.5 - lo - (hi - 0.5)).abs() < 1e-12 && lo > 0.3 && hi < 0.7);
        assert_eq!(wilson(0, 0), (0.0, 0.0, 1.0));
    }

    #[test]
    fn durations_and_numbers_are_readable() {
        assert_eq!(
            [90.0, 600.0, 3.0 * HOUR_S].map(duration),
            ["90 s", "10 min", "3.0 h"]
        );
        assert_eq!(
            [7, 5_000, 1_234_567].map(thousands),
            ["7", "5,000", "1,234,567"]
        );
    }
}
