//! The fronts as panels, and as a picture of them.

use plumbline_worker::explain::scatter::{Mark, ScatterPanel, scatter};

use super::front::{Bought, front};
use super::{PointResult, Tradeoff, TradeoffError};
use crate::picture;
use crate::report::text;

/// What lies to the right.
pub(super) const COST_TITLE: &str = "CPU seconds per video, logarithmic";
/// Ticks of the axis of cost, as steps within a decade.
const STEPS: [f64; 3] = [1.0, 2.0, 5.0];
/// Longest name beside a point.
const NAME_CHARS: usize = 24;

/// What a panel shows of a point, and which way is better.
struct Measure {
    title: &'static str,
    better: Better,
    of: fn(&PointResult) -> Option<f64>,
}

#[derive(Clone, Copy)]
enum Better {
    More,
    Less,
}

const MEASURES: [Measure; 6] = [
    Measure {
        title: "Spearman's ρ to the top point (its own yardstick)",
        better: Better::More,
        of: |point| point.agreement.spearman,
    },
    Measure {
        title: "Decisions as the top point's, %",
        better: Better::More,
        of: |point| Some(100.0 * point.agreement.flips.agreement()),
    },
    Measure {
        title: "Flow error on rendered scenes, px of a 256-px-high picture",
        better: Better::Less,
        of: |point| point.truth.and_then(|truth| truth.flow_epe_px),
    },
    Measure {
        title: "Camera error on rendered scenes, % of the path",
        better: Better::Less,
        of: |point| point.truth.and_then(|truth| truth.pose_error_percent),
    },
    Measure {
        title: "Injected faults told from clean clips, AUROC",
        better: Better::More,
        of: |point| point.faults.as_ref()?.auroc,
    },
    Measure {
        title: "AUROC for failure, by the labels",
        better: Better::More,
        of: |point| point.auroc_failure.map(|found| found.area),
    },
];

/// The panels that there are values for, each with its own front, over the logarithm of cost; names are safe
/// to draw.
pub(super) fn panels(found: &Tradeoff) -> Vec<ScatterPanel> {
    let panel = |measure: &Measure| {
        let of = measure.of;
        let points: Vec<(&PointResult, f64)> = found
            .points
            .iter()
            .filter(|point| point.cpu_s_per_video > 0.0)
            .filter_map(|point| Some((point, of(point).filter(|value| value.is_finite())?)))
            .collect();
        let bought: Vec<Bought> = points
            .iter()
            .map(|(point, value)| Bought {
                cost: point.cpu_s_per_video,
                good: match measure.better {
                    Better::More => *value,
                    Better::Less => -value,
                },
            })
            .collect();
        let marks: Vec<Mark> = points
            .iter()
            .zip(front(&bought))
            .map(|((point, value), on_front)| Mark {
                name: text::plain_name(&point.name, NAME_CHARS),
                x: libm::log10(point.cpu_s_per_video),
                y: *value,
                on_front,
            })
            .collect();
        (!marks.is_empty()).then(|| ScatterPanel {
            title: measure.title.to_owned(),
            marks,
            ticks: cost_ticks(),
        })
    };
    MEASURES.iter().filter_map(panel).collect()
}

/// Round costs by their logarithms.
fn cost_ticks() -> Vec<(f64, String)> {
    const DECADES: std::ops::Range<i32> = -6..7;
    DECADES
        .flat_map(|decade| STEPS.map(|step| step * libm::pow(10.0, f64::from(decade))))
        .map(|cost| (libm::log10(cost), text::magnitude(Some(cost))))
        .collect()
}

/// The bytes of the picture.
pub(super) fn png(found: &Tradeoff) -> Result<Vec<u8>, TradeoffError> {
    let title = format!(
        "What each second buys: {} videos of the sample",
        found.sample.len()
    );
    let drawn = scatter(&title, COST_TITLE, &panels(found))?;
    Ok(picture::png(&drawn)?)
}
