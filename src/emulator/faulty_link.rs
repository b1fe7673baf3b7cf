//! A stream whose calls fail when they are told to, around any other stream.

use std::collections::{BTreeSet, VecDeque};
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, Waker, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::{BaudRate, Port};

/// A kind of call on a stream or port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Call {
    /// `poll_read`.
    Read,
    /// `poll_write`.
    Write,
    /// [`Port::set_baud_rate`].
    SetSpeed,
}

/// How a call fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Failure {
    /// With this error of the operating system, once. `Failure::Errno(5)` is
    /// `EIO` on Linux.
    Errno(i32),
    /// With an error of this kind, once.
    Kind(io::ErrorKind),
    /// With `Ok(0)`, and so does every later one: the end of the stream. A
    /// change of speed goes through.
    End,
    /// It never gets ready, nor does any later one. A change of speed goes
    /// through.
    Stall,
}

impl Failure {
    fn error(self) -> Option<io::Error> {
        match self {
            Self::Errno(code) => Some(io::Error::from_raw_os_error(code)),
            Self::Kind(kind) => Some(kind.into()),
            Self::End | Self::Stall => None,
        }
    }
}

/// What becomes of the bytes that are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Path {
    Through,
    Back,
    ThroughAndBack,
}

/// How often a [`FaultyLink`] was called. A handle: clones count the same link,
/// also after it has been given away or dropped.
#[derive(Debug, Clone, Default)]
pub struct CallCounter(Arc<Tally>);

#[derive(Debug, Default)]
struct Tally {
    reads: AtomicU64,
    writes: AtomicU64,
    flushes: AtomicU64,
    speeds: AtomicU64,
    failures: AtomicU64,
    bytes_read: AtomicU64,
    bytes_written: AtomicU64,
}

impl CallCounter {
    /// Reads that gave bytes or the end of the stream.
    pub fn reads(&self) -> u64 {
        self.0.reads.load(Ordering::Relaxed)
    }

    /// Writes that took bytes.
    pub fn writes(&self) -> u64 {
        self.0.writes.load(Ordering::Relaxed)
    }

    /// Flushes, ready or not.
    pub fn flushes(&self) -> u64 {
        self.0.flushes.load(Ordering::Relaxed)
    }

    /// Changes of speed, failed ones included.
    pub fn baud_rate_changes(&self) -> u64 {
        self.0.speeds.load(Ordering::Relaxed)
    }

    /// Calls that failed because they were told to.
    pub fn failures(&self) -> u64 {
        self.0.failures.load(Ordering::Relaxed)
    }

    /// Bytes that were read.
    pub fn bytes_read(&self) -> u64 {
        self.0.bytes_read.load(Ordering::Relaxed)
    }

    /// Bytes that were written.
    pub fn bytes_written(&self) -> u64 {
        self.0.bytes_written.load(Ordering::Relaxed)
    }
}

/// A stream that fails as scripted, around one that works.
///
/// Nothing is random, and nothing takes time: with the same calls it does the
/// same. Around a [`Port`] it is a `Port`. Dropping it drops the inner stream.
///
/// ```
/// use tokio::io::AsyncReadExt;
/// use tokio_scip::emulator::{Call, Failure, FaultyLink};
///
/// # #[tokio::main(flavor = "current_thread")]
/// # async fn main() {
/// let mut link = FaultyLink::new(&b"V\n0\n"[..]).short_reads(1).fail(Call::Read, 2, Failure::End);
/// let mut read = Vec::new();
/// link.read_to_end(&mut read).await.unwrap();
/// assert_eq!(read, b"V\n");
/// # }
/// ```
#[derive(Debug)]
pub struct FaultyLink<S> {
    inner: S,
    failures: Vec<(Call, u64, Failure)>,
    longest_read: usize,
    longest_write: usize,
    splits: BTreeSet<u64>,
    path: Path,
    returning: VecDeque<u8>,
    reader: Option<Waker>,
    counter: CallCounter,
}

impl<S> FaultyLink<S> {
    /// A link that works, until it is told otherwise.
    pub fn new(inner: S) -> Self {
        Self {
            inner,
            failures: Vec::new(),
            longest_read: usize::MAX,
            longest_write: usize::MAX,
            splits: BTreeSet::new(),
            path: Path::Through,
            returning: VecDeque::new(),
            reader: None,
            counter: CallCounter::default(),
        }
    }

    /// Lets a call fail once `after` calls of its kind have been through: 0 is
    /// the very first. A read fails without waiting for bytes.
    #[must_use]
    pub fn fail(mut self, call: Call, after: u64, failure: Failure) -> Self {
        self.failures.push((call, after, failure));
        self
    }

