//! A TCP proxy that misbehaves as told, while it runs: what lies between a program and its server at night.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::sleep;

/// Bytes taken at once; also what one delay applies to.
const CHUNK_BYTES: usize = 16 << 10;

/// How bytes travel, on all connections and in both directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// As fast as they come.
    Free,
    /// Every chunk waits so long.
    Delayed(Duration),
    /// So many bytes a second.
    Throttled(u64),
}

/// What happens to a connection that is open now; later ones are not touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Break {
    /// Both sides see it end in good order.
    Close,
    /// Both sides see it reset.
    Reset,
    /// Neither side sees anything: bytes vanish, and so does the news that the other side is gone.
    HalfOpen,
}

/// Stands before a server until dropped. Needs a runtime around it.
#[derive(Debug)]
pub struct Proxy {
    address: SocketAddr,
    pace: watch::Sender<Pace>,
    open: Arc<Connections>,
    listening: tokio::task::JoinHandle<()>,
}

#[derive(Debug, Default)]
struct Connections {
    /// What each was told last.
    fates: Mutex<HashMap<u64, watch::Sender<Option<Break>>>>,
}

impl Proxy {
    /// Stands before `upstream` (host:port), which need not be there yet.
    ///
    /// # Panics
    /// Where no port is free.
    pub async fn before(upstream: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("its address");
        let (pace, paces) = watch::channel(Pace::Free);
        let open = Arc::new(Connections::default());
        let (registry, upstream) = (Arc::clone(&open), upstream.to_owned());
        let listening = tokio::spawn(async move {
            for id in 0.. {
                let Ok((client, _)) = listener.accept().await else {
                    return;
                };
                let (fate, told) = watch::channel(None);
                registry.fates.lock().expect("no panic").insert(id, fate);
                let (upstream, paces) = (upstream.clone(), paces.clone());
                let registry = Arc::clone(&registry);
                tokio::spawn(async move {
                    relay(client, &upstream, paces, told).await;
                    registry.fates.lock().expect("no panic").remove(&id);
                });
            }
        });
        Self {
            address,
            pace,
            open,
            listening,
        }
    }

    /// Where it listens: host and port.
    pub fn address(&self) -> String {
        self.address.to_string()
    }

    /// From now on, for all connections.
    pub fn set_pace(&self, pace: Pace) {
        self.pace.send_replace(pace);
    }

    /// Does this to every connection that is open; how many there were.
    pub fn break_all(&self, how: Break) -> usize {
        let fates = self.open.fates.lock().expect("no panic");
        let mut intact = 0;
        for fate in fates.values().filter(|fate| fate.borrow().is_none()) {
            fate.send_replace(Some(how));
            intact += 1;
        }
        intact
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.listening.abort();
        self.break_all(Break::Close);
    }
}

/// One connection from its beginning to its end.
async fn relay(
    client: TcpStream,
    upstream: &str,
    pace: watch::Receiver<Pace>,
    mut told: watch::Receiver<Option<Break>>,
) {
    // A server that is away refuses: closing says the same.
    let Ok(server) = TcpStream::connect(upstream).await else {
        return;
    };
    for side in [&client, &server] {
        // Small frames are not to wait for each other beyond what the pace says.
        let _only_slower = side.set_nodelay(true);
    }
    let (mut client_read, mut client_write) = client.into_split();
    let (mut server_read, mut server_write) = server.into_split();
    let broken = {
        let there = pump(&mut client_read, &mut server_write, &pace);
        let back = pump(&mut server_read, &mut client_write, &pace);
        let both = async { tokio::join!(there, back) };
        tokio::select! {
            _ended = both => None,
            told = told.wait_for(Option::is_some) => told.ok().and_then(|how| *how),
        }
    };
    match broken {
        None | Some(Break::Close) => {}
        Some(Break::Reset) => {
            for side in [client_write, server_write] {
                // A socket that is gone cannot be reset.
                let _gone = AsRef::<TcpStream>::as_ref(&side).set_zero_linger();
                // Dropped, it would end in good order first.
                side.forget();
            }
        }
        Some(Break::HalfOpen) => {
            tokio::join!(swallow(client_read), swallow(server_read));
        }
    }
}

