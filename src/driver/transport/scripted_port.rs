//! [`ScriptedPort`]: a port in memory for tests, with a list of the reads that come from it.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, Waker};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::task::coop::poll_proceed;

use crate::BaudRate;
use crate::port::{Port, PortHints};

/// Port that returns these reads, one after the other, and then no bytes. It accepts all
/// writes.
#[derive(Debug, Default)]
pub(crate) struct ScriptedPort {
    pub(crate) reads: VecDeque<Result<Vec<u8>, ErrorKind>>,
    pub(crate) baud_rate: Option<BaudRate>,
    /// True if it can be read only without waiting.
    pub(crate) has_try_read: bool,
    /// True if the device takes no bytes.
    pub(crate) holds_output: bool,
    /// True if it takes part in tokio's budget: without budget, no read returns bytes.
    pub(crate) takes_budget: bool,
    /// Error of all further reads, with a count, in place of waiting.
    pub(crate) refusal: Option<(ErrorKind, Arc<AtomicU64>)>,
}

impl ScriptedPort {
    fn next(&mut self, buffer: &mut ReadBuf<'_>) -> io::Result<()> {
        if self.takes_budget {
            match poll_proceed(&mut Context::from_waker(Waker::noop())) {
                Poll::Ready(budget) => budget.made_progress(),
                Poll::Pending => return Err(ErrorKind::WouldBlock.into()),
            }
        }
        let next = self.reads.pop_front().unwrap_or_else(|| match &self.refusal {
            Some((kind, reads)) => {
                reads.fetch_add(1, Ordering::Relaxed);
                Err(*kind)
            }
            None => Err(ErrorKind::WouldBlock),
        });
        next.map(|bytes| buffer.put_slice(&bytes)).map_err(io::Error::from)
    }
}

impl Port for ScriptedPort {
    fn baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for ScriptedPort {
    fn holds_output(&mut self) -> bool {
        self.holds_output
    }

    fn try_read(&mut self, bytes: &mut [u8]) -> Option<io::Result<usize>> {
        let mut buffer = ReadBuf::new(bytes);
        self.has_try_read.then(|| self.next(&mut buffer).map(|()| buffer.filled().len()))
    }
}

impl AsyncRead for ScriptedPort {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        assert!(!self.has_try_read, "the port is read without waiting");
        match self.next(buffer) {
            Err(error) if error.kind() == ErrorKind::WouldBlock && self.refusal.is_none() => {
                Poll::Pending
            }
            outcome => Poll::Ready(outcome),
        }
    }
}

impl AsyncWrite for ScriptedPort {
    fn poll_write(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        unreachable!("the driver never flushes")
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        unreachable!("the driver never shuts down")
    }
}
