//! What every Plumbline process shares: ids, score rows, messages, frames, file times, telemetry.

pub mod file_time;
pub mod frame;
pub mod id;
pub mod message;
pub mod row;
pub mod telemetry;
