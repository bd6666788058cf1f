//! The same series from this crate, on flow and frames that are given.

use std::collections::BTreeMap;

use plumbline_vision::consistency::{ConsistencyParams, Evidence, GridFlow, NormalisedFrame};
use plumbline_vision::faults::{ChangePair, FaultInput, FaultKind, FaultParams, FaultStream};
use plumbline_vision::image::Rgb8;
use plumbline_vision::signals::arc::{ArcParams, ArcSignals};
use plumbline_vision::signals::contact::{ContactParams, ContactStream};
use plumbline_vision::signals::{
    PiecewiseParams, SignalParams, appearance_ratio, median, piecewise_residual,
};

pub(crate) type Series = Vec<Option<f64>>;

/// What is measured of a clip, by the names of the export.
#[derive(Debug, Default)]
pub(crate) struct Measured {
    pub(crate) series: BTreeMap<&'static str, Series>,
    /// P under each of [`SEEDS`].
    pub(crate) piecewise: Vec<Series>,
    pub(crate) moved_share: f64,
    pub(crate) revealed_changed: f64,
    /// Peaks of `step`, cells, x then y.
    pub(crate) step_peaks: Vec<Option<[usize; 2]>>,
}

/// P is drawn at random: one seed says nothing about the next.
pub(crate) const SEEDS: std::ops::Range<u64> = 0..8;

/// A clip's frames and evidence.
pub(crate) struct Input<'a> {
    pub(crate) frames: &'a [NormalisedFrame],
    pub(crate) pictures: &'a [Rgb8],
    /// Pairs (t, t + 1).
    pub(crate) adjacent: &'a [ChangePair],
    /// Pairs (t, t + 2).
    pub(crate) skip: &'a [ChangePair],
    pub(crate) kept: &'a [usize],
    /// Evidence kept → next kept.
    pub(crate) steps: Vec<Evidence>,
}

pub(crate) fn change_pair(
    forward: &GridFlow,
    backward: &GridFlow,
    first: &NormalisedFrame,
    second: &NormalisedFrame,
    params: &ConsistencyParams,
) -> ChangePair {
    ChangePair::new(
        Evidence::new(forward, backward, first, second, params).unwrap(),
        Evidence::new(backward, forward, second, first, params).unwrap(),
    )
}

pub(crate) fn measure(input: Input<'_>) -> Measured {
    let mut measured = Measured::default();
    pair_signals(&input, &mut measured);
    faults(&input, &mut measured);
    let mut contact = ContactStream::new(ContactParams::default());
    for (t, picture) in input.pictures.iter().enumerate() {
        let pair = t.checked_sub(1).map(|before| &input.adjacent[before]);
        contact.push(picture, pair).unwrap();
    }
    let contact = contact.finish().unwrap();
    measured.moved_share = contact.moved_share;
    measured.revealed_changed = contact.revealed_changed;
    constant_motion(input, &mut measured);
    measured
}

fn pair_signals(input: &Input<'_>, measured: &mut Measured) {
    let params = SignalParams::default();
    let forward = || input.adjacent.iter().map(|pair| &pair.forward);
    let appearance = forward().map(|evidence| appearance_ratio(evidence, &params));
    measured.series.insert("T", appearance.collect());
    for seed in SEEDS {
        let seeded = PiecewiseParams {
            seed,
            ..PiecewiseParams::default()
        };
        let residual = |evidence| piecewise_residual(evidence, params.moving_px, &seeded);
        measured.piecewise.push(forward().map(residual).collect());
    }
    measured.series.insert("P", measured.piecewise[0].clone());
}

fn faults(input: &Input<'_>, measured: &mut Measured) {
    // The prototype's pers does not weigh by drift: no drift is long on this scale. Its gate of vanq and
    // its freeze rule are those of the evidence.
    let params = FaultParams {
        drift_scale_px: f32::MAX,
        quiet_scale: 0.15,
        freeze_needs_motion_around: false,
        ..FaultParams::default()
    };
    let mut stream = FaultStream::new(params).unwrap();
    for (frame, picture) in input.frames.iter().enumerate() {
        let before = |pairs: &'_ [ChangePair], span: usize| -> Option<usize> {
            frame.checked_sub(span).filter(|&start| start < pairs.len())
        };
        stream
            .push(FaultInput {
                frame,
                picture,
                adjacent: before(input.adjacent, 1).map(|start| &input.adjacent[start]),
                skip: before(input.skip, 2).map(|start| &input.skip[start]),
                skip_ahead: None,
            })
            .unwrap();
    }
    let found = stream.finish(true);
    for (name, kind) in [
        ("V", FaultKind::BadFrame),
        ("xr", FaultKind::Jump),
        ("step_text", FaultKind::Appear),
        ("vanq", FaultKind::Vanish),
        ("pers_in_frame", FaultKind::Flicker),
        ("freeze", FaultKind::Freeze),
    ] {
        let mut series = vec![None; input.frames.len()];
        for point in found.points(kind) {
            series[point.frame] = Some(point.score);
        }
        measured.series.insert(name, series);
    }
    measured.step_peaks = vec![None; input.frames.len()];
    for point in found.points(FaultKind::Appear) {
        measured.step_peaks[point.frame] = point.place.map(|place| place.peak);
    }
}

fn constant_motion(input: Input<'_>, measured: &mut Measured) {
    let mut arc = ArcSignals::new(ArcParams::default()).unwrap();
    let mut steps = input.steps.into_iter();
    for (position, &frame) in input.kept.iter().enumerate() {
        let step = if position == 0 { None } else { steps.next() };
        arc.push(frame, &input.frames[frame], step).unwrap();
    }
    let steps = arc.finish().steps;
    let series = |value: &dyn Fn(usize) -> Option<f64>| (0..steps.len()).map(value).collect();
    let shear: Series = series(&|k| steps[k].interior_shear);
    let acceleration: Series = series(&|k| steps[k].layer_acceleration);
    let detail: Series = series(&|k| steps[k].detail_change);
    measured.series.insert("Sd", shear);
    // Two steps settle the first acceleration, four the first change of detail, then every other.
    let later = acceleration.into_iter().skip(1).collect();
    measured.series.insert("accs", later);
    let started = detail.into_iter().skip(3).step_by(2).collect();
    measured.series.insert("sh", started);
}

/// A clip's value: the median of at least three defined ones.
pub(crate) fn clip_value(series: &[Option<f64>]) -> Option<f64> {
    let mut defined: Vec<f64> = series.iter().flatten().copied().collect();
    if defined.len() < 3 {
        return None;
    }
    median(&mut defined)
}
