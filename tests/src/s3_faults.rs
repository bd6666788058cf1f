//! Stands before an S3-compatible store and answers some requests badly, chosen by a seeded generator.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::sleep;

/// What can happen to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum S3Fault {
    /// 500 without the store being asked.
    Error500,
    /// 503 without the store being asked.
    Error503,
    /// The answer trickles.
    Slow,
    /// The answer ends in its middle.
    Short,
}

impl S3Fault {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Error500, Self::Error503, Self::Slow, Self::Short];

    /// Its name in logs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Error500 => "S3 500",
            Self::Error503 => "S3 503",
            Self::Slow => "S3 slow",
            Self::Short => "S3 short read",
        }
    }
}

/// Longest head of a request: the client's are about one KiB.
const MAX_HEAD_BYTES: usize = 64 << 10;

/// A slow answer comes in so many pieces, so long apart.
const SLOW_PIECES: usize = 8;
const SLOW_WAIT: Duration = Duration::from_millis(60);

/// Stands before a store until dropped. Needs a runtime around it.
#[derive(Debug)]
pub struct S3Faults {
    address: SocketAddr,
    shared: Arc<Shared>,
    listening: tokio::task::JoinHandle<()>,
}

#[derive(Debug)]
struct Shared {
    upstream: String,
    chance: Mutex<Chance>,
    injected: [AtomicU64; S3Fault::ALL.len()],
}

#[derive(Debug)]
struct Chance {
    generator: Pcg64,
    /// Of 1,000 requests, how many meet a fault.
    per_mille: u32,
}

impl S3Faults {
    /// Stands before `endpoint` (`http://host:port`); `per_mille` of the requests meet a fault.
    ///
    /// # Panics
    /// Where no port is free, or `endpoint` is not plain HTTP.
    pub async fn before(endpoint: &str, seed: u64, per_mille: u32) -> Self {
        let upstream = endpoint.strip_prefix("http://").expect("plain HTTP");
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("its address");
        let shared = Arc::new(Shared {
            upstream: upstream.trim_end_matches('/').to_owned(),
            chance: Mutex::new(Chance {
                generator: Pcg64::seed_from_u64(seed),
                per_mille,
            }),
            injected: Default::default(),
        });
        let serving = Arc::clone(&shared);
        let listening = tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let serving = Arc::clone(&serving);
                tokio::spawn(async move {
                    // A connection that breaks is what this is for.
                    let _broken = serving.serve(client).await;
                });
            }
        });
        Self {
            address,
            shared,
            listening,
        }
    }

    /// Its address, as a client wants it.
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// How often each fault was injected.
    pub fn injected(&self) -> Vec<(&'static str, u64)> {
        let counts = S3Fault::ALL.iter().zip(&self.shared.injected);
        counts
            .map(|(fault, count)| (fault.name(), count.load(Ordering::Relaxed)))
            .collect()
    }
}

impl Drop for S3Faults {
    fn drop(&mut self) {
        self.listening.abort();
    }
}

impl Shared {
    fn draw(&self) -> Option<S3Fault> {
        let mut chance = self.chance.lock().expect("no panic");
        let drawn = chance.generator.next_u32() % 1000;
        let which = chance.generator.next_u32() as usize % S3Fault::ALL.len();
        if drawn >= chance.per_mille {
            return None;
        }
        self.injected[which].fetch_add(1, Ordering::Relaxed);
        Some(S3Fault::ALL[which])
    }

    /// One request and its answer. Connections end after it, so that every request is seen.
    async fn serve(&self, mut client: TcpStream) -> std::io::Result<()> {
        let (head, mut body) = read_head(&mut client).await?;
        let body_bytes = content_length(&head);
        let already = body.len();
        body.resize(body_bytes.max(already), 0);
        client.read_exact(&mut body[already..]).await?;
        let fault = self.draw();
        if let Some(fault @ (S3Fault::Error500 | S3Fault::Error503)) = fault {
            return refuse(&mut client, fault).await;
        }
        let mut server = TcpStream::connect(&self.upstream).await?;
        server
            .write_all(format!("{}\r\nconnection: close\r\n\r\n", head.trim_end()).as_bytes())
            .await?;
        server.write_all(&body).await?;
        if fault.is_none() {
            tokio::io::copy(&mut server, &mut client).await?;
            return client.shutdown().await;
        }
        let mut answer = Vec::new();
        server.read_to_end(&mut answer).await?;
        if fault == Some(S3Fault::Short) {
            client.write_all(&answer[..answer.len() / 2]).await?;
            return client.shutdown().await;
        }
        for piece in answer.chunks(answer.len().div_ceil(SLOW_PIECES).max(1)) {
            client.write_all(piece).await?;
            sleep(SLOW_WAIT).await;
        }
        client.shutdown().await
    }
}

