//! `worldscore_epe` against the reference's own numbers (`tests/golden/README.md`).
//!
//! All is compared exactly: failure masks, counts and, to the last bit, the averages, whose terms are
//! summed in NumPy's order (`numpy_sum` in `src/consistency/worldscore.rs`). Every operation involved is
//! correctly rounded by IEEE 754, so no machine may differ. Non-finite averages are `None` here.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "what cannot be read fails the test"
)]

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use npyz::npz::NpzArchive;
use plumbline_vision::consistency::{ConsistencyError, worldscore_epe};
use plumbline_vision::flow::Flow;

const CASES: [&str; 13] = [
    "smooth",
    "smooth_inverse",
    "zero",
    "constant",
    "constant_onesided",
    "out_of_frame",
    "ties",
    "small_31x31",
    "small_31x40",
    "small_33x32",
    "threshold_exact_5",
    "rough_tall",
    "nonfinite",
];

type Archive = NpzArchive<BufReader<File>>;

fn array<T: npyz::Deserialize>(archive: &mut Archive, key: &str) -> (Vec<u64>, Vec<T>) {
    let file = archive
        .by_name(key)
        .unwrap()
        .unwrap_or_else(|| panic!("{key} is missing"));
    (file.shape().to_vec(), file.into_vec().unwrap())
}

fn flow(archive: &mut Archive, key: &str) -> Flow {
    let (shape, values) = array::<f32>(archive, key);
    assert_eq!(shape[2], 2);
    Flow {
        width: shape[1] as usize,
        height: shape[0] as usize,
        data: values.chunks_exact(2).map(|v| [v[0], v[1]]).collect(),
    }
}

#[test]
fn all_cases_match_the_reference() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/worldscore_epe.npz");
    let mut archive = NpzArchive::new(BufReader::new(File::open(path).unwrap())).unwrap();
    for case in CASES {
        let forward = flow(&mut archive, &format!("{case}/flow1"));
        let backward = flow(&mut archive, &format!("{case}/flow2"));
        let average = array::<f64>(&mut archive, &format!("{case}/avg_epe")).1[0];
        let failures = array::<i64>(&mut archive, &format!("{case}/failure_count")).1[0];
        let mask = array::<u8>(&mut archive, &format!("{case}/failure_mask")).1;

        let epe = worldscore_epe(&forward, &backward).unwrap();
        let expected_mask: Vec<bool> = mask.iter().map(|&m| m != 0).collect();
        assert_eq!(epe.failure_mask, expected_mask, "{case}");
        assert_eq!(epe.failure_count as i64, failures, "{case}");
        match epe.average_px {
            Some(found) => assert_eq!(found.to_bits(), average.to_bits(), "{case}"),
            None => assert!(!average.is_finite(), "{case}: {average} was lost"),
        }
    }
}

#[test]
fn an_empty_crop_has_no_average_and_a_mismatch_is_an_error() {
    let still = |width: usize, height: usize| Flow {
        width,
        height,
        data: vec![[0.0; 2]; width * height],
    };
    for (width, height) in [(30, 64), (64, 30), (1, 1), (0, 0)] {
        let epe = worldscore_epe(&still(width, height), &still(width, height)).unwrap();
        assert_eq!((epe.average_px, epe.failure_count), (None, 0));
    }
    assert!(matches!(
        worldscore_epe(&still(40, 40), &still(40, 41)),
        Err(ConsistencyError::SizeMismatch { .. })
    ));
    let mut short = still(40, 40);
    short.data.pop();
    assert!(matches!(
        worldscore_epe(&short, &still(40, 40)),
        Err(ConsistencyError::Image(_))
    ));
}
