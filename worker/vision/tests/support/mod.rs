//! Runs the fault detectors over a clip's pictures as the worker does, at the settings of one profile.

#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "what cannot be read fails the test"
)]

use std::collections::VecDeque;

use plumbline_sample::RgbFrame;
use plumbline_vision::consistency::{ConsistencyParams, Evidence, GridFlow, NormalisedFrame};
use plumbline_vision::faults::{ChangePair, FaultInput, FaultParams, FaultSeries, FaultStream};
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::image::{Rgb8, resize_rgb};
use plumbline_vision::signals::contact::{Contact, ContactParams, ContactStream};

/// What of a profile decides the fault scores.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rung {
    pub(crate) name: &'static str,
    pub(crate) height_px: usize,
    pub(crate) finest_scale: u32,
    /// Whether there are pairs one frame apart.
    pub(crate) skips: bool,
}

pub(crate) const DRAFT: Rung = Rung {
    name: "draft",
    height_px: 128,
    finest_scale: 2,
    skips: false,
};
pub(crate) const STANDARD: Rung = Rung {
    name: "standard",
    height_px: 256,
    finest_scale: 1,
    skips: true,
};
pub(crate) const ACCURATE: Rung = Rung {
    name: "accurate",
    height_px: 512,
    finest_scale: 0,
    skips: true,
};

/// A frame ready for pairs, at working size.
pub(crate) struct Prepared {
    pub(crate) rgb: Rgb8,
    pub(crate) dis: DisFrame,
    pub(crate) picture: NormalisedFrame,
}

/// Flow and evidence at a rung's settings.
pub(crate) struct Measure {
    pub(crate) rung: Rung,
    params: ConsistencyParams,
    dis: Dis,
}

impl Measure {
    pub(crate) fn new(rung: Rung) -> Self {
        Self {
            rung,
            params: ConsistencyParams::default(),
            dis: Dis::new(DisParams::ultrafast(rung.finest_scale)),
        }
    }

    pub(crate) fn prepare(&self, rgb: &Rgb8) -> Prepared {
        let height = self.rung.height_px;
        let width = (rgb.width * height + rgb.height / 2) / rgb.height;
        let rgb = resize_rgb(rgb, width, height);
        let grey = rgb.grey();
        Prepared {
            dis: DisFrame::new(&grey, &DisParams::ultrafast(self.rung.finest_scale)).unwrap(),
            picture: NormalisedFrame::new(&grey, &self.params).unwrap(),
            rgb,
        }
    }

    pub(crate) fn pair(&mut self, earlier: &Prepared, later: &Prepared) -> ChangePair {
        let mut flow = |a: &Prepared, b: &Prepared| {
            let flow = self.dis.flow(&a.dis, &b.dis).unwrap();
            GridFlow::new(&flow, &self.params).unwrap()
        };
        let (ahead, back) = (flow(earlier, later), flow(later, earlier));
        let evidence = |f: &GridFlow, b: &GridFlow, from: &Prepared, to: &Prepared| {
            Evidence::new(f, b, &from.picture, &to.picture, &self.params).unwrap()
        };
        ChangePair::new(
            evidence(&ahead, &back, earlier, later),
            evidence(&back, &ahead, later, earlier),
        )
    }
}

/// Fault series and contact statistic of a clip whose first picture is frame `first_frame`.
pub(crate) fn measure(
    pictures: impl IntoIterator<Item = Rgb8>,
    first_frame: usize,
    rung: Rung,
    camera_is_static: bool,
) -> (FaultSeries, Option<Contact>) {
    let mut measure = Measure::new(rung);
    let mut faults = FaultStream::new(FaultParams::default()).unwrap();
    let mut contact = ContactStream::new(ContactParams::default());
    let mut recent: VecDeque<Prepared> = VecDeque::new();
    for (position, picture) in pictures.into_iter().enumerate() {
        let current = measure.prepare(&picture);
        let adjacent = recent.back().map(|before| measure.pair(before, &current));
        let skip = (rung.skips && recent.len() == 2).then(|| measure.pair(&recent[0], &current));
        let input = FaultInput {
            frame: first_frame + position,
            picture: &current.picture,
            adjacent: adjacent.as_ref(),
            skip: skip.as_ref(),
            skip_ahead: None,
        };
        faults.push(input).unwrap();
        contact.push(&current.rgb, adjacent.as_ref()).unwrap();
        if recent.len() == 2 {
            recent.pop_front();
        }
        recent.push_back(current);
    }
    (faults.finish(camera_is_static), contact.finish())
}

/// A rendered picture.
pub(crate) fn picture(frame: RgbFrame) -> Rgb8 {
    Rgb8::new(frame.width, frame.height, frame.rgb).unwrap()
}

/// Runs `work` over the items on two threads; the results keep the items' order.
pub(crate) fn on_two_threads<T: Sync, R: Send>(
    items: &[T],
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let next = std::sync::atomic::AtomicUsize::new(0);
    let results = std::sync::Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    let Some(item) = items.get(index) else {
                        break;
                    };
                    let result = work(item);
                    results.lock().unwrap().push((index, result));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap();
    results.sort_by_key(|&(index, _)| index);
    results.into_iter().map(|(_, result)| result).collect()
}
