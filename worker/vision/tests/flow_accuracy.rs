//! Mean end-point error of every preset over the eight pairs with ground truth in `../shared/data/flow`
//! (Middlebury and FlyingChairs; vectors above 1e9 are unknown), each under a ceiling.
//!
//! The ceilings are OpenCV 5.0.0's own means with its presets (ultrafast at other finest scales too),
//! one thread (`DISOpticalFlow` on `cvtColor` grey): this implementation must be no worse.

#![expect(clippy::unwrap_used, reason = "what cannot be read fails the test")]

use std::path::{Path, PathBuf};

use plumbline_vision::flow::Flow;
use plumbline_vision::flow::accuracy::FlowAccuracy;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::flow::file::middlebury;
use plumbline_vision::image::{Plane, Rgb8};

const PAIRS: usize = 8;

fn shared_pairs() -> Option<Vec<PathBuf>> {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = manifest
        .ancestors()
        .map(|folder| folder.join("shared/data/flow"))
        .find(|folder| folder.is_dir())?;
    let mut pairs: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    pairs.sort();
    Some(pairs)
}

fn grey(path: &Path) -> Plane {
    let picture = image::open(path).unwrap().to_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    Rgb8::new(width, height, picture.into_raw()).unwrap().grey()
}

fn mean_end_point_error(found: &Flow, truth: &Path) -> f64 {
    let truth = middlebury::decode(&std::fs::read(truth).unwrap()).unwrap();
    let accuracy = FlowAccuracy::new(found, &truth).unwrap().unwrap();
    accuracy.mean_epe_px
}

#[test]
fn presets_are_no_worse_than_opencv() {
    let Some(pairs) = shared_pairs() else {
        println!("skipped: no ../shared");
        return;
    };
    assert_eq!(pairs.len(), PAIRS);
    let presets = [
        ("ultrafast, finest scale 2", DisParams::ultrafast(2), 2.2747),
        ("ultrafast, finest scale 1", DisParams::ultrafast(1), 1.9289),
        ("ultrafast, finest scale 0", DisParams::ultrafast(0), 1.7312),
        ("fast", DisParams::fast(), 2.0376),
        ("medium", DisParams::medium(), 2.0186),
    ];
    for (name, params, opencv_px) in presets {
        let mut dis = Dis::new(params.clone());
        let mut sum = 0.0;
        for pair in &pairs {
            let frame = |file: &str| DisFrame::new(&grey(&pair.join(file)), &params).unwrap();
            let flow = dis
                .flow(&frame("frame1.png"), &frame("frame2.png"))
                .unwrap();
            sum += mean_end_point_error(&flow, &pair.join("gt.flo"));
        }
        let mean = sum / pairs.len() as f64;
        println!("{name}: {mean:.4} px (OpenCV {opencv_px:.4})");
        assert!(mean <= opencv_px, "{name}: {mean} px");
    }
}
