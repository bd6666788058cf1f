//! A file's modification time as the frozen corpus and the worker compare it.

use std::fs::Metadata;
use std::io;
use std::time::UNIX_EPOCH;

/// Nanoseconds since the epoch; negative before it.
///
/// # Errors
/// Where the platform keeps no modification times.
pub fn modified_ns(metadata: &Metadata) -> io::Result<i128> {
    Ok(match metadata.modified()?.duration_since(UNIX_EPOCH) {
        Ok(after) => after.as_nanos() as i128,
        Err(before) => -(before.duration().as_nanos() as i128),
    })
}
