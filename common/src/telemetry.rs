//! Logs on standard error, as one subscriber set up by `main`.

use tracing_subscriber::EnvFilter;

/// Sends logs at or above `level` (a tracing directive such as `warn` or `plumbline=debug`) to
/// standard error. A second call does nothing.
pub fn init(level: &str) {
    let filter = EnvFilter::try_new(level).unwrap_or_else(|_| EnvFilter::new("warn"));
    let _already_set = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .try_init();
}
