//! A door before a server: shut, every connection through it breaks and no new one comes about; on demand it
//! speaks TLS to those who knock.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use rustls::ServerConfig;
use rustls::pki_types::{PrivateKeyDer, PrivatePkcs8KeyDer};
use tokio::io::{AsyncRead, AsyncWrite, copy_bidirectional};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;

pub(crate) struct Gate {
    address: SocketAddr,
    is_open: watch::Sender<bool>,
    tls: Arc<Mutex<Option<TlsAcceptor>>>,
}

impl Gate {
    /// An open one before `server` (`host:port`).
    pub(crate) async fn before(server: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (is_open, opens) = watch::channel(true);
        let tls: Arc<Mutex<Option<TlsAcceptor>>> = Arc::default();
        let (server, acceptor) = (server.to_owned(), Arc::clone(&tls));
        tokio::spawn(async move {
            while let Ok((visitor, _)) = listener.accept().await {
                let (mut opens, server) = (opens.clone(), server.clone());
                let acceptor = acceptor.lock().unwrap().clone();
                tokio::spawn(async move {
                    let passing = async {
                        match acceptor {
                            None => pass(visitor, &server).await,
                            Some(acceptor) => match acceptor.accept(visitor).await {
                                Ok(visitor) => pass(visitor, &server).await,
                                Err(_stranger) => {}
                            },
                        }
                    };
                    tokio::select! {
                        () = passing => {}
                        _ = opens.wait_for(|is_open| !is_open) => {}
                    }
                });
            }
        });
        Self {
            address,
            is_open,
            tls,
        }
    }

    /// The same for TLS only, and the certificate (PEM) of the authority that vouches for `localhost`.
    pub(crate) fn with_tls(self) -> (Self, String) {
        let mut params = CertificateParams::default();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let authority = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
        let key = KeyPair::generate().unwrap();
        let params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
        let certificate = params.signed_by(&key, &authority).unwrap();
        let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.serialize_der()));
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config = ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_no_client_auth()
            .with_single_cert(vec![certificate.der().clone()], key)
            .unwrap();
        *self.tls.lock().unwrap() = Some(TlsAcceptor::from(Arc::new(config)));
        (self, authority.pem())
    }

    pub(crate) fn address(&self) -> String {
        self.address.to_string()
    }

    pub(crate) fn shut(&self) {
        self.is_open.send_replace(false);
    }

    pub(crate) fn open(&self) {
        self.is_open.send_replace(true);
    }
}

async fn pass(mut visitor: impl AsyncRead + AsyncWrite + Unpin, server: &str) {
    if let Ok(mut server) = TcpStream::connect(server).await {
        let _broken = copy_bidirectional(&mut visitor, &mut server).await;
    }
}
