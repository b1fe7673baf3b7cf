//! Connections, with limits on their number and their idle time. A connection serves one
//! request, because an idle connection would hold its buffers.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};
use tokio_io_timeout::TimeoutWriter;

use super::{MAX_CONNECTIONS, Site, routes};

const HEAD_TIMEOUT: Duration = Duration::from_secs(10);
/// A client that takes no byte of its response for this time is disconnected.
const STALL_TIMEOUT: Duration = Duration::from_secs(30);
/// Size of the buffers for the head of a request and for the unsent part of a response.
const BUFFER_BYTES: usize = 16 * 1024;
/// Pause after an error of `accept`, such as too many open files.
const ACCEPT_BACKOFF: Duration = Duration::from_millis(100);

/// Serves `site` until the user stops the program, then waits for all connections to end.
pub(crate) async fn serve(listener: TcpListener, site: Arc<Site>) {
    let mut connections = JoinSet::new();
    // Connections without a request, oldest first, and those that had one since the last `accept`.
    let mut silent: VecDeque<(Arc<AtomicBool>, AbortHandle)> = VecDeque::new();
    loop {
        tokio::select! {
            _ = site.interrupt.requested() => break,
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => {
                    silent.retain(|(has_asked, connection)| {
                        !has_asked.load(Ordering::Relaxed) && !connection.is_finished()
                    });
                    while connections.try_join_next().is_some() {}
                    if connections.len() >= MAX_CONNECTIONS {
                        if let Some((_, oldest)) = silent.pop_front() {
                            oldest.abort();
                        }
                        connections.join_next().await;
                    }
                    let has_asked = Arc::default();
                    let served = serve_one(stream, Arc::clone(&site), Arc::clone(&has_asked));
                    silent.push_back((has_asked, connections.spawn(served)));
                }
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(ACCEPT_BACKOFF).await;
                }
            },
        }
    }
    drop(listener);
    while connections.join_next().await.is_some() {}
}

/// Responds to one request and closes the connection. Sets `has_asked` when the request comes.
async fn serve_one(stream: TcpStream, site: Arc<Site>, has_asked: Arc<AtomicBool>) {
    // Send each scan at once, in its own packet. This is optional: ignore an error.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutWriter::new(stream);
    stream.set_timeout(Some(STALL_TIMEOUT));
    let interrupt = site.interrupt.clone();
    let service = service_fn(move |request| {
        has_asked.store(true, Ordering::Relaxed);
        let response = routes::respond(&site, &request);
        async { Ok::<_, Infallible>(response) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIMEOUT);
    // A client may close its sending side after its request.
    http.max_buf_size(BUFFER_BYTES).keep_alive(false).half_close(true);
    let mut served = Box::pin(http.serve_connection(TokioIo::new(Box::pin(stream)), service));
    let outcome = tokio::select! {
        outcome = &mut served => outcome,
        _ = interrupt.requested() => {
            // `ScansClient` sees the interrupt and ends its own stream.
            served.as_mut().graceful_shutdown();
            served.await
        }
    };
    if let Err(error) = outcome {
        tracing::debug!(%error, "a connection ended early");
    }
}
