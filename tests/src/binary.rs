//! Where the built commands are. Cargo names binaries only to tests of their own package, so they are
//! looked for beside the running test and built where they are absent or older than their sources. The
//! environment variables `PLUMBLINE_TEST_BINARY` and `PLUMBLINE_TEST_WORKER_BINARY` name others (installed
//! ones, say).

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::SystemTime;

/// The `plumbline` of the profile that the running test was built with.
pub fn plumbline() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| find("plumbline", "PLUMBLINE_TEST_BINARY"))
}

/// The `plumbline-worker` of the same.
pub fn worker() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| find("plumbline-worker", "PLUMBLINE_TEST_WORKER_BINARY"))
}

fn find(name: &str, variable: &str) -> PathBuf {
    if let Some(named) = std::env::var_os(variable) {
        return PathBuf::from(named);
    }
    // target/<profile>/deps/<test>
    let test = std::env::current_exe().expect("the test has a path");
    let profile_directory = test
        .ancestors()
        .nth(2)
        .expect("tests lie in target/<profile>/deps");
    let binary = profile_directory.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    if !is_current(&binary) {
        build(profile_directory, name);
    }
    assert!(binary.is_file(), "{} was not built", binary.display());
    binary
}

/// Whether the binary is there and as new as every source that Cargo noted beside it.
fn is_current(binary: &Path) -> bool {
    let Some(built) = modified(binary) else {
        return false;
    };
    let noted = std::fs::read_to_string(binary.with_extension("d")).unwrap_or_default();
    let sources = noted.split_once(": ").map_or("", |(_, sources)| sources);
    // Cargo writes a space inside a path as `\ `.
    sources
        .replace("\\ ", "\0")
        .split_whitespace()
        .map(|source| PathBuf::from(source.replace('\0', " ")))
        .all(|source| modified(&source).is_some_and(|changed| changed <= built))
}

fn modified(path: &Path) -> Option<SystemTime> {
    path.metadata().ok()?.modified().ok()
}

fn build(profile_directory: &Path, name: &str) {
    let profile = match profile_directory.file_name().and_then(OsStr::to_str) {
        Some("debug") | None => "dev",
        Some(name) => name,
    };
    let target = profile_directory.parent().expect("target/<profile>");
    let status = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        // The whole workspace, or other features are chosen and half of the dependencies built anew.
        .args(["build", "--quiet", "--workspace", "--bin", name])
        .args(["--profile", profile, "--target-dir"])
        .arg(target)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .status()
        .expect("cargo starts");
    assert!(status.success(), "{name} does not build: {status}");
}
