//! The detectors over clean and injected clips; what an injection leaves as it was is measured once.

use plumbline_vision::faults::{
    ChangePair, FaultInput, FaultKind, FaultParams, FaultSeries, FaultStream,
};
use plumbline_vision::image::{Plane, Rgb8, resize_plane};

use super::{Injected, Kind};
use crate::support::{Measure, Prepared, STANDARD};

/// A clip's scores, kind by kind of detector, and the paper's series.
pub(crate) struct Scores {
    pub(crate) faults: FaultSeries,
    /// (later frame, mean forward/backward error, reference px) of every adjacent pair.
    pub(crate) error_px: Vec<(usize, f64)>,
}

/// Whether a detector's worst frame and place are the fault's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    pub(crate) temporal: bool,
    /// `None` where the fault has no place.
    pub(crate) pointing: Option<bool>,
}

/// An injected clip's scores and truth.
pub(crate) struct Outcome {
    pub(crate) kind: Kind,
    pub(crate) scores: Scores,
    pub(crate) span: [usize; 2],
    mask: Option<Plane>,
}

/// A clean clip, measured, with all that its injections reuse.
pub(crate) struct CleanClip {
    measure: Measure,
    prepared: Vec<Prepared>,
    /// Pairs one and two frames apart, by their later frame.
    adjacent: Vec<Option<ChangePair>>,
    skip: Vec<Option<ChangePair>>,
    pub(crate) scores: Scores,
}

impl CleanClip {
    pub(crate) fn new(frames: &[Rgb8]) -> Self {
        let mut measure = Measure::new(STANDARD);
        let prepared: Vec<Prepared> = frames.iter().map(|frame| measure.prepare(frame)).collect();
        let mut pairs = |span: usize| -> Vec<Option<ChangePair>> {
            (0..prepared.len())
                .map(|t| {
                    let before = t.checked_sub(span)?;
                    Some(measure.pair(&prepared[before], &prepared[t]))
                })
                .collect()
        };
        let (adjacent, skip) = (pairs(1), pairs(2));
        let pictures: Vec<&Prepared> = prepared.iter().collect();
        let scores = scores(&pictures, |t| adjacent[t].as_ref(), |t| skip[t].as_ref());
        Self {
            measure,
            prepared,
            adjacent,
            skip,
            scores,
        }
    }

    pub(crate) fn with(&mut self, kind: Kind, injected: &Injected) -> Outcome {
        let measure = &mut self.measure;
        let changed: Vec<Option<Prepared>> = injected
            .frames
            .iter()
            .zip(&injected.changed)
            .map(|(frame, &changed)| changed.then(|| measure.prepare(frame)))
            .collect();
        let prepared: Vec<&Prepared> = changed
            .iter()
            .zip(&self.prepared)
            .map(|(changed, clean)| changed.as_ref().unwrap_or(clean))
            .collect();
        let mut pairs = |span: usize| -> Vec<Option<ChangePair>> {
            (0..prepared.len())
                .map(|t| {
                    let before = t.checked_sub(span)?;
                    let touched = injected.changed[before] || injected.changed[t];
                    touched.then(|| measure.pair(prepared[before], prepared[t]))
                })
                .collect()
        };
        let (adjacent, skip) = (pairs(1), pairs(2));
        let scores = scores(
            &prepared,
            |t| adjacent[t].as_ref().or(self.adjacent[t].as_ref()),
            |t| skip[t].as_ref().or(self.skip[t].as_ref()),
        );
        let (columns, rows) = scores.faults.grid_size.unwrap();
        let mask = injected.mask.as_ref().map(|mask| {
            let plane = Plane {
                width: injected.frames[0].width,
                height: injected.frames[0].height,
                data: mask.iter().map(|&m| f32::from(u8::from(m))).collect(),
            };
            resize_plane(&plane, columns, rows)
        });
        Outcome {
            kind,
            scores,
            span: injected.span,
            mask,
        }
    }
}

fn scores<'a>(
    prepared: &[&Prepared],
    adjacent: impl Fn(usize) -> Option<&'a ChangePair>,
    skip: impl Fn(usize) -> Option<&'a ChangePair>,
) -> Scores {
    let mut stream = FaultStream::new(FaultParams::default()).unwrap();
    let mut error_px = Vec::new();
    for (frame, prepared) in prepared.iter().enumerate() {
        let input = FaultInput {
            frame,
            picture: &prepared.picture,
            adjacent: adjacent(frame),
            skip: skip(frame),
            skip_ahead: None,
        };
        if let Some(pair) = input.adjacent {
            let evidence = &pair.forward;
            let counted = (0..evidence.counted.len()).filter(|&cell| evidence.counted[cell]);
            let (sum, cells) = counted.fold((0.0, 0usize), |(sum, cells), cell| {
                (sum + f64::from(evidence.error_px[cell]), cells + 1)
            });
            error_px.push((frame, sum / cells.max(1) as f64));
        }
        stream.push(input).unwrap();
    }
    Scores {
        faults: stream.finish(true),
        error_px,
    }
}

impl Scores {
    /// The paper's rule: the largest |e_t − e_{t−1}| after frame 7.
    pub(crate) fn paper_peak(&self) -> (usize, f64) {
        self.error_px
            .windows(2)
            .filter(|pair| pair[1].0 > 7)
            .map(|pair| (pair[1].0, (pair[1].1 - pair[0].1).abs()))
            .fold(
                (0, -1.0),
                |best, jump| if jump.1 > best.1 { jump } else { best },
            )
    }
}

impl Outcome {
    /// How the worst frame of a detector agrees with the truth: within one frame of the fault, and its
    /// peak within one cell of the fault's cells (those covered by more than 0.3).
    pub(crate) fn hit(&self, detector: FaultKind) -> Hit {
        let worst = self.scores.faults.largest(detector);
        Hit {
            temporal: worst.is_some_and(|worst| self.is_near(worst.frame)),
            pointing: self.mask.as_ref().map(|mask| {
                let place = worst.and_then(|worst| worst.place);
                place.is_some_and(|place| {
                    let near = |i: usize, n: usize| i.saturating_sub(1)..(i + 2).min(n);
                    near(place.peak[1], mask.height).any(|y| {
                        near(place.peak[0], mask.width).any(|x| mask.data[y * mask.width + x] > 0.3)
                    })
                })
            }),
        }
    }

    /// Within one frame of the fault.
    pub(crate) fn is_near(&self, frame: usize) -> bool {
        (self.span[0]..=self.span[1] + 2).contains(&(frame + 1))
    }
}
