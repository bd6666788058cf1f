//! Everything that Plumbline reads from outside, each behind one function of arbitrary bytes: a fuzz target.
//!
//! A target fails by panicking: where the code under it panics, or where a promise is broken that the target
//! checks (what was read and is written again reads as the same). `deploy/fuzz.sh` searches for such bytes;
//! `tests/corpus.rs` runs every target over its committed corpus, in which what was found stays.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a target fails by panicking"
)]

mod config;
mod container;
mod flow_file;
mod list;
mod message;
mod sidecar;

use std::path::PathBuf;

/// What is done with arbitrary bytes.
pub type Target = fn(&[u8]);

/// The targets by name, which is also that of the directory of their corpus.
pub const TARGETS: [(&str, Target); 6] = [
    ("config", config::target),
    ("container", container::target),
    ("flow_file", flow_file::target),
    ("list", list::target),
    ("message", message::target),
    ("sidecar", sidecar::target),
];

/// The target of a name.
#[must_use]
pub fn target(name: &str) -> Option<Target> {
    let found = TARGETS.iter().find(|(known, _)| *known == name);
    found.map(|(_, target)| *target)
}

/// `bytes` as a file of that name, for code that reads files. Each process has a place of its own, in which
/// the file is overwritten; the directory goes with the value.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary directory"))
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).expect("a file in a temporary directory");
        path
    }
}

std::thread_local! {
    static PLACE: Place = Place::new();
}

/// The file's path, valid until the next call with that name on this thread.
fn as_file(name: &str, bytes: &[u8]) -> PathBuf {
    PLACE.with(|place| place.file(name, bytes))
}
