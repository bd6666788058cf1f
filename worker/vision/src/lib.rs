//! Plumbline's numerics: frames, optical flow, end-point errors, signals and motion models.
//!
//! Pure: slices and structs in, values out. No queue, store, clock or runtime is known here.

pub mod consistency;
mod exp;
pub mod faults;
pub mod flow;
pub mod image;
pub mod learned;
pub mod scene;
pub mod signals;
pub mod slam;
