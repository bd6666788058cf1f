//! Mean end-point error of every preset over the eight pairs with ground truth in `../shared/data/flow`
//! (Middlebury and FlyingChairs; vectors above 1e9 are unknown), each under a ceiling.
//!
//! The ceilings are OpenCV 5.0.0's own means with its presets (ultrafast at other finest scales too),
//! one thread (`DISOpticalFlow` on `cvtColor` grey): this implementation must be no worse.

#![expect(clippy::unwrap_used, reason = "what cannot be read fails the test")]

use std::path::{Path, PathBuf};

use plumbline_vision::flow::Flow;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::image::{Plane, Rgb8};

const PAIRS: usize = 8;
const UNKNOWN: f32 = 1e9;

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

/// Middlebury's `.flo`: the tag "PIEH", width, height, then interleaved little-endian floats.
fn read_flo(path: &Path) -> Flow {
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(&bytes[..4], b"PIEH");
    let word = |at: usize| <[u8; 4]>::try_from(&bytes[at..at + 4]).unwrap();
    let float = |at: usize| f32::from_le_bytes(word(at));
    let (width, height) = (
        u32::from_le_bytes(word(4)) as usize,
        u32::from_le_bytes(word(8)) as usize,
    );
    let vector = |i: usize| [float(12 + 8 * i), float(16 + 8 * i)];
    Flow {
        width,
        height,
        data: (0..width * height).map(vector).collect(),
    }
}

fn mean_end_point_error(found: &Flow, truth: &Flow) -> f64 {
    assert_eq!((found.width, found.height), (truth.width, truth.height));
    let errors: Vec<f64> = found
        .data
        .iter()
        .zip(&truth.data)
        .filter(|(_, t)| t.iter().all(|c| c.abs() < UNKNOWN))
        .map(|(f, t)| f64::from(f[0] - t[0]).hypot(f64::from(f[1] - t[1])))
        .collect();
    errors.iter().sum::<f64>() / errors.len() as f64
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
            sum += mean_end_point_error(&flow, &read_flo(&pair.join("gt.flo")));
        }
        let mean = sum / pairs.len() as f64;
        println!("{name}: {mean:.4} px (OpenCV {opencv_px:.4})");
        assert!(mean <= opencv_px, "{name}: {mean} px");
    }
}
