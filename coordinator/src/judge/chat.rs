//! One question to an OpenAI-compatible chat endpoint: retried where that may help, bounded in time,
//! calls and tokens.
//!
//! `POST ENDPOINT/chat/completions` with text and `image_url` parts; the answer is
//! `choices[0].message.content`, its cost `usage.total_tokens`. 408, 429, 5xx, a broken connection and a
//! body that is no such answer are tried again after a wait that doubles, or after the `Retry-After` that
//! the server asks for. Every other status is a refusal; after 401 and 403 nothing more is asked. The key is in no message and no log.

use std::sync::Mutex;
use std::time::Duration;

use serde_json::{Value, json};

use super::labels::Verdict;

/// Longest answer that is read, bytes.
const MAX_ANSWER_BYTES: u64 = 1 << 20;
/// Longest wait between attempts; a server that asks for more is not waited for.
const MAX_WAIT_S: f64 = 120.0;
/// Characters of a server's words in a reason.
const SAID_CHARS: usize = 200;

/// Whom to ask, and how.
#[derive(Clone)]
pub struct ChatOptions {
    /// Base address, such as `https://api.openai.com/v1`.
    pub endpoint: String,
    /// The model's name there.
    pub model: String,
    /// The key; none for servers that ask for none.
    pub key: Option<String>,
    /// Sampling temperature; the server's own where it is `None`.
    pub temperature: Option<f64>,
    /// Time for one attempt, seconds.
    pub timeout_s: f64,
    /// Attempts per question, at least 1.
    pub attempts: u32,
    /// Wait after the first failed attempt, seconds; doubled after each further one.
    pub backoff_s: f64,
    /// Attempts in all that may be made.
    pub max_calls: Option<u64>,
    /// Tokens in all after which nothing more is asked.
    pub max_tokens: Option<u64>,
}

impl std::fmt::Debug for ChatOptions {
    /// All but the key.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ChatOptions")
            .field("endpoint", &self.endpoint)
            .field("model", &self.model)
            .finish_non_exhaustive()
    }
}

/// What was asked and what it cost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Spent {
    /// Attempts.
    pub calls: u64,
    /// Tokens, as far as the server told.
    pub tokens: u64,
}

/// A client; questions may come from several threads.
pub(super) struct Chat {
    options: ChatOptions,
    agent: ureq::Agent,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    spent: Spent,
    /// Why the server lets nobody in, once it has said so: no further question would fare better.
    closed: Option<String>,
}

/// An attempt that may be made again.
struct Again {
    why: String,
    /// As the server asked, seconds.
    wait_s: Option<f64>,
}

enum Failed {
    Again(Again),
    For(Verdict),
}

impl Chat {
    pub(super) fn new(options: ChatOptions) -> Self {
        let timeout = Duration::try_from_secs_f64(options.timeout_s).ok();
        let config = ureq::Agent::config_builder()
            .timeout_global(timeout)
            .http_status_as_error(false)
            // A key is for the address that was named.
            .max_redirects(0)
            .max_redirects_will_error(false)
            .user_agent(concat!("plumbline/", env!("CARGO_PKG_VERSION")))
            .build();
        Self {
            agent: config.into(),
            options,
            state: Mutex::default(),
        }
    }

