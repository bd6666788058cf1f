//! Reads NumPy archives of the reference's numbers.

#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "what cannot be read fails the test, or is said to be missing"
)]

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use npyz::npz::NpzArchive;
use npyz::{DType, NpyFile, TypeChar};

/// An archive of `tests/golden`, or of `../shared/golden` beside the repository.
pub(crate) struct Archive(NpzArchive<BufReader<File>>);

impl Archive {
    pub(crate) fn open(name: &str) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/golden")
            .join(name);
        Self(NpzArchive::new(BufReader::new(File::open(path).unwrap())).unwrap())
    }

    /// An archive that is too large for the repository; says so where it is not at hand.
    pub(crate) fn shared(name: &str) -> Option<Self> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .ancestors()
            .map(|folder| folder.join("shared/golden").join(name))
            .find(|path| path.is_file());
        if path.is_none() {
            println!("skipped: no ../shared");
        }
        Some(Self(
            NpzArchive::new(BufReader::new(File::open(path?).unwrap())).unwrap(),
        ))
    }

    pub(crate) fn has(&mut self, key: &str) -> bool {
        self.0.by_name(key).unwrap().is_some()
    }

    pub(crate) fn shape(&mut self, key: &str) -> Vec<usize> {
        let file = self
            .0
            .by_name(key)
            .unwrap()
            .unwrap_or_else(|| panic!("{key} is missing"));
        file.shape().iter().map(|&n| n as usize).collect()
    }

    /// Numbers of any type as f64.
    pub(crate) fn f64(&mut self, key: &str) -> Vec<f64> {
        let file = self
            .0
            .by_name(key)
            .unwrap()
            .unwrap_or_else(|| panic!("{key} is missing"));
        let DType::Plain(kind) = file.dtype() else {
            panic!("{key} is not a plain array")
        };
        fn read<R: std::io::Read, T: npyz::Deserialize>(
            file: NpyFile<R>,
            f: impl Fn(T) -> f64,
        ) -> Vec<f64> {
            file.into_vec::<T>().unwrap().into_iter().map(f).collect()
        }
        match (kind.type_char(), kind.size_field()) {
            (TypeChar::Float, 4) => read(file, |x: f32| f64::from(x)),
            (TypeChar::Float, 8) => read(file, |x: f64| x),
            (TypeChar::Int, 2) => read(file, |x: i16| f64::from(x)),
            (TypeChar::Uint, 1) => read(file, |x: u8| f64::from(x)),
            (TypeChar::Int, 8) => read(file, |x: i64| x as f64),
            other => panic!("{key}: {other:?}"),
        }
    }

    pub(crate) fn f32(&mut self, key: &str) -> Vec<f32> {
        self.f64(key).into_iter().map(|x| x as f32).collect()
    }

    pub(crate) fn bytes(&mut self, key: &str) -> Vec<u8> {
        self.f64(key).into_iter().map(|x| x as u8).collect()
    }

    pub(crate) fn indices(&mut self, key: &str) -> Vec<usize> {
        self.f64(key).into_iter().map(|x| x as usize).collect()
    }
}

/// The largest |a − b|; infinite where one is not a number.
pub(crate) fn farthest(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let distances = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
    distances.fold(0.0, |worst, d| {
        if d.is_nan() {
            f32::INFINITY
        } else {
            worst.max(d)
        }
    })
}

/// The largest |a − b| / (1 + |b|): absolute below 1, relative above.
pub(crate) fn worst(found: impl IntoIterator<Item = f64>, expected: &[f64]) -> f64 {
    let found: Vec<f64> = found.into_iter().collect();
    assert_eq!(found.len(), expected.len());
    found
        .iter()
        .zip(expected)
        .map(|(a, b)| {
            let difference = (a - b).abs() / (1.0 + b.abs());
            if difference.is_nan() {
                f64::INFINITY
            } else {
                difference
            }
        })
        .fold(0.0, f64::max)
}
