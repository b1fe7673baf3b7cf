//! The clients of `urg serve`: 20 read scans, and half of them come and go.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout_at};

const CLIENTS: u64 = 20;

/// Clients. Dropping them closes their connections.
pub(crate) struct Viewers {
    counters: Arc<Counters>,
    _tasks: JoinSet<()>,
}

#[derive(Default)]
struct Counters {
    scans: AtomicU64,
    missed: AtomicU64,
    opened: AtomicU64,
    ended: AtomicU64,
}

/// Counts of all clients together.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ViewerCounts {
    pub(crate) scans: u64,
    /// Scans between others that did not come.
    pub(crate) missed: u64,
    pub(crate) opened: u64,
    /// Connections that the server ended.
    pub(crate) ended: u64,
}

impl Viewers {
    pub(crate) fn start(server: SocketAddr) -> Self {
        let counters = Arc::new(Counters::default());
        let mut tasks = JoinSet::new();
        for place in 0..CLIENTS {
            tasks.spawn(view(place, server, Arc::clone(&counters)));
        }
        Self { counters, _tasks: tasks }
    }

    pub(crate) fn counts(&self) -> ViewerCounts {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        ViewerCounts {
            scans: count(&self.counters.scans),
            missed: count(&self.counters.missed),
            opened: count(&self.counters.opened),
            ended: count(&self.counters.ended),
        }
    }
}

async fn view(place: u64, server: SocketAddr, counters: Arc<Counters>) {
    for round in 0_u64.. {
        let stays = place < CLIENTS / 2;
        let time = if stays { u64::from(u32::MAX) } else { 1 + (place * 7 + round * 11) % 30 };
        let end = Instant::now() + Duration::from_secs(time);
        counters.opened.fetch_add(1, Ordering::Relaxed);
        let mut lines = BufReader::new(get(server, "/scans").await).lines();
        let mut expected = None;
        loop {
            let line = match timeout_at(end, lines.next_line()).await {
                Ok(line) => line.ok().flatten(),
                Err(_) => break,
            };
            let Some(line) = line else {
                counters.ended.fetch_add(1, Ordering::Relaxed);
                break;
            };
            // The lines between belong to HTTP, and events.
            let Some(number) = line.strip_prefix(r#"{"sequence":"#) else { continue };
            let number: u64 = number.split(',').next().unwrap().parse().unwrap();
            let missed =
                expected.map_or(0, |expected| number.checked_sub(expected).expect("in order"));
            expected = Some(number + 1);
            counters.scans.fetch_add(1, Ordering::Relaxed);
            counters.missed.fetch_add(missed, Ordering::Relaxed);
        }
        drop(lines);
        sleep(Duration::from_secs((place + round) % 5)).await;
    }
}

/// Returns the figures of `/metrics`, without labels, as text.
pub(crate) async fn metrics(server: SocketAddr) -> String {
    let mut text = String::new();
    get(server, "/metrics").await.read_to_string(&mut text).await.unwrap();
    text
}

async fn get(server: SocketAddr, path: &str) -> TcpStream {
    let mut stream = TcpStream::connect(server).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    stream
}
