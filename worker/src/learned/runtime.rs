//! ONNX Runtime's shared library: loaded, its version checked, and probed, before anything relies on it.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use ort::LoadDynamicError;
use ort::environment::Environment;
use plumbline_vision::learned::{Network, TensorView};

use super::session::{OrtNetwork, Threads};

/// Loading takes tens of milliseconds, from a cold disk seconds.
const LOAD_TIMEOUT: Duration = Duration::from_secs(30);
const REMEDY: &str = "deploy/models/setup.sh installs a fitting one and prints its path";
/// A convolution by 3 × 3 eighths, plus one (`deploy/models/make_probe.py`).
const PROBE: &[u8] = include_bytes!("probe.onnx");

/// The library, ready for use. One per process: loading it again gives the same.
#[derive(Debug)]
pub struct Runtime {
    pub(super) environment: Environment,
    library: PathBuf,
}

/// ONNX Runtime cannot be used; says what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RuntimeError {
    /// There is no such file.
    #[error("no ONNX Runtime library at {path}; {REMEDY}", path = path.display())]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// The file cannot be loaded, or is another library.
    #[error("{path} is not an ONNX Runtime library for this machine ({reason}); {REMEDY}", path = path.display())]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What the loader says.
        reason: String,
    },
    /// The library is older than what this program was written for.
    #[error("{path} is ONNX Runtime {found}, 1.{least} or newer is needed; {REMEDY}", path = path.display(), least = ort::MINOR_VERSION)]
    TooOld {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: String,
    },
    /// It loads, and computes wrongly, fails, or does not answer.
    #[error("ONNX Runtime at {path} does not work: {reason}; {REMEDY}", path = path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        reason: String,
    },
    /// Another library was loaded before.
    #[error("this process already uses the ONNX Runtime at {loaded}, not the one at {path}", loaded = loaded.display(), path = path.display())]
    Another {
        /// The one asked for.
        path: PathBuf,
        /// The one in use.
        loaded: PathBuf,
    },
}

/// The library in use; a process cannot have two, nor unload one.
static LOADED: OnceLock<Runtime> = OnceLock::new();
static LOADING: Mutex<()> = Mutex::new(());

impl Runtime {
    /// Loads the library at `path`, checks its version and runs a small model.
    ///
    /// # Errors
    /// [`RuntimeError`] with the remedy; a library that hangs for half a minute is an error too.
    pub fn load(path: &Path) -> Result<&'static Self, RuntimeError> {
        Self::load_within(path, LOAD_TIMEOUT)
    }

    /// [`load`](Self::load) with another patience.
    ///
    /// # Errors
    /// [`RuntimeError`] with the remedy.
    pub fn load_within(path: &Path, timeout: Duration) -> Result<&'static Self, RuntimeError> {
        let Ok(path) = path.canonicalize() else {
            return Err(RuntimeError::Missing {
                path: path.to_owned(),
            });
        };
        // It guards no data: what a panic left behind is no worse for the next.
        let _loading = LOADING.lock().unwrap_or_else(PoisonError::into_inner);
        let runtime = match LOADED.get() {
            Some(runtime) => runtime,
            None => {
                let loaded = guarded(&path, timeout)?;
                LOADED.get_or_init(|| loaded)
            }
        };
        if runtime.library == path {
            Ok(runtime)
        } else {
            Err(RuntimeError::Another {
                path,
                loaded: runtime.library.clone(),
            })
        }
    }

    /// The library's file.
    #[must_use]
    pub fn library(&self) -> &Path {
        &self.library
    }
}

/// Loads on a thread of its own: a foreign library may panic or never return.
fn guarded(path: &Path, timeout: Duration) -> Result<Runtime, RuntimeError> {
    let (sender, receiver) = sync_channel(1);
    let own_path = path.to_owned();
    let broken = |reason: String| RuntimeError::Broken {
        path: path.to_owned(),
        reason,
    };
    std::thread::Builder::new()
        .name("onnxruntime-probe".to_owned())
        .spawn(move || {
            // The receiver is gone only after the timeout.
            let _ = sender.send(load(&own_path));
        })
        .map_err(|error| broken(error.to_string()))?;
    match receiver.recv_timeout(timeout) {
        Ok(loaded) => loaded,
        Err(RecvTimeoutError::Timeout) => {
            Err(broken(format!("no answer in {} s", timeout.as_secs_f64())))
        }
        Err(RecvTimeoutError::Disconnected) => Err(broken("it crashed while loading".to_owned())),
    }
}

fn load(path: &Path) -> Result<Runtime, RuntimeError> {
    let path = path.to_owned();
    let builder = match ort::init_from(&path) {
        Ok(builder) => builder,
        Err(LoadDynamicError::BadVersion { version_str, .. }) => {
            return Err(RuntimeError::TooOld {
                path,
                found: version_str,
            });
        }
        Err(LoadDynamicError::Dlopen { error, .. }) => {
            let reason = std::error::Error::source(&error)
                .map_or_else(|| error.to_string(), ToString::to_string);
            return Err(RuntimeError::Unusable { path, reason });
        }
        Err(LoadDynamicError::MissingApi { .. }) => {
            return Err(RuntimeError::Unusable {
                path,
                reason: "it has no OrtGetApiBase".to_owned(),
            });
        }
        Err(error @ LoadDynamicError::InvalidVersionString) => {
            return Err(RuntimeError::Unusable {
                path,
                reason: error.to_string(),
            });
        }
    };
    let broken = |reason: String| RuntimeError::Broken {
        path: path.clone(),
        reason,
    };
    let environment = builder
        .with_name("plumbline")
        .with_telemetry(false)
        .build()
        .map_err(|error| broken(error.to_string()))?;
    probe(&environment).map_err(broken)?;
    Ok(Runtime {
        environment,
        library: path,
    })
}

/// Runs the probe on a picture of ones: inner pixels see nine eighths, the corner four.
fn probe(environment: &Environment) -> Result<(), String> {
    let (rows, columns) = (5, 6);
    let mut network = OrtNetwork::open(environment, "probe", PROBE, Threads::ONE)
        .map_err(|error| error.to_string())?;
    let picture = TensorView {
        shape: &[1, 1, rows, columns],
        data: &[1.0; 30],
    };
    let outputs = network
        .run(&[("picture", picture)], &["blurred"])
        .map_err(|error| error.to_string())?;
    let found = outputs.first().map(|tensor| tensor.data.as_slice());
    let expected: Vec<f32> = (0..rows * columns)
        .map(|at| {
            let seen = |at: usize, size: usize| if at == 0 || at == size - 1 { 2.0 } else { 3.0 };
            seen(at / columns, rows) * seen(at % columns, columns) / 8.0 + 1.0
        })
        .collect();
    // Sums of eighths are exact in any order.
    if found == Some(expected.as_slice()) {
        Ok(())
    } else {
        Err(format!("a convolution gave {found:?}, not {expected:?}"))
    }
}
