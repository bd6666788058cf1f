//! What an explanation says: `explain.json`, `faults.json` and the lines on the terminal.

use plumbline_common::row::Measurement;
use plumbline_vision::faults::{FaultEvent, FaultKind};
use plumbline_worker::explain::Subject;
use serde_json::{Value, json};

use super::{ExplainOptions, Explained, HeatMap, Plan};
use crate::corpus::Entry;

/// Faults told on the terminal.
const TOLD: usize = 5;

/// Everything that is written down.
pub(super) struct Story<'a> {
    pub(super) options: &'a ExplainOptions,
    pub(super) entry: &'a Entry,
    pub(super) measured: &'a Measurement,
    pub(super) events: &'a [FaultEvent],
    pub(super) grid_size: Option<(usize, usize)>,
    pub(super) times_s: &'a [f64],
    pub(super) plan: &'a Plan,
    pub(super) files: &'a [String],
    pub(super) undrawn: Option<&'a str>,
}

impl Story<'_> {
    /// `explain.json`.
    pub(super) fn explanation(&self) -> Result<Value, serde_json::Error> {
        let mut measured = serde_json::to_value(self.measured)?;
        if let Some(columns) = measured.as_object_mut() {
            // In series.csv.
            columns.remove("series");
        }
        let row = self.measured;
        Ok(json!({
            "plumbline_version": env!("CARGO_PKG_VERSION"),
            "video": self.entry.video,
            "profile": {
                "name": self.options.profile.name(),
                "digest": self.options.profile.digest()?,
            },
            "fault_calibration": self.options.fault_calibration,
            "conditioning_frames": self.options.profile.conditioning_frames,
            "warmup_frames": self.options.profile.warmup_frames,
            "measured": measured,
            "paper_peak": row.paper_peak_frame.map(|frame| json!({
                "frame": frame,
                "time_s": self.time_s(frame as usize),
                "jump_px": row.max_jump,
                "signed_jump_px": row.series.reproj_jump_px(frame),
                "reliable": row.peak_reliable,
                "worst_edge": self.plan.worst_edge.map(|(from_frame, to_frame, residual_px)| json!({
                    "from_frame": from_frame,
                    "to_frame": to_frame,
                    "residual_px": residual_px,
                })),
                "heat_map": self.heat_map(Subject::RigidResidual),
            })),
            "worst_end_point_error": self.plan.worst_pair.map(|(frame, aepe_px)| json!({
                "frame": frame,
                "time_s": self.time_s(frame as usize),
                "aepe_px": aepe_px,
                "heat_map": self.heat_map(Subject::EndPointError),
            })),
            "faults": self.fault_list(),
            "files": self.files,
            "missing_pictures": self.undrawn,
        }))
    }

    /// `faults.json`.
    pub(super) fn faults(&self) -> Value {
        let thresholds: serde_json::Map<String, Value> = FaultKind::ALL
            .into_iter()
            .map(|kind| {
                let threshold = self.options.profile.fault_thresholds.of(kind);
                (kind.as_str().to_owned(), json!(threshold))
            })
            .collect();
        json!({
            "video": self.entry.video,
            "thresholds": thresholds,
            "faults": self.fault_list(),
        })
    }

    /// The faults, the most severe first; null where no detector ran.
    fn fault_list(&self) -> Option<Vec<Value>> {
        self.measured.fault_frames.as_ref()?;
        let told = self.events.iter().enumerate();
        Some(
            told.map(|(place, event)| self.fault(place, event))
                .collect(),
        )
    }

    fn fault(&self, place: usize, event: &FaultEvent) -> Value {
        let region = event
            .place
            .and_then(|place| Some((place, Scale::new(self.measured, self.grid_size?)?)));
        json!({
            "kind": event.kind,
            "frame": event.frame,
            "time_s": self.time_s(event.frame),
            "first_frame": event.first_frame,
            "last_frame": event.last_frame,
            "score": event.score,
            "threshold": event.threshold,
            "severity": event.severity(),
            "peak_px": region.as_ref().map(|(place, scale)| scale.centre(place.peak)),
            "box_px": region.as_ref().map(|(place, scale)| scale.bounds(place.bounds)),
            "heat_map": self.fault_map(place),
        })
    }

    /// The heat map of a fault, where it was drawn.
    fn fault_map(&self, fault: usize) -> Option<&str> {
        self.drawn(|map| map.fault == Some(fault))
    }

    /// The heat map of another subject, where it was drawn.
    fn heat_map(&self, subject: Subject) -> Option<&str> {
        self.drawn(|map| map.what.0 == subject)
    }

    fn drawn(&self, is_it: impl Fn(&HeatMap) -> bool) -> Option<&str> {
        let map = self.plan.heat_maps.iter().find(|map| is_it(map))?;
        self.files.contains(&map.file).then_some(map.file.as_str())
    }

    fn time_s(&self, frame: usize) -> Option<f64> {
        self.times_s.get(frame).copied()
    }
}

