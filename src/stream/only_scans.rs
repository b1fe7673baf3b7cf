//! [`OnlyScans`]: a stream without its errors.

use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll};

use futures_core::stream::{FusedStream, Stream};

use super::ScanStream;
use crate::Scan;

impl ScanStream {
    /// Drops the errors, for a consumer that handles them elsewhere
    /// ([`Sensor::state`](crate::Sensor::state), the log). Ends when this stream ends.
    pub fn only_scans(self) -> OnlyScans {
        OnlyScans(self)
    }
}

/// Scans of a [`ScanStream`] without its errors; made by [`ScanStream::only_scans`].
/// Cloning and dropping have the same effects as for a `ScanStream`. Missed scans show as
/// a gap in [`Scan::sequence`].
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
