//! Objects in a bucket of any S3-compatible service.
//!
//! Path-style addresses, and checksums only where the protocol requires them: other services refuse or
//! mishandle the rest. Every call is bounded in time and tried again by one policy, [`S3Options::backoff`];
//! the client's own retries are off, since they do not cover the body of an answer. Credentials, region
//! and endpoint come from the vendor's chain (environment, profile, instance) unless given.

use std::future::Future;
use std::ops::Range;
use std::path::Path;
use std::time::Duration;

use async_trait::async_trait;
use aws_config::BehaviorVersion;
use aws_config::retry::RetryConfig;
use aws_config::stalled_stream_protection::StalledStreamProtectionConfig;
use aws_config::timeout::TimeoutConfig;
use aws_sdk_s3::Client;
use aws_sdk_s3::config::{Region, RequestChecksumCalculation, ResponseChecksumValidation};
use aws_sdk_s3::operation::get_object::GetObjectOutput;
use aws_sdk_s3::primitives::{ByteStream, DateTime};
use aws_smithy_http_client::tls;
use bytes::Bytes;
use futures_util::stream::{self, BoxStream, StreamExt};

use super::error::StoreError;
use super::{ObjectKey, ObjectMeta, ObjectStore, PAGE_OBJECTS};
use crate::backoff::Backoff;

mod failure;
mod upload;

use failure::{Failure, from_sdk};

/// Region where the chain knows none: services other than the vendor's mostly take any.
const DEFAULT_REGION: &str = "us-east-1";

/// How long a body may stand still before the attempt is given up.
const STALL_GRACE: Duration = Duration::from_secs(10);

/// How an S3-compatible service is spoken to.
#[derive(Debug, Clone)]
pub struct S3Options {
    /// Its address, such as `http://127.0.0.1:9000`; `None` for what the environment says, or AWS.
    pub endpoint: Option<String>,
    /// Its region; `None` for what the environment says.
    pub region: Option<String>,
    /// How long a connection may take to come about.
    pub connect_timeout: Duration,
    /// How long one attempt may take until its answer begins; 5 GiB never travel in one.
    pub attempt_timeout: Duration,
    /// Waits between attempts.
    pub backoff: Backoff,
    /// Files above this size are put in parts of it; at least 5 MiB, as S3 requires.
    pub part_bytes: u64,
}

impl Default for S3Options {
    fn default() -> Self {
        Self {
            endpoint: None,
            region: None,
            connect_timeout: Duration::from_secs(5),
            attempt_timeout: Duration::from_secs(60),
            backoff: Backoff {
                first: Duration::from_millis(100),
                longest: Duration::from_secs(10),
                attempts: 8,
            },
            part_bytes: 16 << 20,
        }
    }
}

/// A bucket, or what lies below a prefix of one.
#[derive(Debug, Clone)]
pub struct S3Store {
    client: Client,
    bucket: String,
    /// Empty, or ends with a slash.
    prefix: String,
    backoff: Backoff,
    part_bytes: u64,
}

