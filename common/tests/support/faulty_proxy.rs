//! Stands before a server and misbehaves as told: one fault per connection, then honest again.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use tokio::io::{AsyncReadExt, AsyncWriteExt, copy_bidirectional};
use tokio::net::{TcpListener, TcpStream};

/// What happens to one connection.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Fault {
    /// Answered with this status and an S3 error of this code.
    Answer(u16, &'static str),
    /// Closed without an answer.
    Close,
    /// The server's answer ends after so many bytes.
    CutAfter(u64),
    /// The server's answer stands still after so many bytes.
    StallAfter(u64),
}

#[derive(Debug)]
pub(crate) struct FaultyProxy {
    address: SocketAddr,
    faults: Arc<Mutex<VecDeque<Fault>>>,
}

impl FaultyProxy {
    /// Stands before `upstream` (host:port).
    pub(crate) async fn before(upstream: String) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let faults = Arc::new(Mutex::new(VecDeque::new()));
        let to_come = Arc::clone(&faults);
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let fault = to_come.lock().unwrap().pop_front();
                let upstream = upstream.clone();
                tokio::spawn(async move {
                    // A connection that breaks is what this is for.
                    let _broken = serve(client, &upstream, fault).await;
                });
            }
        });
        Self { address, faults }
    }

    pub(crate) fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Of the next connections.
    pub(crate) fn next_faults(&self, faults: &[Fault]) {
        self.faults.lock().unwrap().extend(faults);
    }

    /// Faults that nobody met yet.
    pub(crate) fn left(&self) -> usize {
        self.faults.lock().unwrap().len()
    }
}

/// Relays one connection. An honest one ends after its first answer, too: the next request then meets
/// the next fault.
async fn serve(mut client: TcpStream, upstream: &str, fault: Option<Fault>) -> std::io::Result<()> {
    let request = read_head(&mut client).await?;
    let answer_bytes = match fault {
        None => u64::MAX,
        Some(Fault::Close) => return Ok(()),
        Some(Fault::Answer(status, code)) => {
            let body = format!(
                "<?xml version=\"1.0\"?><Error><Code>{code}</Code><Message>as told</Message></Error>"
            );
            let head = format!(
                "HTTP/1.1 {status} X\r\nconnection: close\r\ncontent-length: {}\r\n\r\n",
                body.len()
            );
            client.write_all((head + &body).as_bytes()).await?;
            return client.shutdown().await;
        }
        Some(Fault::CutAfter(bytes) | Fault::StallAfter(bytes)) => bytes,
    };
    let mut server = TcpStream::connect(upstream).await?;
    let close = "\r\nconnection: close\r\n\r\n";
    server
        .write_all(format!("{}{close}", request.trim_end()).as_bytes())
        .await?;
    if fault.is_none() {
        copy_bidirectional(&mut client, &mut server).await?;
        return Ok(());
    }
    tokio::io::copy(&mut server.take(answer_bytes), &mut client).await?;
    if matches!(fault, Some(Fault::StallAfter(_))) {
        std::future::pending::<()>().await;
    }
    Ok(())
}

/// The request up to its empty line, without `connection` headers of its own.
async fn read_head(client: &mut TcpStream) -> std::io::Result<String> {
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        head.push(client.read_u8().await?);
    }
    Ok(String::from_utf8_lossy(&head).into_owned())
}