    pub(super) fn spent(&self) -> Spent {
        self.lock().spent
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        // Numbers are whole whoever broke down beside them.
        self.state
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// The model's words; a verdict where there are none.
    pub(super) fn ask(&self, text: &str, pictures: &[String]) -> Result<String, Verdict> {
        let body = self.body(text, pictures);
        let mut last = String::new();
        for attempt in 0..self.options.attempts {
            self.pay()?;
            let again = match self.attempt(&body) {
                Ok(answer) => return Ok(answer),
                Err(Failed::For(verdict)) => return Err(verdict),
                Err(Failed::Again(again)) => again,
            };
            last = again.why;
            if attempt + 1 == self.options.attempts {
                break;
            }
            let doubled = self.options.backoff_s * f64::from(1_u32 << attempt.min(16));
            match again.wait_s {
                Some(wait_s) if wait_s > MAX_WAIT_S => {
                    return Err(Verdict::Failed(self.safe(&format!(
                        "{last}; the server asks to wait {wait_s} s: run again later"
                    ))));
                }
                asked => sleep(asked.unwrap_or(doubled).min(MAX_WAIT_S)),
            }
        }
        let attempts = self.options.attempts;
        Err(Verdict::Failed(
            self.safe(&format!("no answer in {attempts} attempts: {last}")),
        ))
    }

    fn body(&self, text: &str, pictures: &[String]) -> String {
        let pictures = pictures
            .iter()
            .map(|url| json!({"type": "image_url", "image_url": {"url": url}}));
        let content: Vec<Value> = std::iter::once(json!({"type": "text", "text": text}))
            .chain(pictures)
            .collect();
        let mut body = json!({
            "model": self.options.model,
            "messages": [{"role": "user", "content": content}],
        });
        if let (Some(temperature), Some(body)) = (self.options.temperature, body.as_object_mut()) {
            body.insert("temperature".to_owned(), json!(temperature));
        }
        body.to_string()
    }

    /// Counts an attempt, unless a limit is reached or the door is closed.
    fn pay(&self) -> Result<(), Verdict> {
        let mut state = self.lock();
        if let Some(why) = &state.closed {
            return Err(Verdict::Refused(format!("not asked, after {why}")));
        }
        let spent = &mut state.spent;
        let reached = |limit: Option<u64>, used: u64| limit.is_some_and(|limit| used >= limit);
        if reached(self.options.max_calls, spent.calls) {
            let reason = format!("{} calls were made (--max-calls)", spent.calls);
            return Err(Verdict::OverBudget(reason));
        }
        if reached(self.options.max_tokens, spent.tokens) {
            let reason = format!("{} tokens were used (--max-tokens)", spent.tokens);
            return Err(Verdict::OverBudget(reason));
        }
        spent.calls += 1;
        Ok(())
    }

    fn attempt(&self, body: &str) -> Result<String, Failed> {
        let address = format!(
            "{}/chat/completions",
            self.options.endpoint.trim_end_matches('/')
        );
        let again = |why: String| Failed::Again(Again { why, wait_s: None });
        let mut request = self
            .agent
            .post(&address)
            .header("content-type", "application/json");
        if let Some(key) = &self.options.key {
            request = request.header("authorization", format!("Bearer {key}"));
        }
        let mut response = request
            .send(body)
            .map_err(|error| again(error.to_string()))?;
        let status = response.status().as_u16();
        let wait_s = response
            .headers()
            .get("retry-after")
            .and_then(|value| value.to_str().ok()?.trim().parse::<u32>().ok())
            .map(f64::from);
        let text = response
            .body_mut()
            .with_config()
            .limit(MAX_ANSWER_BYTES)
            .read_to_string()
            .map_err(|error| again(error.to_string()))?;
        let said = || self.safe(&text);
        match status {
            200..=299 => {}
            408 | 429 | 500..=599 => {
                return Err(Failed::Again(Again {
                    why: format!("status {status}: {}", said()),
                    wait_s,
                }));
            }
            _ => {
                let reason = format!("status {status}: {}", said());
                if matches!(status, 401 | 403) {
                    self.lock().closed = Some(reason.clone());
                }
                return Err(Failed::For(Verdict::Refused(reason)));
            }
        }
        let answer: Value = serde_json::from_str(&text)
            .map_err(|_| again(format!("the answer is no JSON: {}", said())))?;
        if let Some(tokens) = answer
            .pointer("/usage/total_tokens")
            .and_then(Value::as_u64)
        {
            self.lock().spent.tokens += tokens;
        }
        match answer
            .pointer("/choices/0/message/content")
            .and_then(Value::as_str)
        {
            Some(content) => Ok(content.to_owned()),
            None => Err(again(format!(
                "the answer has no choices[0].message.content: {}",
                said()
            ))),
        }
    }

    /// A server's words, short, on one line and without the key.
    fn safe(&self, text: &str) -> String {
        let text = match self.options.key.as_deref() {
            Some(key) if !key.is_empty() => text.replace(key, "***"),
            _ => text.to_owned(),
        };
        let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
        line.chars()
            .filter(|c| !c.is_control())
            .take(SAID_CHARS)
            .collect()
    }
}

fn sleep(seconds: f64) {
    if let Ok(wait) = Duration::try_from_secs_f64(seconds) {
        std::thread::sleep(wait);
    }
}