impl S3Store {
    /// Sets a client up; nothing is asked of the service yet (see [`super::probe()`]).
    ///
    /// # Errors
    /// [`StoreError::Unusable`] where `bucket` is empty.
    pub async fn connect(
        bucket: &str,
        prefix: &str,
        options: &S3Options,
    ) -> Result<Self, StoreError> {
        if bucket.is_empty() {
            return Err(StoreError::Unusable {
                object: format!("s3:///{prefix}"),
                source: "the address names no bucket; write s3://bucket/prefix".into(),
            });
        }
        let http = aws_smithy_http_client::Builder::new()
            .tls_provider(tls::Provider::Rustls(
                tls::rustls_provider::CryptoMode::Ring,
            ))
            .build_https();
        let stalls = StalledStreamProtectionConfig::enabled()
            .grace_period(STALL_GRACE)
            .build();
        let timeouts = TimeoutConfig::builder()
            .connect_timeout(options.connect_timeout)
            .operation_attempt_timeout(options.attempt_timeout)
            .build();
        let mut loader = aws_config::defaults(BehaviorVersion::latest())
            .http_client(http)
            .retry_config(RetryConfig::disabled())
            .timeout_config(timeouts)
            .stalled_stream_protection(stalls);
        if let Some(region) = &options.region {
            loader = loader.region(Region::new(region.clone()));
        }
        if let Some(endpoint) = &options.endpoint {
            loader = loader.endpoint_url(endpoint);
        }
        let shared = loader.load().await;
        let region = shared.region().cloned();
        let config = aws_sdk_s3::config::Builder::from(&shared)
            .region(region.unwrap_or(Region::from_static(DEFAULT_REGION)))
            .force_path_style(true)
            .request_checksum_calculation(RequestChecksumCalculation::WhenRequired)
            .response_checksum_validation(ResponseChecksumValidation::WhenRequired)
            .build();
        let prefix = prefix.trim_end_matches('/');
        Ok(Self {
            client: Client::from_conf(config),
            bucket: bucket.to_owned(),
            prefix: match prefix {
                "" => String::new(),
                prefix => format!("{prefix}/"),
            },
            backoff: options.backoff,
            part_bytes: options.part_bytes,
        })
    }

    fn full_key(&self, key: &ObjectKey) -> String {
        format!("{}{key}", self.prefix)
    }

    fn address_of(&self, name: &str) -> String {
        format!("s3://{}/{}{name}", self.bucket, self.prefix)
    }

    /// Tries `attempt` until it succeeds, fails for good, or has been tried often enough.
    async fn retried<T, F>(
        &self,
        name: &str,
        mut attempt: impl FnMut() -> F,
    ) -> Result<T, StoreError>
    where
        F: Future<Output = Result<T, Failure>>,
    {
        let mut attempts = 1;
        loop {
            let failure = match attempt().await {
                Ok(answer) => return Ok(answer),
                Err(failure) => failure,
            };
            let again = self.backoff.after_with_jitter(attempts);
            match (failure, again) {
                (Failure::Passing(source), Some(wait)) => {
                    tracing::debug!(object = self.address_of(name), attempts, %source, "trying again");
                    tokio::time::sleep(wait).await;
                    attempts += 1;
                }
                (failure, _) => return Err(failure.of(self.address_of(name), attempts)),
            }
        }
    }

    async fn list_page(
        &self,
        prefix: &str,
        continuation: Option<&str>,
    ) -> Result<(Vec<ObjectMeta>, Option<String>), StoreError> {
        let answer = self
            .retried(prefix, || async {
                self.client
                    .list_objects_v2()
                    .bucket(&self.bucket)
                    .prefix(format!("{}{prefix}", self.prefix))
                    .max_keys(PAGE_OBJECTS as i32)
                    .set_continuation_token(continuation.map(str::to_owned))
                    .send()
                    .await
                    .map_err(from_sdk)
            })
            .await?;
        let mut objects = Vec::new();
        for object in answer.contents() {
            let Some(key) = object.key().and_then(|key| key.strip_prefix(&self.prefix)) else {
                continue;
            };
            // The object that makes consoles show the prefix as a folder.
            if key.is_empty() {
                continue;
            }
            objects.push(ObjectMeta {
                key: ObjectKey::new(key)?,
                bytes: unsigned(object.size()),
                etag: object.e_tag().map(str::to_owned),
                modified_s: object.last_modified().map(DateTime::secs),
            });
        }
        let more = answer.is_truncated().unwrap_or(false);
        Ok((objects, answer.next_continuation_token.filter(|_| more)))
    }

    /// One attempt at a range, its body included.
    async fn try_range(&self, meta: &ObjectMeta, range: &Range<u64>) -> Result<Bytes, Failure> {
        let answer = self
            .client
            .get_object()
            .bucket(&self.bucket)
            .key(self.full_key(&meta.key))
            .range(format!("bytes={}-{}", range.start, range.end - 1))
            .set_if_match(meta.etag.clone())
            .send()
            .await
            .map_err(from_sdk)?;
        // Not every service heeds the condition.
        if !described(&meta.key, &answer).is_some_and(|found| found.is_same_version(meta)) {
            return Err(Failure::Changed);
        }
        let body = answer.body.collect().await;
        let body = body
            .map_err(|source| Failure::Passing(source.into()))?
            .into_bytes();
        let expected = range.end - range.start;
        if body.len() as u64 != expected {
            let short = format!("{} of {expected} bytes came", body.len());
            return Err(Failure::Passing(short.into()));
        }
        Ok(body)
    }
}

