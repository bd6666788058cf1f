//! What every Plumbline process shares: ids, score rows, messages, frames, file times, telemetry; with
//! the feature `fleet` also object stores and queues.

#[cfg(feature = "fleet")]
pub mod backoff;
pub mod file_time;
pub mod frame;
pub mod id;
pub mod message;
#[cfg(feature = "fleet")]
pub mod queue;
pub mod row;
#[cfg(feature = "fleet")]
pub mod store;
pub mod telemetry;
