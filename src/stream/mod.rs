//! [`ScanStream`]: scans as they come, from a place of its own in the ring.

mod builder;

use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll};

use futures_core::stream::{FusedStream, Stream};

pub use self::builder::StreamBuilder;
use crate::driver::Client;
use crate::ring::Cursor;
use crate::{Error, Freshness, Rate, Scan, Window};

/// Scans of a [`Window`] at a [`Rate`], as they come: a
/// `Stream<Item = Result<Scan, Error>>`.
///
/// The stream keeps the newest scans only: one, or as many as its
/// [depth](StreamBuilder::depth). A slow consumer gets the newest and no backlog. Missed
/// scans show as a gap in [`Scan::sequence`] and in [`missed`](Self::missed).
///
/// An error is an item, and the stream goes on after it. The latest error is kept beside
/// the scans and returned before the first one after it, once for each change of
/// condition (the first timeout after a scan, `Disconnected` once). When the driver has
/// ended for good the stream returns the cause and then `None`; after
/// [`Sensor::close`](crate::Sensor::close) just `None`.
///
/// A clone continues from the same place and shares the polls: one `G` serves all.
/// [`resubscribe`](Self::resubscribe) starts with the next scan instead. Dropping the
/// last copy stops the polling, within a period. A stream keeps its driver alive, also
/// when no [`Sensor`](crate::Sensor) is left.
///
/// Like tokio's own types it takes part in cooperative scheduling: a task that always
/// finds a scan yields now and then.
#[derive(Debug, Clone)]
#[must_use = "polling stops when the stream is dropped"]
pub struct ScanStream {
    cursor: Cursor,
    window: Window,
    rate: Rate,
    /// Keeps the driver alive.
    client: Client,
}

impl ScanStream {
    /// Returns the next scan or error, or `None` after the end. The same as
    /// `StreamExt::next`, so that no import is needed.
    ///
    /// Cancel-safe: dropping this future loses nothing.
    pub async fn next(&mut self) -> Option<Result<Scan, Error>> {
        poll_fn(|cx| self.cursor.poll_next(cx)).await
    }

    /// Returns the next scan or error if there is one, without waiting. `None` means
    /// that nothing new is there, or that the stream has ended, of which
    /// [`is_terminated`](FusedStream::is_terminated) is then true.
    pub fn next_if_ready(&mut self) -> Option<Result<Scan, Error>> {
        self.cursor.next_if_ready()
    }

    /// Returns the newest scan, read or not, or `None` before the first. It stays the
    /// next item if it was not read. It may be old: check its [age](Scan::age), or
    /// [`freshness`](Self::freshness).
    pub fn latest(&self) -> Option<Scan> {
        self.cursor.latest()
    }

    /// Returns the time of the newest scan, and the reason why there is no newer one.
    pub fn freshness(&self) -> Freshness {
        let (last_scan, error) = self.cursor.freshness();
        let error = match error {
            // The driver knows why the link does not come back.
            None | Some(Error::Disconnected { .. }) => {
                self.client.telemetry().freshness().error().cloned().or(error)
            }
            error => error,
        };
        Freshness::new(last_scan, error)
    }

    /// Returns a stream of the same scans that starts with the next one, as
    /// [`Sensor::scans`](crate::Sensor::scans) would, without waiting for the driver.
    /// If no scan has come since the latest error, it starts with that error.
    ///
    /// For a stream that is kept only to make others, as in a service that shares the
    /// scans among its clients: a clone would start with what that stream did not read,
    /// an old error included, and count it as missed.
    pub fn resubscribe(&self) -> Self {
        Self { cursor: self.cursor.resubscribe(), client: self.client.clone(), ..*self }
    }

    /// Returns the scans alone, for a consumer that handles errors elsewhere
    /// ([`Sensor::state`](crate::Sensor::state), the log). Ends when this stream ends.
    pub fn only_scans(self) -> OnlyScans {
        OnlyScans(self)
    }

    /// Returns the window that is polled.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Returns the rate at which it is polled.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// Returns the number of scans that this copy missed because its consumer was slow.
    pub fn missed(&self) -> u64 {
        self.cursor.missed()
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

/// The scans of a [`ScanStream`] without its errors; made by
/// [`ScanStream::only_scans`]. Clones and dropping are the same as there. Missed scans
/// show as a gap in [`Scan::sequence`].
#[derive(Debug, Clone)]
#[must_use = "polling stops when the stream is dropped"]
pub struct OnlyScans(ScanStream);

impl OnlyScans {
    /// Returns the next scan, or `None` after the end. Cancel-safe.
    pub async fn next(&mut self) -> Option<Scan> {
        poll_fn(|cx| Pin::new(&mut *self).poll_next(cx)).await
    }
}

impl Stream for OnlyScans {
    type Item = Scan;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Scan>> {
        loop {
            match self.0.cursor.poll_next(cx) {
                Poll::Ready(Some(Err(_))) => {}
                Poll::Ready(Some(Ok(scan))) => return Poll::Ready(Some(scan)),
                Poll::Ready(None) => return Poll::Ready(None),
                Poll::Pending => return Poll::Pending,
            }
        }
    }
}

impl FusedStream for OnlyScans {
    fn is_terminated(&self) -> bool {
        self.0.is_terminated()
    }
}