    /// No read gives more than this many bytes, at least 1.
    #[must_use]
    pub fn short_reads(mut self, longest: usize) -> Self {
        self.longest_read = longest.max(1);
        self
    }

    /// No write takes more than this many bytes, at least 1.
    #[must_use]
    pub fn partial_writes(mut self, longest: usize) -> Self {
        self.longest_write = longest.max(1);
        self
    }

    /// No read goes across these places, counted in bytes from the first one
    /// ever read, and the first read at each is `Pending` once.
    #[must_use]
    pub fn split_reads_at(mut self, places: impl IntoIterator<Item = u64>) -> Self {
        self.splits.extend(places);
        self
    }

    /// What is written comes back and goes nowhere else: a loopback plug.
    #[must_use]
    pub fn loopback(mut self) -> Self {
        self.path = Path::Back;
        self
    }

    /// What is written comes back, before what the other end says: a terminal
    /// with echo, or a two-wire line.
    #[must_use]
    pub fn echo(mut self) -> Self {
        self.path = Path::ThroughAndBack;
        self
    }

    /// How often the link is called, to be looked at from elsewhere.
    pub fn counter(&self) -> CallCounter {
        self.counter.clone()
    }

    /// The failure of this call, if it is to fail.
    fn failure(&mut self, call: Call, done: u64) -> Option<Failure> {
        let due = |&(of, after, failure): &(Call, u64, Failure)| {
            let lasting = matches!(failure, Failure::End | Failure::Stall);
            of == call && if lasting { done >= after } else { done == after }
        };
        let place = self.failures.iter().position(due)?;
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
        let tally = this.counter.0.clone();
        match this.failure(Call::Read, tally.reads.load(Ordering::Relaxed)) {
            Some(Failure::Stall) => return Poll::Pending,
            Some(Failure::End) => return Poll::Ready(Ok(())),
            Some(failure) => return Poll::Ready(failure.error().map_or(Ok(()), Err)),
            None => {}
        }
        let place = tally.bytes_read.load(Ordering::Relaxed);
        if this.splits.remove(&place) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let to_split = this.splits.range(place..).next().map_or(u64::MAX, |split| split - place);
        let limit = this
            .longest_read
            .min(usize::try_from(to_split).unwrap_or(usize::MAX))
            .min(buffer.remaining());

        let count = if this.returning.is_empty() {
            this.reader = Some(context.waker().clone());
            if this.path == Path::Back {
                return Poll::Pending;
            }
            let mut part = ReadBuf::new(buffer.initialize_unfilled_to(limit));
            ready!(Pin::new(&mut this.inner).poll_read(context, &mut part))?;
            let count = part.filled().len();
            buffer.advance(count);
            count
        } else {
            let count = limit.min(this.returning.len());
            let bytes: Vec<u8> = this.returning.drain(..count).collect();
            buffer.put_slice(&bytes);
            count
        };
        tally.reads.fetch_add(1, Ordering::Relaxed);
        tally.bytes_read.fetch_add(count as u64, Ordering::Relaxed);
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
        let tally = this.counter.0.clone();
        match this.failure(Call::Write, tally.writes.load(Ordering::Relaxed)) {
            Some(Failure::Stall) => return Poll::Pending,
            Some(Failure::End) => return Poll::Ready(Ok(0)),
            Some(failure) => return Poll::Ready(failure.error().map_or(Ok(0), Err)),
            None => {}
        }
        let bytes = bytes.get(..bytes.len().min(this.longest_write)).unwrap_or_default();
        let count = match this.path {
            Path::Back => bytes.len(),
            Path::Through | Path::ThroughAndBack => {
                ready!(Pin::new(&mut this.inner).poll_write(context, bytes))?
            }
        };
        if this.path != Path::Through {
            this.returning.extend(bytes.iter().take(count));
            if let Some(reader) = this.reader.take() {
                reader.wake();
            }
        }
        tally.writes.fetch_add(1, Ordering::Relaxed);
        tally.bytes_written.fetch_add(count as u64, Ordering::Relaxed);
        Poll::Ready(Ok(count))
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.counter.0.flushes.fetch_add(1, Ordering::Relaxed);
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

    fn set_baud_rate(&mut self, speed: BaudRate) -> io::Result<()> {
        let done = self.counter.0.speeds.fetch_add(1, Ordering::Relaxed);
        match self.failure(Call::SetSpeed, done).and_then(Failure::error) {
            Some(error) => Err(error),
            None => self.inner.set_baud_rate(speed),
        }
    }

    fn discard_output(&mut self) {
        self.inner.discard_output();
    }
}