/// From cells of the evidence grid to pixels of the video.
struct Scale {
    x: f64,
    y: f64,
}

impl Scale {
    fn new(measured: &Measurement, grid: (usize, usize)) -> Option<Self> {
        Some(Self {
            x: f64::from(measured.width?) / grid.0.max(1) as f64,
            y: f64::from(measured.height?) / grid.1.max(1) as f64,
        })
    }

    /// The cell's centre; the top left pixel's centre is (0, 0).
    fn centre(&self, [x, y]: [usize; 2]) -> [f64; 2] {
        let at = |cell: usize, scale: f64| ((cell as f64 + 0.5) * scale - 0.5).max(0.0);
        [at(x, self.x), at(y, self.y)]
    }

    /// Whole pixels, x1 and y1 exclusive.
    fn bounds(&self, [x0, y0, x1, y1]: [usize; 4]) -> [u32; 4] {
        let floor = |cell: usize, scale: f64| (cell as f64 * scale).floor() as u32;
        let ceil = |cell: usize, scale: f64| (cell as f64 * scale).ceil() as u32;
        [
            floor(x0, self.x),
            floor(y0, self.y),
            ceil(x1, self.x),
            ceil(y1, self.y),
        ]
    }
}

/// What a person wants to know first.
pub(super) fn summary(explained: &Explained) -> Vec<String> {
    let row = &explained.measured;
    let mut lines = vec![match &row.status_reason {
        None => format!("{}:", row.status.as_str()),
        Some(reason) => format!("{}: {reason}", row.status.as_str()),
    }];
    if let Some(line) = lines.first_mut().filter(|_| row.status_reason.is_none()) {
        let px = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        line.push_str(&format!(
            " geometry {} px, end-point error {} px, motion {} px (of a 256-px-high picture)",
            px(row.reproj_px),
            px(row.aepe_px),
            px(row.motion_px)
        ));
    }
    let at = |frame: usize| match explained.times_s.get(frame) {
        Some(time_s) => format!("frame {frame} ({time_s:.2} s)"),
        None => format!("frame {frame}"),
    };
    if let Some(frame) = row.paper_peak_frame {
        let reliable = match row.peak_reliable {
            Some(true) => "",
            _ => ", which does not stand out",
        };
        // The published rule takes either direction; only one of them is an artifact.
        let falls = row
            .series
            .reproj_jump_px(frame)
            .is_some_and(|jump| jump < 0.0);
        let falls = if falls {
            ", where the residual falls"
        } else {
            ""
        };
        let frame = at(frame as usize);
        lines.push(format!("paper's peak: {frame}{reliable}{falls}"));
    }
    match (&row.fault_frames, explained.faults.len()) {
        (None, _) if row.frames.is_some() => {
            let reason = match row.series.aepe_px.is_empty() {
                true => "no frame pair",
                false => "no thresholds for this profile",
            };
            lines.push(format!("faults: not judged ({reason})"));
        }
        (None, _) => {}
        (Some(_), 0) => lines.push("faults: none found".to_owned()),
        (Some(_), count) => {
            for event in explained.faults.iter().take(TOLD) {
                let kind = event.kind.as_str().replace('_', " ");
                lines.push(format!(
                    "{kind}: {}, {:.1} × its threshold",
                    at(event.frame),
                    event.severity()
                ));
            }
            if count > TOLD {
                lines.push(format!("and {} more, in faults.json", count - TOLD));
            }
        }
    }
    if let Some(reason) = &explained.undrawn {
        lines.push(format!("pictures are missing: {reason}"));
    }
    lines.push(format!("explanation: {}", explained.out.display()));
    lines
}
