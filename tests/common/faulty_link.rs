//! [`FaultyLink`]: a wrapper around any stream whose calls fail as scripted.

use std::collections::BTreeSet;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, ready};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use tokio_scip::BaudRate;
use tokio_scip::port::{Port, PortHints};

/// A method of a stream or port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Call {
    /// `poll_read`.
    Read,
    /// `poll_write`.
    Write,
    /// [`Port::poll_set_baud_rate`].
    SetBaudRate,
}

/// Failure of a call on a [`FaultyLink`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LinkFailure {
    /// Returns this error of the operating system, once. `LinkFailure::Errno(5)` is
    /// `EIO` on Linux.
    Errno(i32),
    /// Returns an error of this kind, once.
    Kind(io::ErrorKind),
    /// Returns `Ok(0)`, the end of the stream, now and in every later call. Has no
    /// effect on [`Call::SetBaudRate`].
    End,
    /// Is never ready, now and in every later call. Has no effect on
    /// [`Call::SetBaudRate`].
    Stall,
}

impl LinkFailure {
    fn error(self) -> Option<io::Error> {
        match self {
            Self::Errno(code) => Some(io::Error::from_raw_os_error(code)),
            Self::Kind(kind) => Some(kind.into()),
            Self::End | Self::Stall => None,
        }
    }
}

/// Number of calls on a [`FaultyLink`]. A handle: clones count the same link,
/// also after it was moved or dropped.
#[derive(Debug, Clone, Default)]
pub(crate) struct CallCounter(Arc<CallCounts>);

#[derive(Debug, Default)]
struct CallCounts {
    reads: AtomicU64,
    writes: AtomicU64,
    baud_rate_changes: AtomicU64,
    failures: AtomicU64,
    bytes_read: AtomicU64,
}

impl CallCounter {
    /// Returns the number of reads that returned bytes or the end of the stream.
    pub(crate) fn reads(&self) -> u64 {
        self.0.reads.load(Ordering::Relaxed)
    }

    /// Returns the number of writes that took bytes.
    pub(crate) fn writes(&self) -> u64 {
        self.0.writes.load(Ordering::Relaxed)
    }

    /// Returns the number of changes of the baud rate, failed ones included.
    pub(crate) fn baud_rate_changes(&self) -> u64 {
        self.0.baud_rate_changes.load(Ordering::Relaxed)
    }

    /// Returns the number of calls that failed as scripted.
    pub(crate) fn failures(&self) -> u64 {
        self.0.failures.load(Ordering::Relaxed)
    }

    /// Returns the number of bytes read.
    pub(crate) fn bytes_read(&self) -> u64 {
        self.0.bytes_read.load(Ordering::Relaxed)
    }
}

/// Adds to a counter that only its link changes. An atomic addition would cost more than
/// the rest of a read of one byte.
fn count_up(counter: &AtomicU64, by: u64) {
    counter.store(counter.load(Ordering::Relaxed) + by, Ordering::Relaxed);
}

/// A wrapper around a stream whose calls fail as scripted.
///
/// Nothing is random, and nothing takes time: the same calls have the same results.
/// Around a [`Port`] it is a `Port`. Dropping it drops the inner stream.
#[derive(Debug)]
pub(crate) struct FaultyLink<S> {
    inner: S,
    failures: Vec<(Call, u64, LinkFailure)>,
    longest_read: usize,
    longest_write: usize,
    splits: BTreeSet<u64>,
    counter: CallCounter,
}

impl<S> FaultyLink<S> {
    /// Creates a link that works as `inner` does, until failures are added.
    pub(crate) fn new(inner: S) -> Self {
        Self {
            inner,
            failures: Vec::new(),
            longest_read: usize::MAX,
            longest_write: usize::MAX,
            splits: BTreeSet::new(),
            counter: CallCounter::default(),
        }
    }

    /// Makes a call fail after `after` calls of its kind have succeeded: 0 is the very
    /// first call. A read fails without waiting for bytes.
    #[must_use]
    pub(crate) fn fail(mut self, call: Call, after: u64, failure: LinkFailure) -> Self {
        self.failures.push((call, after, failure));
        self
    }

    /// Limits a read to this many bytes, at least 1.
    #[must_use]
    pub(crate) fn short_reads(mut self, longest: usize) -> Self {
        self.longest_read = longest.max(1);
        self
    }

