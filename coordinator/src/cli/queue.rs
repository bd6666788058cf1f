//! The options by which a command reaches a fleet.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use plumbline_common::queue::{AmqpBroker, AmqpOptions, Broker};
use plumbline_worker::settings::Settings;
use tokio::time::timeout;

use super::Failure;
use crate::fleet::FleetOptions;
use crate::progress::say;

/// How long a broker may take to answer before a person is told that nothing else happens.
const SILENCE: Duration = Duration::from_secs(3);

/// Where the broker is.
#[derive(Debug, Args)]
pub(super) struct BrokerArgs {
    /// Broker of the fleet, amqp://USER:PASSWORD@HOST:PORT/VHOST or amqps://; without URL the one of
    /// PLUMBLINE_QUEUE__URL or queue.url in plumbline.toml, where other users of the machine cannot see the password
    #[arg(long, value_name = "URL", num_args = 0..=1, default_missing_value = "")]
    queue: Option<String>,
}

/// How a fleet measures a run.
#[derive(Debug, Args)]
pub(super) struct QueueArgs {
    #[command(flatten)]
    broker: BrokerArgs,
    /// Name of the run on the fleet, followed there by a digest of what it measures [default: the digest alone]
    #[arg(long, value_name = "NAME", requires = "queue")]
    run: Option<String>,
    /// Most jobs published and not answered
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..))]
    window: u32,
    /// Publish unanswered jobs again after so long without any answer; longer than every worker's deadline
    #[arg(long, value_name = "SECONDS", default_value_t = 3600, value_parser = clap::value_parser!(u32).range(1..))]
    republish_after: u32,
}

impl BrokerArgs {
    /// Whether a fleet is asked for.
    pub(super) fn is_given(&self) -> bool {
        self.queue.is_some()
    }

    /// Connects to it.
    pub(super) async fn connect(&self) -> Result<Arc<dyn Broker>, Failure> {
        let typed = self.queue.as_deref().filter(|url| !url.is_empty());
        connect(typed, AmqpOptions::default().backoff.attempts).await
    }
}

/// Attempts to reach a broker while a person waits for a word about it: some ten seconds.
const FEW_ATTEMPTS: u32 = 7;

/// Connects for a question about the fleet, which can be asked again.
pub(super) async fn connect_briefly(typed: Option<&str>) -> Result<Arc<dyn Broker>, Failure> {
    connect(typed, FEW_ATTEMPTS).await
}

/// Connects to the broker that was typed, or else to that of the settings.
async fn connect(typed: Option<&str>, attempts: u32) -> Result<Arc<dyn Broker>, Failure> {
    let settings = Settings::load().map_err(Failure::usage)?.queue;
    let Some(url) = typed.or(settings.url.as_deref()) else {
        return Err(Failure::usage(
            "the broker's address is missing: --queue amqp://USER:PASSWORD@HOST:PORT/VHOST, or PLUMBLINE_QUEUE__URL",
        ));
    };
    let mut options = settings.amqp_options();
    options.backoff.attempts = attempts;
    let mut connecting = pin!(AmqpBroker::connect(url, options));
    let broker = match timeout(SILENCE, &mut connecting).await {
        Ok(broker) => broker,
        Err(_elapsed) => {
            let some_time = match attempts {
                ..=FEW_ATTEMPTS => "seconds",
                _ => "minutes",
            };
            say(&format!(
                "the broker does not answer yet; trying for some {some_time}: check that it runs, and its address (--log info says more)"
            ));
            connecting.await
        }
    };
    Ok(Arc::new(broker.map_err(super::queue_failure)?))
}

impl QueueArgs {
    /// Whether a fleet is asked for.
    pub(super) fn is_given(&self) -> bool {
        self.broker.is_given()
    }

    /// Connects to the fleet, if one is asked for.
    pub(super) async fn usable(&self) -> Result<Option<FleetOptions>, Failure> {
        if !self.is_given() {
            return Ok(None);
        }
        Ok(Some(FleetOptions {
            broker: self.broker.connect().await?,
            name: self.run.clone(),
            window: self.window as usize,
            republish_after: Duration::from_secs(self.republish_after.into()),
        }))
    }
}
