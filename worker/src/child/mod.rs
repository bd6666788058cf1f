//! The compute child: a long-lived process that measures one video after another, so that a hostile
//! or broken video costs one row and not the run.
//!
//! The same binary runs again with [`CHILD_ARGUMENT`]; parent and child speak frames
//! (`plumbline_common::frame`) over the child's standard input and output. The child limits its own
//! memory, gives up writing files and reaching the network (`sandbox`), and ends as soon as its input closes,
//! which also happens when the parent is killed. The parent ends a child that passes its deadline.

mod process;
mod protocol;
mod running;
mod sandbox;
mod slot;

pub use process::run;
pub use running::Drawing;
pub use sandbox::{Protection, probe};
pub(crate) use slot::MAX_ATTEMPTS;
pub use slot::{ComputeLimits, ComputeSlot, Measured, SlotError};

/// The hidden first argument that makes a Plumbline binary a compute child.
pub const CHILD_ARGUMENT: &str = "compute-child";

/// The hidden second argument: the child's memory limit in MiB.
pub const MEMORY_ARGUMENT: &str = "--memory-mib";
