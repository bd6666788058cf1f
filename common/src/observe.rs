//! What a long-lived process tells of itself over HTTP: `/healthz` (it lives), `/readyz` (it does its work;
//! 503 while it cannot), `/metrics` (Prometheus' text format).

use std::convert::Infallible;
use std::fmt::{self, Debug, Formatter};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::Full;
use hyper::body::Incoming;
use hyper::header::CONTENT_TYPE;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use prometheus_client::encoding::text;
use prometheus_client::registry::Registry;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::time::timeout;

/// Connections served at once: a scraper, a prober and a person, with room to spare.
const MAX_CONNECTIONS: usize = 32;

/// How long one may stay: none of the answers takes time, and idle ones must not use up the others' room.
const CONNECTION_TIME: Duration = Duration::from_secs(30);

const PLAIN: &str = "text/plain; charset=utf-8";

/// The media type of what `prometheus_client` writes.
const METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// A question that may be asked from anywhere at any time.
#[derive(Clone)]
pub struct Pulse(Arc<dyn Fn() -> bool + Send + Sync>);

impl Pulse {
    /// Answers by asking `question`.
    pub fn new(question: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(question))
    }

    /// The answer now.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        (self.0)()
    }
}

impl Debug for Pulse {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Pulse").field(&self.is_alive()).finish()
    }
}

/// Answers on `listener` until dropped; `is_ready` says whether the process does its work.
pub async fn serve(listener: TcpListener, registry: Registry, is_ready: Pulse) {
    let registry = Arc::new(registry);
    let room = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok(permit) = Arc::clone(&room).acquire_owned().await else {
            return;
        };
        let stream = match listener.accept().await {
            Ok((stream, _from)) => stream,
            Err(error) => {
                // Out of descriptors, mostly; the next one may fare better.
                tracing::warn!(%error, "a connection was not accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let (registry, is_ready) = (Arc::clone(&registry), is_ready.clone());
        tokio::spawn(async move {
            let service = service_fn(|request: Request<Incoming>| {
                let answer = answer(request.method(), request.uri().path(), &registry, &is_ready);
                async { Ok::<_, Infallible>(answer) }
            });
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .serve_connection(TokioIo::new(stream), service);
            let _ended_or_too_long = timeout(CONNECTION_TIME, connection).await;
            drop(permit);
        });
    }
}

fn answer(
    method: &Method,
    path: &str,
    registry: &Registry,
    is_ready: &Pulse,
) -> Response<Full<Bytes>> {
    let (status, kind, body) = match (method, path) {
        (&Method::GET | &Method::HEAD, "/healthz") => (StatusCode::OK, PLAIN, "ok\n".to_owned()),
        (&Method::GET | &Method::HEAD, "/readyz") => match is_ready.is_alive() {
            true => (StatusCode::OK, PLAIN, "ready\n".to_owned()),
            false => (
                StatusCode::SERVICE_UNAVAILABLE,
                PLAIN,
                "not ready\n".to_owned(),
            ),
        },
        (&Method::GET | &Method::HEAD, "/metrics") => {
            let mut metrics = String::new();
            match text::encode(&mut metrics, registry) {
                Ok(()) => (StatusCode::OK, METRICS, metrics),
                Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, PLAIN, error.to_string()),
            }
        }
        _ => (
            StatusCode::NOT_FOUND,
            PLAIN,
            "there are /healthz, /readyz and /metrics\n".to_owned(),
        ),
    };
    let mut response = Response::new(Full::new(body.into()));
    *response.status_mut() = status;
    response
        .headers_mut()
        .insert(CONTENT_TYPE, hyper::header::HeaderValue::from_static(kind));
    response
}
