//! [`ScanStream`]: reads scans from its own position in the ring.

use std::fmt;
use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll};

use futures_core::stream::{FusedStream, Stream};

use crate::driver::Client;
use crate::ring::Cursor;
use crate::{Error, Freshness, Rate, Scan, Window};

/// Scans of a [`Window`] at a [`Rate`], live: a `Stream<Item = Result<Scan, Error>>`.
///
/// The stream keeps only the newest scans: one, or the number that you set as its
/// [depth](crate::stream::StreamBuilder::depth). A slow consumer gets the newest scans, and no
/// backlog. Missed scans show as a gap in [`Scan::sequence`] and in [`missed`](Self::missed).
///
/// Errors are items: the stream continues after one. No scan overwrites the latest error, and you get
/// it in order, before the scans that followed it. You get one error for each change of condition: the
/// first timeout after a scan, `Disconnected` once. When the driver has ended, the stream yields the
/// cause and then `None`; after [`Sensor::close`](crate::Sensor::close) just `None`.
///
/// A clone continues from the same position and shares the polls: one `G` serves all. To start with
/// the next scan instead, use [`resubscribe`](Self::resubscribe). Dropping the last copy stops the
/// polling. A stream keeps its driver alive, even if you drop every [`Sensor`](crate::Sensor).
///
/// Like tokio's own types, it makes a task that always finds a scan yield now and then.
#[derive(Clone)]
#[must_use = "polling stops when the stream is dropped"]
pub struct ScanStream {
    pub(super) cursor: Cursor,
    pub(super) window: Window,
    pub(super) rate: Rate,
    /// Dropped after the cursor.
    pub(super) client: StreamClient,
}

/// Keeps the driver alive, and tells it when the stream is dropped.
#[derive(Clone)]
pub(super) struct StreamClient(pub(super) Client);

impl Drop for StreamClient {
    fn drop(&mut self) {
        self.0.report_dropped_stream();
    }
}

impl ScanStream {
    /// Waits for the next scan or error, or `None` after the end: `StreamExt::next` without an import.
    ///
    /// Cancel-safe: you lose no item by dropping this future.
    pub async fn next(&mut self) -> Option<Result<Scan, Error>> {
        poll_fn(|cx| self.cursor.poll_next(cx)).await
    }

    /// Newest scan, read or not, or `None` before the first. Reads nothing: [`next`](Self::next)
    /// still yields a scan that you have not read. The newest scan may be old: check when
    /// it was [received](Scan::received_at), or [`freshness`](Self::freshness).
    pub fn latest(&self) -> Option<Scan> {
        self.cursor.latest()
    }

    /// When the newest scan arrived, and why there is no newer one.
    pub fn freshness(&self) -> Freshness {
        let (last_scan, error) = self.cursor.freshness();
        // Errors of other streams' polls do not matter here.
        Freshness::new(last_scan, self.client.0.shared.pause_reason().or(error))
    }

    /// Creates a stream of the same scans that starts with the next one, like
    /// [`Sensor::scans`](crate::Sensor::scans), but without waiting for the driver. If no scan has
    /// arrived since the latest error, it starts with that error.
    ///
    /// Use it if you keep one stream only to make others, as in a service that shares the scans
    /// among its clients. A clone would start with everything that the kept stream has not read,
    /// including an old error, and would count overwritten scans as missed.
    pub fn resubscribe(&self) -> Self {
        Self { cursor: self.cursor.resubscribe(), client: self.client.clone(), ..*self }
    }

    /// Polled window.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Rate of the polls.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// Number of scans that this copy missed because its consumer was slow.
    pub fn missed(&self) -> u64 {
        self.cursor.missed()
    }
}

impl fmt::Debug for ScanStream {
    /// Leaves out the kept scans, because there may be many.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { window, rate, .. } = self;
        let mut stream = f.debug_struct("ScanStream");
        stream.field("window", window).field("rate", rate).field("missed", &self.missed());
        stream.finish_non_exhaustive()
    }
}

impl Stream for ScanStream {
    type Item = Result<Scan, Error>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.cursor.poll_next(cx)
    }
}

impl FusedStream for ScanStream {
    fn is_terminated(&self) -> bool {
        self.cursor.is_finished()
    }
}
