//! Learned networks through ONNX Runtime: the shared library, the converted model sets, their sessions.
//!
//! [`Runtime`] is loaded once per process; a [`ModelSet`] is a directory that `deploy/models/convert.py`
//! wrote, read whole and verified by its digests; from it come [`sea_raft`](ModelSet::sea_raft) and
//! [`droid`](ModelSet::droid), which `plumbline_vision::learned` drives. A [`ModelSource`] finds sets by
//! digest; a compute child keeps what it has [`Loaded`].

mod loaded;
mod model_set;
mod runtime;
mod session;
mod source;

pub use loaded::{LoadError, Loaded, LoadedSeaRaft, Networks};
pub use model_set::{ModelError, ModelSet};
pub use runtime::{Runtime, RuntimeError};
pub use session::{OrtNetwork, Threads};
pub use source::{Kind, ModelPlaces, ModelSettings, ModelSource, SourceError};