/// Carries bytes one way until either side ends, and then says so to the other.
async fn pump(from: &mut OwnedReadHalf, to: &mut OwnedWriteHalf, pace: &watch::Receiver<Pace>) {
    let mut chunk = vec![0; CHUNK_BYTES];
    while let Ok(bytes @ 1..) = from.read(&mut chunk).await {
        let pace = *pace.borrow();
        match pace {
            Pace::Free => {}
            Pace::Delayed(wait) => sleep(wait).await,
            Pace::Throttled(bytes_per_s) => {
                sleep(Duration::from_secs_f64(bytes as f64 / bytes_per_s as f64)).await;
            }
        }
        if to.write_all(&chunk[..bytes]).await.is_err() {
            break;
        }
    }
    // The other side may be gone first.
    let _gone = to.shutdown().await;
}

/// Reads to the end and tells nobody.
async fn swallow(mut from: OwnedReadHalf) {
    let mut chunk = vec![0; CHUNK_BYTES];
    while let Ok(1..) = from.read(&mut chunk).await {}
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use tokio::time::timeout;

    use super::*;

    const SHORT: Duration = Duration::from_millis(200);
    const LONG: Duration = Duration::from_secs(20);

    /// A server that sends everything back, and a connection to it through a proxy.
    async fn echo() -> (Proxy, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let upstream = listener.local_addr().unwrap().to_string();
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = listener.accept().await {
                tokio::spawn(async move {
                    let (mut read, mut write) = stream.split();
                    let _broken = tokio::io::copy(&mut read, &mut write).await;
                });
            }
        });
        let proxy = Proxy::before(&upstream).await;
        let mut client = TcpStream::connect(proxy.address()).await.unwrap();
        assert_eq!(say(&mut client).await.unwrap(), *b"hello");
        (proxy, client)
    }

    async fn say(client: &mut TcpStream) -> std::io::Result<[u8; 5]> {
        client.write_all(b"hello").await?;
        let mut heard = [0; 5];
        client.read_exact(&mut heard).await?;
        Ok(heard)
    }

    #[tokio::test]
    async fn a_closed_connection_ends_and_a_reset_one_fails() {
        let (proxy, mut client) = echo().await;
        assert_eq!(proxy.break_all(Break::Close), 1);
        assert_eq!(
            timeout(LONG, client.read(&mut [0])).await.unwrap().unwrap(),
            0
        );

        let mut client = TcpStream::connect(proxy.address()).await.unwrap();
        say(&mut client).await.unwrap();
        proxy.break_all(Break::Reset);
        let error = timeout(LONG, client.read(&mut [0]))
            .await
            .unwrap()
            .unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::ConnectionReset);
    }

    #[tokio::test]
    async fn a_half_open_connection_is_silent_and_a_new_one_works() {
        let (proxy, mut client) = echo().await;
        proxy.break_all(Break::HalfOpen);
        assert!(timeout(SHORT, say(&mut client)).await.is_err());
        let mut next = TcpStream::connect(proxy.address()).await.unwrap();
        assert_eq!(say(&mut next).await.unwrap(), *b"hello");
        assert!(timeout(SHORT, client.read(&mut [0])).await.is_err());
    }

    #[tokio::test]
    async fn paces_slow_it_down_and_end() {
        let (proxy, mut client) = echo().await;
        for pace in [Pace::Delayed(SHORT), Pace::Throttled(25)] {
            proxy.set_pace(pace);
            let started = Instant::now();
            assert_eq!(say(&mut client).await.unwrap(), *b"hello");
            // Both ways; a bound from below, since a busy machine is only slower.
            assert!(started.elapsed() >= 2 * SHORT, "{pace:?}");
        }
        proxy.set_pace(Pace::Free);
        assert_eq!(
            timeout(LONG, say(&mut client)).await.unwrap().unwrap(),
            *b"hello"
        );
    }
}
