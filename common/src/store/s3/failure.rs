//! What a failed call means: whether another attempt may help, and the error it becomes.

use aws_sdk_s3::config::http::HttpResponse;
use aws_sdk_s3::error::{ProvideErrorMetadata, SdkError};

use crate::store::error::{Source, StoreError};

/// One failed attempt.
#[derive(Debug)]
pub(super) enum Failure {
    /// Another attempt may help.
    Passing(Source),
    NotFound,
    Denied(Source),
    Changed,
    /// No attempt will help.
    Final(Source),
}

impl Failure {
    /// The error of `object` after so many attempts.
    pub(super) fn of(self, object: String, attempts: u32) -> StoreError {
        match self {
            Self::Passing(source) => StoreError::Transient {
                object,
                attempts,
                source,
            },
            Self::NotFound => StoreError::NotFound { object },
            Self::Denied(source) => StoreError::Denied { object, source },
            Self::Changed => StoreError::Changed { object },
            Self::Final(source) => StoreError::Unusable { object, source },
        }
    }
}

/// Sorts what the client says by the status and code of the answer.
pub(super) fn from_sdk<E>(error: SdkError<E, HttpResponse>) -> Failure
where
    E: ProvideErrorMetadata + std::error::Error + Send + Sync + 'static,
{
    let status = error.raw_response().map(|answer| answer.status().as_u16());
    let code = error.code().unwrap_or_default().to_owned();
    let source: Source = match (error.message(), status) {
        (Some(message), Some(status)) => format!("{status} {code}: {message}").into(),
        _ => with_causes(&error).into(),
    };
    if code == "NoSuchBucket" {
        return Failure::Final(source);
    }
    match (&error, status) {
        (_, Some(404)) => Failure::NotFound,
        (_, Some(401 | 403)) => match code.as_str() {
            // A clock that is off; the client corrects it on the next attempt.
            "RequestTimeTooSkewed" => Failure::Passing(source),
            _ => Failure::Denied(source),
        },
        // The range begins beyond the end: the object has become shorter.
        (_, Some(412 | 416)) => Failure::Changed,
        (_, Some(408 | 429 | 500..)) => Failure::Passing(source),
        (_, Some(400)) if matches!(code.as_str(), "RequestTimeout" | "SlowDown") => {
            Failure::Passing(source)
        }
        // Never sent, for want of credentials; the client's type for it lies in a crate of its own.
        (SdkError::DispatchFailure(_), _) if source.to_string().contains("credentials") => {
            Failure::Denied(source)
        }
        (SdkError::DispatchFailure(failure), _) if failure.is_user() => Failure::Final(source),
        (
            SdkError::DispatchFailure(_) | SdkError::TimeoutError(_) | SdkError::ResponseError(_),
            _,
        ) => Failure::Passing(source),
        _ => Failure::Final(source),
    }
}

/// The client's own text is only the kind of the failure; the causes are behind it, each of which may hold
/// the next one's text.
fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let told = error.to_string();
        if !text.contains(&told) {
            text = format!("{text}: {told}");
        }
        cause = error.source();
    }
    text
}