    /// Limits a write to this many bytes, at least 1.
    #[must_use]
    pub(crate) fn partial_writes(mut self, longest: usize) -> Self {
        self.longest_write = longest.max(1);
        self
    }

    /// Ends a read at each of these places, counted in bytes from the first one ever
    /// read. The next read, which begins there, is `Pending` once.
    #[must_use]
    pub(crate) fn split_reads_at(mut self, places: impl IntoIterator<Item = u64>) -> Self {
        self.splits.extend(places);
        self
    }

    /// Returns a handle to the number of calls.
    pub(crate) fn counter(&self) -> CallCounter {
        self.counter.clone()
    }

    /// Takes the failure of this call, if one is due after `done` calls that succeeded.
    fn take_failure(&mut self, call: Call, done: u64) -> Option<LinkFailure> {
        let is_due = |&(of, after, failure): &(Call, u64, LinkFailure)| {
            let lasting = matches!(failure, LinkFailure::End | LinkFailure::Stall);
            of == call && if lasting { done >= after } else { done == after }
        };
        let place = self.failures.iter().position(is_due)?;
        let (.., failure) = self.failures.get(place).copied()?;
        if failure.error().is_some() {
            self.failures.remove(place);
        }
        self.counter.0.failures.fetch_add(1, Ordering::Relaxed);
        Some(failure)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for FaultyLink<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = &mut *self;
        match this.take_failure(Call::Read, this.counter.reads()) {
            Some(LinkFailure::Stall) => return Poll::Pending,
            Some(LinkFailure::End) => return Poll::Ready(Ok(())),
            Some(failure) => return Poll::Ready(failure.error().map_or(Ok(()), Err)),
            None => {}
        }
        let mut limit = this.longest_read.min(buffer.remaining());
        if !this.splits.is_empty() {
            let place = this.counter.bytes_read();
            if this.splits.remove(&place) {
                context.waker().wake_by_ref();
                return Poll::Pending;
            }
            let next = this.splits.range(place..).next().map(|split| split - place);
            limit = limit.min(next.and_then(|bytes| bytes.try_into().ok()).unwrap_or(limit));
        }
        let mut part = ReadBuf::new(buffer.initialize_unfilled_to(limit));
        ready!(Pin::new(&mut this.inner).poll_read(context, &mut part))?;
        let count = part.filled().len();
        buffer.advance(count);
        let counts = &*this.counter.0;
        count_up(&counts.reads, 1);
        count_up(&counts.bytes_read, count as u64);
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for FaultyLink<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let this = &mut *self;
        match this.take_failure(Call::Write, this.counter.writes()) {
            Some(LinkFailure::Stall) => return Poll::Pending,
            Some(LinkFailure::End) => return Poll::Ready(Ok(0)),
            Some(failure) => return Poll::Ready(failure.error().map_or(Ok(0), Err)),
            None => {}
        }
        let bytes = bytes.get(..bytes.len().min(this.longest_write)).unwrap_or_default();
        let count = ready!(Pin::new(&mut this.inner).poll_write(context, bytes))?;
        count_up(&this.counter.0.writes, 1);
        Poll::Ready(Ok(count))
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(context)
    }
}

impl<S: Port> Port for FaultyLink<S> {
    fn baud_rate(&self) -> Option<BaudRate> {
        self.inner.baud_rate()
    }

    fn poll_set_baud_rate(
        &mut self,
        cx: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        let done = self.counter.0.baud_rate_changes.fetch_add(1, Ordering::Relaxed);
        match self.take_failure(Call::SetBaudRate, done).and_then(LinkFailure::error) {
            Some(error) => Poll::Ready(Err(error)),
            None => self.inner.poll_set_baud_rate(cx, baud_rate),
        }
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

// Without `try_read` and `suspend_wakeups`: each byte has to pass `poll_read`, where faults
// apply.
impl<S: Port> PortHints for FaultyLink<S> {
    fn wall_clock(&mut self) -> Option<SystemTime> {
        self.inner.hints().and_then(|hints| hints.wall_clock())
    }

    fn can_die_silently(&mut self) -> bool {
        self.inner.hints().is_some_and(|hints| hints.can_die_silently())
    }

    fn is_over(&mut self) -> bool {
        self.inner.hints().is_some_and(|hints| hints.is_over())
    }

    fn discard_output(&mut self) {
        if let Some(hints) = self.inner.hints() {
            hints.discard_output();
        }
    }
}