async fn refuse(client: &mut TcpStream, fault: S3Fault) -> std::io::Result<()> {
    let (status, code) = match fault {
        S3Fault::Error500 => ("500 Internal Server Error", "InternalError"),
        _ => ("503 Slow Down", "SlowDown"),
    };
    let body = format!(
        "<?xml version=\"1.0\"?><Error><Code>{code}</Code><Message>injected</Message></Error>"
    );
    let head = format!(
        "HTTP/1.1 {status}\r\nconnection: close\r\ncontent-type: application/xml\r\ncontent-length: {}\r\n\r\n",
        body.len()
    );
    client.write_all((head + &body).as_bytes()).await?;
    client.shutdown().await
}

/// The request up to its empty line, and what was read beyond it.
async fn read_head(client: &mut TcpStream) -> std::io::Result<(String, Vec<u8>)> {
    let mut read = Vec::new();
    loop {
        let end = read.windows(4).position(|four| four == b"\r\n\r\n");
        if let Some(end) = end {
            let beyond = read.split_off(end + 4);
            return Ok((String::from_utf8_lossy(&read).into_owned(), beyond));
        }
        if read.len() > MAX_HEAD_BYTES || client.read_buf(&mut read).await? == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
    }
}

fn content_length(head: &str) -> usize {
    let mut lengths = head.lines().filter_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("content-length")
            .then(|| value.trim().parse().ok())?
    });
    lengths.next().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A store of one answer.
    async fn store() -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = listener.accept().await {
                tokio::spawn(async move {
                    let (head, beyond) = read_head(&mut stream).await.unwrap();
                    let mut body = beyond;
                    while body.len() < content_length(&head) {
                        stream.read_buf(&mut body).await.unwrap();
                    }
                    assert!(head.contains("connection: close"));
                    let answer =
                        format!("HTTP/1.1 200 OK\r\ncontent-length: {}\r\n\r\n", body.len());
                    stream.write_all(answer.as_bytes()).await.unwrap();
                    stream.write_all(&body).await.unwrap();
                });
            }
        });
        format!("http://{address}")
    }

    async fn ask(proxy: &S3Faults) -> String {
        let mut stream = TcpStream::connect(proxy.address).await.unwrap();
        let request = b"PUT /b/k HTTP/1.1\r\nhost: x\r\nContent-Length: 10\r\n\r\n0123456789";
        stream.write_all(request).await.unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        answer
    }

    #[tokio::test]
    async fn without_faults_it_is_not_there() {
        let proxy = S3Faults::before(&store().await, 1, 0).await;
        for _ in 0..20 {
            assert!(ask(&proxy).await.ends_with("0123456789"));
        }
        assert!(proxy.injected().iter().all(|(_, count)| *count == 0));
    }

    #[tokio::test]
    async fn every_fault_is_drawn_and_is_what_it_says() {
        let proxy = S3Faults::before(&store().await, 1, 1000).await;
        let (mut refused, mut short, mut slow) = (0, 0, 0);
        for _ in 0..40 {
            let answer = ask(&proxy).await;
            if answer.starts_with("HTTP/1.1 50") {
                refused += 1;
            } else if answer.ends_with("0123456789") {
                slow += 1;
            } else {
                short += 1;
            }
        }
        let injected: std::collections::BTreeMap<_, _> = proxy.injected().into_iter().collect();
        assert_eq!(injected["S3 500"] + injected["S3 503"], refused);
        assert_eq!(
            (injected["S3 slow"], injected["S3 short read"]),
            (slow, short)
        );
        assert!(refused > 0 && short > 0 && slow > 0);
    }
}
