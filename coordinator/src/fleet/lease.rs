//! One coordinator per run: its lease, taken at the start and held to the end.

use std::sync::Arc;
use std::time::Duration;

use plumbline_common::id::RunId;
use plumbline_common::queue::{Broker, Lease};
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep};

use crate::run::RunError;

/// How long a broker may take to notice that a killed coordinator is gone.
const TAKE_WITHIN: Duration = Duration::from_secs(3);

/// How long it may take to notice that our own connection is gone: two heartbeats and some.
const RETAKE_WITHIN: Duration = Duration::from_secs(60);

const BETWEEN: Duration = Duration::from_millis(500);

/// Takes the lease of a run.
///
/// # Errors
/// [`RunError::RunInUse`] while another coordinator holds it.
pub(super) async fn take(broker: &dyn Broker, run: &RunId) -> Result<Box<dyn Lease>, RunError> {
    let taken = taken_within(broker, run, TAKE_WITHIN).await?;
    taken.ok_or_else(|| RunError::RunInUse { run: run.clone() })
}

/// Holds it until told to release it. A broken connection takes it away; it is then taken again, which is
/// safe: whatever another coordinator did meanwhile, rows count once.
///
/// # Errors
/// [`RunError::LeaseLost`] where another coordinator has it now.
pub(super) async fn hold(
    broker: Arc<dyn Broker>,
    run: RunId,
    mut lease: Box<dyn Lease>,
    mut release: oneshot::Receiver<()>,
) -> Result<(), RunError> {
    loop {
        tokio::select! {
            () = lease.lost() => {}
            _released = &mut release => {
                lease.release().await;
                return Ok(());
            }
        }
        tracing::warn!(%run, "the connection that held the lease is gone; taking the lease again");
        drop(lease);
        lease = taken_within(broker.as_ref(), &run, RETAKE_WITHIN)
            .await?
            .ok_or_else(|| RunError::LeaseLost { run: run.clone() })?;
    }
}

async fn taken_within(
    broker: &dyn Broker,
    run: &RunId,
    within: Duration,
) -> Result<Option<Box<dyn Lease>>, RunError> {
    let started = Instant::now();
    loop {
        let taken = broker.lease(run).await?;
        if taken.is_some() || started.elapsed() >= within {
            return Ok(taken);
        }
        sleep(BETWEEN).await;
    }
}
