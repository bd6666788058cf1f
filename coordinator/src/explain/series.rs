//! A clip's series as a table and as a plot. One row per frame; a pair's numbers stand at its later
//! frame. A missing value is an empty cell.

use plumbline_common::row::Measurement;
use plumbline_vision::faults::{FaultKind, FaultSeries, FaultThresholds};
use plumbline_vision::image::Rgb8;
use plumbline_worker::explain::DrawError;
use plumbline_worker::explain::plot::{self, Line, Panel, SEVERITY_CUT};

/// What the table is made of.
pub(super) struct Table<'a> {
    pub(super) measured: &'a Measurement,
    pub(super) faults: &'a FaultSeries,
    pub(super) thresholds: &'a FaultThresholds,
    pub(super) times_s: &'a [f64],
}

impl Table<'_> {
    /// A pair's value at its later frame.
    fn at(&self, series: &[Option<f64>], frame: u32) -> Option<f64> {
        let place = frame.checked_sub(self.measured.series.first_frame)?;
        *series.get(place as usize)?
    }

    fn score(&self, kind: FaultKind, frame: u32) -> Option<f64> {
        let points = self.faults.points(kind);
        let place = points.binary_search_by_key(&(frame as usize), |point| point.frame);
        Some(points[place.ok()?].score)
    }

    fn frames(&self) -> impl Iterator<Item = u32> + use<> {
        0..self.times_s.len() as u32
    }

    /// `series.csv`: numbers in full, so that reading them back gives the same bits.
    pub(super) fn csv(&self) -> Vec<u8> {
        let series = &self.measured.series;
        let columns: [(&str, &[Option<f64>]); 10] = [
            ("aepe_px", &series.aepe_px),
            ("aepe_worldscore_px", &series.aepe_worldscore_px),
            ("reproj_px", &series.reproj_px),
            ("layer_residual_px", &series.layer_residual_px),
            ("motion_px", &series.motion_px),
            ("piecewise_residual", &series.piecewise_residual),
            ("appearance_ratio", &series.appearance_ratio),
            ("layer_acceleration", &series.layer_acceleration),
            ("interior_shear", &series.interior_shear),
            ("detail_change", &series.detail_change),
        ];
        let mut header = vec!["frame".to_owned(), "time_s".to_owned()];
        header.extend(columns.map(|(name, _)| name.to_owned()));
        header.insert(5, "reproj_jump_px".to_owned());
        for kind in FaultKind::ALL {
            let name = kind.as_str();
            header.extend([
                name.to_owned(),
                format!("{name}_threshold"),
                format!("{name}_flag"),
            ]);
        }
        let mut lines = vec![header.join(",")];
        let cell = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        for frame in self.frames() {
            let mut cells = vec![frame.to_string(), self.times_s[frame as usize].to_string()];
            cells.extend(columns.map(|(_, series)| cell(self.at(series, frame))));
            cells.insert(5, cell(series.reproj_jump_px(frame)));
            for kind in FaultKind::ALL {
                let (score, threshold) = (self.score(kind, frame), self.thresholds.of(kind));
                let flag = score
                    .zip(threshold)
                    .map(|(score, threshold)| u8::from(score > threshold).to_string());
                cells.extend([cell(score), cell(threshold), flag.unwrap_or_default()]);
            }
            lines.push(cells.join(","));
        }
        // Every cell is a number or empty: nothing to quote.
        (lines.join("\n") + "\n").into_bytes()
    }

    /// `series.png`.
    pub(super) fn plot(&self) -> Result<Rgb8, DrawError> {
        let measured = self.measured;
        let series = &measured.series;
        let line = |values: &dyn Fn(u32) -> Option<f64>| {
            let finite = |frame| values(frame).filter(|value| value.is_finite());
            vec![Line {
                name: String::new(),
                points: self.frames().map(|frame| (frame, finite(frame))).collect(),
            }]
        };
        let panel = |title: &str, values: &[Option<f64>], marks| Panel {
            title: title.to_owned(),
            lines: line(&|frame| self.at(values, frame)),
            level: None,
            marks,
        };
        let star = match measured.peak_reliable {
            Some(true) => "t* = frame",
            _ => "t* (faint) = frame",
        };
        let mark = |frame: Option<u32>, name: &str| -> Vec<(u32, String)> {
            frame
                .map(|frame| (frame, name.to_owned()))
                .into_iter()
                .collect()
        };
        let panels = [
            panel(
                "end-point error, px of a 256-px-high picture",
                &series.aepe_px,
                Vec::new(),
            ),
            panel(
                "geometry residual e, same px",
                &series.reproj_px,
                mark(measured.paper_peak_frame, star),
            ),
            panel("motion, same px per frame", &series.motion_px, Vec::new()),
            self.severities(mark(measured.peak_frame, "worst fault = frame")),
        ];
        let title = format!(
            "series of a clip of {} frames; a value belongs to the frame and the one before it",
            self.times_s.len()
        );
        let last = self.times_s.len().saturating_sub(1) as u32;
        plot::series(&title, last, &panels)
    }

    /// Every calibrated detector's score over its threshold.
    fn severities(&self, marks: Vec<(u32, String)>) -> Panel {
        let calibrated = FaultKind::ALL.into_iter().filter_map(|kind| {
            let threshold = self
                .thresholds
                .of(kind)
                .filter(|threshold| *threshold > 0.0)?;
            let severity = |frame| {
                let severity = self.score(kind, frame)? / threshold;
                severity.is_finite().then(|| severity.min(SEVERITY_CUT))
            };
            Some(Line {
                name: kind.as_str().replace('_', " "),
                points: self
                    .frames()
                    .map(|frame| (frame, severity(frame)))
                    .collect(),
            })
        });
        let lines: Vec<Line> = calibrated.collect();
        if lines.is_empty() {
            return Panel {
                title: "faults: this profile has no thresholds (--fault-thresholds)".to_owned(),
                lines,
                level: None,
                marks,
            };
        }
        Panel {
            title: format!("fault score over its threshold, cut at {SEVERITY_CUT:.0}:"),
            lines,
            level: Some((1.0, "reported above".to_owned())),
            marks,
        }
    }
}
