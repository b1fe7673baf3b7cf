//! Connections: how many there may be, how long they may take, and their end.

use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use crate::interrupt::Interrupt;

/// How many connections may be open at a time; others wait to be accepted.
const MAX_CONNECTIONS: usize = 128;
/// How long a connection may be open without a request.
const IDLE: Duration = Duration::from_secs(30);
/// What is taken in of a request's head, and kept of a response that the system
/// does not take yet.
const BUFFER: usize = 16 * 1024;
/// How long to rest after a connection could not be accepted, as when too many
/// files are open.
const REST: Duration = Duration::from_millis(100);

/// Serves until the user stops the program, and then until all connections have
/// ended.
pub(super) async fn serve(listener: TcpListener, router: Router, interrupt: &Interrupt) {
    let service = TowerToHyperService::new(router);
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(IDLE).max_buf_size(BUFFER);
    let mut connections = JoinSet::new();
    loop {
        let stream = tokio::select! {
            _ = interrupt.requested() => break,
            Some(_) = connections.join_next() => continue,
            accepted = listener.accept(), if connections.len() < MAX_CONNECTIONS => {
                match accepted {
                    Ok((stream, _)) => stream,
                    Err(error) => {
                        tracing::warn!(%error, "cannot accept a connection");
                        tokio::time::sleep(REST).await;
                        continue;
                    }
                }
            }
        };
        // A scan is worth a packet of its own at once. Without it, it works.
        let _ = stream.set_nodelay(true);
        let connection = http.serve_connection(TokioIo::new(stream), service.clone());
        let interrupt = interrupt.clone();
        connections.spawn(async move {
            tokio::pin!(connection);
            let outcome = tokio::select! {
                outcome = &mut connection => outcome,
                _ = interrupt.requested() => {
                    // Streams of scans end by themselves.
                    connection.as_mut().graceful_shutdown();
                    connection.await
                }
            };
            if let Err(error) = outcome {
                tracing::debug!(%error, "a connection ended early");
            }
        });
    }
    drop(listener);
    while connections.join_next().await.is_some() {}
}