#[async_trait]
impl ObjectStore for S3Store {
    fn address(&self, key: &ObjectKey) -> String {
        self.address_of(key.as_str())
    }

    fn list(&self, prefix: &str) -> BoxStream<'static, Result<Vec<ObjectMeta>, StoreError>> {
        enum Next {
            First,
            After(String),
            End,
        }
        let (store, prefix) = (self.clone(), prefix.to_owned());
        stream::unfold(Next::First, move |next| {
            let (store, prefix) = (store.clone(), prefix.clone());
            async move {
                let continuation = match &next {
                    Next::First => None,
                    Next::After(token) => Some(token.as_str()),
                    Next::End => return None,
                };
                Some(match store.list_page(&prefix, continuation).await {
                    Ok((page, Some(token))) => (Ok(page), Next::After(token)),
                    Ok((page, None)) => (Ok(page), Next::End),
                    Err(error) => (Err(error), Next::End),
                })
            }
        })
        .boxed()
    }

    async fn head(&self, key: &ObjectKey) -> Result<ObjectMeta, StoreError> {
        let answer = self
            .retried(key.as_str(), || async {
                self.client
                    .head_object()
                    .bucket(&self.bucket)
                    .key(self.full_key(key))
                    .send()
                    .await
                    .map_err(from_sdk)
            })
            .await?;
        Ok(ObjectMeta {
            key: key.clone(),
            bytes: unsigned(answer.content_length()),
            etag: answer.e_tag().map(str::to_owned),
            modified_s: answer.last_modified().map(DateTime::secs),
        })
    }

    async fn get_range(&self, meta: &ObjectMeta, range: Range<u64>) -> Result<Bytes, StoreError> {
        self.retried(meta.key.as_str(), || self.try_range(meta, &range))
            .await
    }

    async fn put(&self, key: &ObjectKey, content: Bytes) -> Result<(), StoreError> {
        self.retried(key.as_str(), || async {
            self.client
                .put_object()
                .bucket(&self.bucket)
                .key(self.full_key(key))
                .body(ByteStream::from(content.clone()))
                .send()
                .await
                .map_err(from_sdk)
        })
        .await?;
        Ok(())
    }

    async fn put_file(&self, key: &ObjectKey, file: &Path) -> Result<(), StoreError> {
        upload::put_file(self, key, file).await
    }

    async fn delete(&self, key: &ObjectKey) -> Result<(), StoreError> {
        let removed = self
            .retried(key.as_str(), || async {
                self.client
                    .delete_object()
                    .bucket(&self.bucket)
                    .key(self.full_key(key))
                    .send()
                    .await
                    .map_err(from_sdk)
            })
            .await;
        match removed {
            // Some services do not forgive it.
            Ok(_) | Err(StoreError::NotFound { .. }) => Ok(()),
            Err(error) => Err(error),
        }
    }
}

/// What the answer to a ranged read says of the whole object; `None` where it says no size.
fn described(key: &ObjectKey, answer: &GetObjectOutput) -> Option<ObjectMeta> {
    // `bytes 0-99/1234`; a service that ignores ranges sends the whole.
    let bytes = match answer.content_range() {
        Some(range) => range.rsplit_once('/')?.1.parse().ok()?,
        None => unsigned(answer.content_length()),
    };
    Some(ObjectMeta {
        key: key.clone(),
        bytes,
        etag: answer.e_tag().map(str::to_owned),
        modified_s: answer.last_modified().map(DateTime::secs),
    })
}

fn unsigned(bytes: Option<i64>) -> u64 {
    bytes
        .and_then(|bytes| u64::try_from(bytes).ok())
        .unwrap_or(0)
}
