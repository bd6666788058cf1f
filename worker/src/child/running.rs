//! A living child: how it is started and asked, and what is said of it when it dies.

use std::ffi::OsStr;
use std::ops::ControlFlow;
use std::path::Path;
use std::process::{ExitStatus, Stdio};

use plumbline_common::frame::{self, FrameError, HEADER_BYTES};
use plumbline_common::message::{self, MessageError};
use serde::de::DeserializeOwned;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command};
use tokio::task::JoinHandle;

use super::protocol::Drawn;
use super::{CHILD_ARGUMENT, MEMORY_ARGUMENT};
use crate::explain::Picture;

/// How much of a dying child's standard error is kept for the reason.
const STDERR_TAIL_BYTES: usize = 2048;

/// Whether a variable stays with the parent: its own settings, and what may be a password.
fn is_withheld(name: &OsStr) -> bool {
    let name = name.to_string_lossy();
    let own = ["AWS_", "PLUMBLINE_"];
    let secret = ["KEY", "TOKEN", "SECRET", "PASSWORD"];
    own.iter().any(|start| name.starts_with(start)) || secret.iter().any(|part| name.contains(part))
}

/// How far a drawing came.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Drawing {
    /// Every picture that there is was taken.
    Whole,
    /// Some are missing, for this reason.
    Missing(String),
    /// Whoever took them stopped.
    Stopped,
}

/// One child with its pipes.
#[derive(Debug)]
pub(super) struct Running {
    child: Child,
    stdin: ChildStdin,
    stdout: ChildStdout,
    last_words: JoinHandle<Vec<u8>>,
}

impl Running {
    /// Starts a child of `program`, a Plumbline binary.
    pub(super) fn start(program: &Path, memory_mib: u64) -> std::io::Result<Self> {
        let passed_on = std::env::vars_os().filter(|(name, _)| !is_withheld(name));
        let mut child = Command::new(program)
            // Hostile bytes are decoded there, which need know no password; and a reason holds a panic's
            // message, not its trace.
            .env_clear()
            .envs(passed_on)
            .env("RUST_BACKTRACE", "0")
            // It may not write a file, and ends where it tries: ONNX Runtime keeps a database of its own
            // doings below these, and does without where there is no such directory.
            .env("HOME", "/dev/null")
            .env("XDG_CACHE_HOME", "/dev/null")
            .arg(CHILD_ARGUMENT)
            .arg(MEMORY_ARGUMENT)
            .arg(memory_mib.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            // Ctrl-C goes to the whole foreground group; the parent alone decides what it means.
            .process_group(0)
            .spawn()?;
        let missing = || std::io::Error::other("a pipe is missing");
        let stdin = child.stdin.take().ok_or_else(missing)?;
        let stdout = child.stdout.take().ok_or_else(missing)?;
        let stderr = child.stderr.take().ok_or_else(missing)?;
        Ok(Self {
            child,
            stdin,
            stdout,
            last_words: tokio::spawn(tail_of(stderr)),
        })
    }

    /// One request and its answer.
    pub(super) async fn exchange<T: DeserializeOwned>(
        &mut self,
        request: &[u8],
    ) -> Result<T, ExchangeError> {
        self.send(request).await?;
        self.receive().await
    }

    /// One request and the pictures that answer it.
    pub(super) async fn draw<F: FnMut(Picture) -> ControlFlow<()>>(
        &mut self,
        request: &[u8],
        take: &mut F,
    ) -> Result<Drawing, ExchangeError> {
        self.send(request).await?;
        loop {
            match self.receive().await? {
                // A child that decodes hostile bytes is not taken at its word.
                Drawn::Picture(picture) if !picture.is_whole() => {
                    return Err(FrameError::Torn.into());
                }
                Drawn::Picture(picture) => {
                    if take(picture).is_break() {
                        return Ok(Drawing::Stopped);
                    }
                }
                Drawn::End(None) => return Ok(Drawing::Whole),
                Drawn::End(Some(reason)) => return Ok(Drawing::Missing(reason)),
            }
        }
    }

    async fn send(&mut self, request: &[u8]) -> Result<(), ExchangeError> {
        self.stdin.write_all(&frame::header(request)?).await?;
        self.stdin.write_all(request).await?;
        Ok(self.stdin.flush().await?)
    }

    async fn receive<T: DeserializeOwned>(&mut self) -> Result<T, ExchangeError> {
        let mut header = [0; HEADER_BYTES];
        self.stdout.read_exact(&mut header).await?;
        let mut payload = vec![0; frame::payload_len(&header)?];
        self.stdout.read_exact(&mut payload).await?;
        frame::verify(&header, &payload)?;
        Ok(message::decode(&payload)?)
    }

    /// How the child ended, with its last words.
    pub(super) async fn obituary(mut self, broken: ExchangeError) -> String {
        let _already_dead = self.child.start_kill();
        let ended = match self.child.wait().await {
            Ok(status) => describe(status),
            Err(error) => error.to_string(),
        };
        let tail = self.last_words.await.unwrap_or_default();
        match last_words(&tail) {
            Some(words) => format!("{ended}: {words}"),
            None => format!("{ended}: {broken}"),
        }
    }
}

/// Why a child did not answer.
#[derive(Debug, thiserror::Error)]
pub(super) enum ExchangeError {
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error(transparent)]
    Message(#[from] MessageError),
}

fn describe(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => "no exit code".into(),
    }
}

/// The last line that says something, bounded and printable.
fn last_words(tail: &[u8]) -> Option<String> {
    const MAX_CHARS: usize = 200;
    let text = String::from_utf8_lossy(tail);
    let said = |line: &&str| !line.trim().is_empty() && !line.contains("RUST_BACKTRACE");
    let line = text
        .lines()
        .find(|line| line.contains("panicked") || line.contains("memory allocation"))
        .or_else(|| text.lines().rev().find(said))?;
    Some(
        line.trim()
            .chars()
            .filter(|c| !c.is_control())
            .take(MAX_CHARS)
            .collect(),
    )
}

/// Drains standard error to its end and keeps the last bytes.
async fn tail_of(mut stderr: ChildStderr) -> Vec<u8> {
    let mut tail = Vec::new();
    let mut chunk = [0; 1024];
    while let Ok(n) = stderr.read(&mut chunk).await {
        if n == 0 {
            break;
        }
        tail.extend_from_slice(&chunk[..n]);
        let surplus = tail.len().saturating_sub(STDERR_TAIL_BYTES);
        tail.drain(..surplus);
    }
    tail
}
