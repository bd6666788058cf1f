//! Every target over its committed corpus: seeds that read, and bytes that once broke something.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking, and names the file at which it does"
)]

use std::path::Path;

/// How many files of its corpus a target was run over.
fn run(name: &str) -> usize {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpus")
        .join(name);
    let target = plumbline_fuzz::target(name).unwrap();
    let files = std::fs::read_dir(&directory).unwrap();
    let mut count = 0;
    for file in files {
        let path = file.unwrap().path();
        // Names the file where the target panics.
        eprintln!("{}", path.display());
        target(&std::fs::read(&path).unwrap());
        count += 1;
    }
    count
}

#[test]
fn every_target_takes_its_corpus() {
    for (name, _) in plumbline_fuzz::TARGETS {
        assert!(run(name) >= 3, "{name} has no corpus");
    }
}

/// Cut and flipped seeds: what a search finds first, at every run of the tests.
#[test]
fn every_target_takes_its_damaged_corpus() {
    for (name, target) in plumbline_fuzz::TARGETS {
        let directory = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("corpus")
            .join(name);
        for file in std::fs::read_dir(&directory).unwrap() {
            let seed = std::fs::read(file.unwrap().path()).unwrap();
            for part in 1..8 {
                let at = seed.len() * part / 8;
                target(&seed[..at]);
                let mut flipped = seed.clone();
                if let Some(byte) = flipped.get_mut(at) {
                    *byte ^= 1 << part;
                    target(&flipped);
                }
            }
        }
    }
}
