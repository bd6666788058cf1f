//! A stub of an OpenAI-compatible server: answers as a test says, and remembers what it was asked.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// What was asked.
#[derive(Debug, Clone)]
pub struct Asked {
    /// When.
    pub at: Instant,
    /// The request line.
    pub line: String,
    /// The header `authorization`.
    pub authorization: Option<String>,
    /// The body.
    pub body: Value,
}

/// What to answer.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Status.
    pub status: u16,
    /// Further header lines.
    pub headers: String,
    /// Body.
    pub body: String,
    /// Wait before it is sent.
    pub delay: Duration,
}

impl Answer {
    /// A model's words, which cost 10 tokens.
    pub fn says(words: &str) -> Self {
        let body = json!({
            "choices": [{"message": {"role": "assistant", "content": words}}], "usage": {"total_tokens": 10},
        });
        Self::status(200, &body.to_string())
    }

    /// Any status and body.
    pub fn status(status: u16, body: &str) -> Self {
        Self {
            status,
            headers: String::new(),
            body: body.to_owned(),
            delay: Duration::ZERO,
        }
    }

    /// With a header.
    #[must_use]
    pub fn header(mut self, line: &str) -> Self {
        self.headers.push_str(&format!("{line}\r\n"));
        self
    }

    /// Late.
    #[must_use]
    pub fn after(mut self, delay: Duration) -> Self {
        self.delay = delay;
        self
    }
}

/// A running stub; its thread ends with the test's process.
#[derive(Debug)]
pub struct StubChat {
    /// Its base address.
    pub endpoint: String,
    asked: Arc<Mutex<Vec<Asked>>>,
}

impl StubChat {
    /// Starts one; `answer` is called with the number of the request, from 0, and its body.
    pub fn start(answer: impl Fn(usize, &Value) -> Answer + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("its address");
        let asked = Arc::new(Mutex::new(Vec::new()));
        let (log, answer) = (Arc::clone(&asked), Arc::new(answer));
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (log, answer) = (Arc::clone(&log), Arc::clone(&answer));
                std::thread::spawn(move || {
                    // A client that hangs up is what some tests are about.
                    let _hung_up = serve(&stream, &log, &*answer);
                });
            }
        });
        Self {
            endpoint: format!("http://{address}/v1"),
            asked,
        }
    }

    /// All it was asked so far.
    pub fn asked(&self) -> Vec<Asked> {
        self.asked.lock().expect("no panic").clone()
    }
}

fn serve(
    mut stream: &TcpStream,
    log: &Mutex<Vec<Asked>>,
    answer: &(dyn Fn(usize, &Value) -> Answer + Send + Sync),
) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream);
    let mut head = Vec::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        match line.trim_end() {
            "" => break,
            line => head.push(line.to_owned()),
        }
    }
    let header = |name: &str| {
        let lines = head.iter().filter_map(|line| line.split_once(':'));
        let mut values = lines.filter(|(found, _)| found.eq_ignore_ascii_case(name));
        values.next().map(|(_, value)| value.trim().to_owned())
    };
    let length = header("content-length").and_then(|length| length.parse().ok());
    let mut body = vec![0; length.unwrap_or(0)];
    reader.read_exact(&mut body)?;
    let body: Value = serde_json::from_slice(&body).unwrap_or_default();
    let number = {
        let mut log = log.lock().expect("no panic");
        log.push(Asked {
            at: Instant::now(),
            line: head.first().cloned().unwrap_or_default(),
            authorization: header("authorization"),
            body: body.clone(),
        });
        log.len() - 1
    };
    let Answer {
        status,
        headers,
        body,
        delay,
    } = answer(number, &body);
    std::thread::sleep(delay);
    write!(
        stream,
        "HTTP/1.1 {status} Said\r\ncontent-type: application/json\r\ncontent-length: {}\r\nconnection: close\r\n{headers}\r\n{body}",
        body.len()
    )?;
    stream.flush()
}
