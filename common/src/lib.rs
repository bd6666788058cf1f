//! What every Plumbline process shares: ids, score rows, messages, frames, telemetry.

pub mod frame;
pub mod id;
pub mod message;
pub mod row;
pub mod telemetry;
