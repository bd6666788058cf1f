//! Logs on standard error, as one subscriber set up by `main`.

use std::io::IsTerminal;
use std::str::FromStr;

use tracing_subscriber::EnvFilter;

/// How a line of the log looks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line, with the spans it is in: for collectors of logs.
    Json,
}

impl FromStr for LogFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "text" => Ok(Self::Text),
            "json" => Ok(Self::Json),
            _ => Err("there are text and json".to_owned()),
        }
    }
}

/// Sends logs at or above `level` (a tracing directive such as `warn` or `plumbline=debug`) to
/// standard error. A second call does nothing.
pub fn init(level: &str, format: LogFormat) {
    // The AMQP client warns with the whole body of a message that no queue takes, and takes the question for a
    // queue that is not there for an error; what matters reaches us as errors, too.
    let filter =
        EnvFilter::try_new(format!("lapin=off,{level}")).unwrap_or_else(|_| EnvFilter::new("warn"));
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    let _already_set = match format {
        LogFormat::Text => subscriber.with_target(false).try_init(),
        LogFormat::Json => subscriber.json().flatten_event(true).try_init(),
    };
}
