//! Shared libraries that are not ONNX Runtime, compiled for a test.

#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(clippy::unwrap_used, reason = "what cannot be made fails the test")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// A shared library of this C source.
pub(crate) fn compiled(folder: &Path, name: &str, text: &str) -> PathBuf {
    let source = folder.join(format!("{name}.c"));
    std::fs::write(&source, text).unwrap();
    let out = folder.join(format!("lib{name}.so"));
    let mut compiler = Command::new("cc");
    let compiler = compiler.args(["-shared", "-fPIC", "-o"]);
    assert!(compiler.arg(&out).arg(&source).status().unwrap().success());
    out
}

/// A library whose `OrtGetApiBase` does `body`.
pub(crate) fn library(folder: &Path, name: &str, body: &str) -> PathBuf {
    let text = format!(
        "#include <stddef.h>\n#include <unistd.h>\n\
         struct base {{ const void *(*api)(unsigned); const char *(*version)(void); }};\n\
         static const void *none(unsigned v) {{ (void)v; return NULL; }}\n\
         static const char *old(void) {{ return \"1.10.2\"; }}\n\
         static const struct base known = {{ none, old }};\n\
         const struct base *OrtGetApiBase(void) {{ {body} }}\n"
    );
    compiled(folder, name, &text)
}
