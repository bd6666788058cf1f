//! What every Plumbline process shares: ids, score rows, messages, frames, file times, telemetry; with
//! the feature `fleet` also object stores, queues, and what services tell of themselves.

#[cfg(feature = "fleet")]
pub mod backoff;
pub mod file_time;
pub mod frame;
pub mod id;
pub mod message;
#[cfg(feature = "fleet")]
pub mod observe;
#[cfg(feature = "fleet")]
pub mod queue;
pub mod row;
#[cfg(feature = "fleet")]
pub mod store;
pub mod telemetry;
#[cfg(feature = "fleet")]
pub mod trace;
