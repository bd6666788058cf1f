//! The fuzzer: libFuzzer around the target that `PLUMBLINE_FUZZ_TARGET` names.
//! `deploy/fuzz.sh` builds and runs it.

#![no_main]
#![allow(unsafe_code, reason = "the fuzzer enters by a function of C")]

use std::sync::OnceLock;

static TARGET: OnceLock<fn(&[u8])> = OnceLock::new();

#[expect(clippy::panic, reason = "there is nobody else to tell")]
fn chosen() -> fn(&[u8]) {
    let name = std::env::var("PLUMBLINE_FUZZ_TARGET").unwrap_or_default();
    let names = plumbline_fuzz::TARGETS.map(|(name, _)| name).join(", ");
    plumbline_fuzz::target(&name)
        .unwrap_or_else(|| panic!("PLUMBLINE_FUZZ_TARGET={name}: the targets are {names}"))
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| { TARGET.get_or_init(chosen)(bytes) });
