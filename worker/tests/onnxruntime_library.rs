//! Libraries that are not ONNX Runtime: each is refused with its reason and the remedy.
//!
//! The false libraries are compiled here. All is one test, since a process can load the library only once;
//! the one that hangs is in a test binary of its own.

#![allow(clippy::unwrap_used, reason = "what cannot be made fails the test")]

mod false_library;

use std::path::Path;

use false_library::{compiled, library};
use plumbline_worker::learned::{Runtime, RuntimeError};

#[test]
fn each_wrong_library_is_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let refused = |path: &Path, words: &str| {
        let error = Runtime::load(path).unwrap_err();
        let message = error.to_string();
        for word in [words, "deploy/models/setup.sh", path.to_str().unwrap()] {
            assert!(message.contains(word), "{message}");
        }
        error
    };
    let absent = folder.join("libabsent.so");
    assert!(matches!(
        refused(&absent, "no ONNX Runtime"),
        RuntimeError::Missing { .. }
    ));
    let text = folder.join("libtext.so");
    std::fs::write(&text, "not a library").unwrap();
    assert!(matches!(
        refused(&text, "not an ONNX Runtime"),
        RuntimeError::Unusable { .. }
    ));
    let other = compiled(folder, "other", "int other(void) { return 1; }\n");
    assert!(matches!(
        refused(&other, "OrtGetApiBase"),
        RuntimeError::Unusable { .. }
    ));
    let old = library(folder, "old", "return &known;");
    assert!(matches!(
        refused(&old, "1.10.2"),
        RuntimeError::TooOld { .. }
    ));
    let null = library(folder, "null", "return NULL;");
    assert!(matches!(
        refused(&null, "crashed"),
        RuntimeError::Broken { .. }
    ));

    // The right one still loads after all these, and no second one beside it.
    let right = Path::new(env!("CARGO_TARGET_TMPDIR")).join("models-venv/libonnxruntime.so");
    if right.exists() {
        let runtime = Runtime::load(&right).unwrap();
        assert_eq!(runtime.library(), right.canonicalize().unwrap());
        assert!(matches!(
            Runtime::load(&old),
            Err(RuntimeError::Another { .. })
        ));
    }
}
