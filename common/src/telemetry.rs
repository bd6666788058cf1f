//! Logs on standard error, as one subscriber set up by `main`.

use tracing_subscriber::EnvFilter;

/// Sends logs at or above `level` (a tracing directive such as `warn` or `plumbline=debug`) to
/// standard error. A second call does nothing.
pub fn init(level: &str) {
    // The AMQP client warns with the whole body of a message that no queue takes, which is told anyway.
    let filter = EnvFilter::try_new(format!("lapin=error,{level}"))
        .unwrap_or_else(|_| EnvFilter::new("warn"));
    let _already_set = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .try_init();
}
