//! [`ScanStream`]: scans as they come, from a place of its own in the ring.

use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll};

use futures::stream::{FusedStream, Stream};

use crate::driver::Client;
use crate::ring::Cursor;
use crate::{Error, Rate, Scan, Window};

/// Scans of a [`Window`] at a [`Rate`], as they come: a
/// `Stream<Item = Result<Scan, Error>>`.
///
/// The stream keeps the newest scans only (one, unless the
/// [builder](crate::SensorBuilder::ring_depth) was asked for more): a consumer
/// that is slow gets the newest and no backlog. What it did not get to see
/// shows as a gap in [`Scan::sequence`] and in [`missed`](Self::missed).
///
/// An error is an item, and the stream goes on after it: the latest error waits
/// beside the scans and comes before the first one after it, once for each change of
/// condition (the first timeout after a scan, `Disconnected` once). When the
/// driver has ended for good the stream gives the cause and then `None`; after
/// [`Sensor::close`](crate::Sensor::close) just `None`.
///
/// A clone goes on from the same place and shares the polls: one `G` serves
/// all. Dropping the last copy stops the polling, within a period. A stream
/// keeps its driver alive, also when no [`Sensor`](crate::Sensor) is left.
#[derive(Debug, Clone)]
#[must_use = "polling stops when the stream is dropped"]
pub struct ScanStream {
    cursor: Cursor,
    window: Window,
    rate: Rate,
    /// Keeps the driver alive.
    _client: Client,
}

impl ScanStream {
    pub(crate) fn new(cursor: Cursor, window: Window, rate: Rate, client: Client) -> Self {
        Self { cursor, window, rate, _client: client }
    }

    /// The next scan or error; `None` after the end. The same as `StreamExt`'s,
    /// here so that no import is needed.
    ///
    /// Cancel-safe: dropping this future loses nothing.
    pub async fn next(&mut self) -> Option<Result<Scan, Error>> {
        poll_fn(|cx| self.cursor.poll_next(cx)).await
    }

    /// The scans alone, for those who read of trouble elsewhere
    /// ([`Sensor::state`](crate::Sensor::state), the log). Ends when this
    /// stream ends.
    pub fn only_scans(self) -> OnlyScans {
        OnlyScans(self)
    }

    /// What is polled.
    pub fn window(&self) -> Window {
        self.window
    }

    /// How often it is polled.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// How many scans this copy did not get to see because it was not asked in
    /// time.
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
/// [`ScanStream::only_scans`]. What it says of clones and of dropping holds here,
/// too; what was missed shows as a gap in [`Scan::sequence`].
#[derive(Debug, Clone)]
#[must_use = "polling stops when the stream is dropped"]
pub struct OnlyScans(ScanStream);

impl OnlyScans {
    /// The next scan; `None` after the end. Cancel-safe.
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
