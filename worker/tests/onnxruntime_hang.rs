//! A library that never answers is refused in time. The thread that loads it stays, and with it the lock
//! under which libraries are loaded: hence a test binary of its own.

mod false_library;

use std::time::Duration;

use plumbline_worker::learned::Runtime;

#[test]
fn a_library_that_hangs_is_refused_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let hangs = false_library::library(folder.path(), "hangs", "for (;;) sleep(1); return &known;");
    let error = Runtime::load_within(&hangs, Duration::from_millis(300)).unwrap_err();
    assert!(error.to_string().contains("no answer in 0.3 s"), "{error}");
}
