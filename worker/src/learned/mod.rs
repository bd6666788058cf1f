//! Learned networks through ONNX Runtime: the shared library, the converted model sets, their sessions.
//!
//! [`Runtime`] is loaded once per process; a [`ModelSet`] is a directory that `deploy/models/convert.py`
//! wrote, read whole and verified by its digests; from it come [`sea_raft`](ModelSet::sea_raft) and
//! [`droid`](ModelSet::droid), which `plumbline_vision::learned` drives.

mod model_set;
mod runtime;
mod session;

pub use model_set::{ModelError, ModelSet};
pub use runtime::{Runtime, RuntimeError};
pub use session::{OrtNetwork, Threads};
