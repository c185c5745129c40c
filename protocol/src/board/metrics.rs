//! `GET /metrics` over plain HTTP, for Prometheus. Off unless an address is given. It tells what the team does, so beyond loopback it
//! belongs behind a firewall: whoever reaches it may read it (and nothing else).

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{ALLOW, CONTENT_TYPE, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde::Deserialize;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use super::Board;
use crate::document::{Document, DocumentError};

/// Connections at once; more wait.
const MAX_CONNECTIONS: usize = 16;
/// Longest that one connection lives: scrapers come again.
const CONNECTION_LIMIT: Duration = Duration::from_secs(30);
/// Time for the request's headers.
const HEADER_LIMIT: Duration = Duration::from_secs(5);
/// OpenMetrics' media type.
const OPEN_METRICS: HeaderValue =
    HeaderValue::from_static("application/openmetrics-text; version=1.0.0; charset=utf-8");

/// `[metrics]` as it stands in the file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawMetrics {
    /// Address of `/metrics`. Default `127.0.0.1:9464` (leader) or `127.0.0.1:9465` (agent): this host alone.
    pub listen: Option<String>,
}

impl RawMetrics {
    /// The address, checked.
    ///
    /// # Errors
    /// A text that is none.
    pub fn checked(&self, document: &Document, default_port: u16) -> Result<SocketAddr, DocumentError> {
        let Some(text) = &self.listen else { return Ok(SocketAddr::from(([127, 0, 0, 1], default_port))) };
        let wanted = "an address and a port, as 127.0.0.1:9464 (this host alone) or 192.168.1.10:9464";
        text.parse().map_err(|_| document.invalid("metrics.listen", format!("{text:?}"), wanted))
    }
}

/// A listener for `/metrics`; port 0 takes a free one.
///
/// # Errors
/// The address is taken, or not this host's.
pub async fn bind(listen: SocketAddr) -> std::io::Result<TcpListener> {
    TcpListener::bind(listen).await
}

/// Serves until it is dropped.
pub async fn serve(listener: TcpListener, board: Board) -> Infallible {
    let room = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        // The semaphore is never closed.
        let permit = room.clone().acquire_owned().await;
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!("metrics: {error}");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let board = board.clone();
        tokio::spawn(async move {
            let _permit = permit;
            let service = service_fn(move |request| answer(board.clone(), request));
            let served = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEADER_LIMIT)
                .keep_alive(false)
                .serve_connection(TokioIo::new(stream), service);
            if let Ok(Err(error)) = tokio::time::timeout(CONNECTION_LIMIT, served).await {
                tracing::debug!("metrics: {error}");
            }
        });
    }
}

async fn answer(board: Board, request: Request<Incoming>) -> Result<Response<Full<Bytes>>, Infallible> {
    let with = |status, text: String| {
        let mut response = Response::new(Full::new(Bytes::from(text)));
        *response.status_mut() = status;
        response
    };
    Ok(match (request.method(), request.uri().path()) {
        (&Method::GET, "/metrics") => {
            let mut response = with(StatusCode::OK, board.text().await);
            response.headers_mut().insert(CONTENT_TYPE, OPEN_METRICS);
            response
        }
        (_, "/metrics") => {
            let mut response = with(StatusCode::METHOD_NOT_ALLOWED, "only GET\n".to_owned());
            response.headers_mut().insert(ALLOW, HeaderValue::from_static("GET"));
            response
        }
        _ => with(StatusCode::NOT_FOUND, "here is /metrics\n".to_owned()),
    })
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpStream;

    use super::*;

    #[tokio::test]
    async fn metrics_are_served_and_nothing_else() {
        let board = Board::default();
        let listener = bind(SocketAddr::from(([127, 0, 0, 1], 0))).await.unwrap();
        let address = listener.local_addr().unwrap();
        let server = tokio::spawn(serve(listener, board.clone()));
        board.beat();
        let ask = async |request: &str| {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(format!("{request} HTTP/1.1\r\nHost: x\r\n\r\n").as_bytes()).await.unwrap();
            let mut text = String::new();
            stream.read_to_string(&mut text).await.unwrap();
            text
        };
        let got = ask("GET /metrics").await;
        assert!(
            got.starts_with("HTTP/1.1 200") && got.contains("openmetrics") && got.contains("pal_pulse_total 1"),
            "{got}"
        );
        assert!(ask("GET /").await.starts_with("HTTP/1.1 404"));
        assert!(ask("POST /metrics").await.starts_with("HTTP/1.1 405"));
        server.abort();
    }

    #[test]
    fn a_wrong_address_is_named() {
        let document = Document::from_text(std::path::Path::new("a.toml"), "[metrics]\nlisten = 'here'\n".to_owned());
        let raw = RawMetrics { listen: Some("here".to_owned()) };
        let error = raw.checked(&document, 1).unwrap_err().to_string();
        assert!(error.contains("a.toml:2") && error.contains("127.0.0.1:9464"), "{error}");
        assert!(RawMetrics { listen: None }.checked(&document, 9464).unwrap().ip().is_loopback());
    }
}
