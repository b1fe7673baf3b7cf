//! Reads and writes in spite of tokio's budget.

use std::future::{Future, poll_fn};
use std::io;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use bytes::BufMut;
use tokio::io::AsyncReadExt;
use tokio::task::coop::{has_budget_remaining, unconstrained};

use crate::port::Port;

/// Polls `work`, also without tokio's budget: once it is used up, a port that takes part returns
/// `Pending` or `WouldBlock` even if it has bytes. The driver would take a flood for a quiet line,
/// and a reply that is there for a missed deadline.
pub(super) fn promptly<T>(
    cx: &mut Context<'_>,
    mut work: impl FnMut(&mut Context<'_>) -> Poll<T>,
) -> Poll<T> {
    let outcome = work(cx);
    if outcome.is_ready() || has_budget_remaining() {
        return outcome;
    }
    without_budget(cx, &mut work)
}

#[cold]
fn without_budget<T>(
    cx: &mut Context<'_>,
    work: &mut dyn FnMut(&mut Context<'_>) -> Poll<T>,
) -> Poll<T> {
    pin!(unconstrained(poll_fn(work))).poll(cx)
}

/// Reads bytes, or returns `Pending` if the port has none.
pub(super) fn poll_read(
    port: &mut Box<dyn Port>,
    cx: &mut Context<'_>,
    buffer: &mut impl BufMut,
) -> Poll<io::Result<usize>> {
    pin!(port.read_buf(buffer)).poll(cx)
}

/// Reads without waiting, also without tokio's budget. Returns `None` if the port cannot.
pub(super) fn try_read(port: &mut Box<dyn Port>, bytes: &mut [u8]) -> Option<io::Result<usize>> {
    let tried = port.hints()?.try_read(bytes)?;
    match &tried {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock && !has_budget_remaining() => {
            try_read_without_budget(port, bytes)
        }
        _ => Some(tried),
    }
}

#[cold]
fn try_read_without_budget(
    port: &mut Box<dyn Port>,
    bytes: &mut [u8],
) -> Option<io::Result<usize>> {
    let hints = port.hints()?;
    let mut cx = Context::from_waker(Waker::noop());
    match without_budget(&mut cx, &mut |_| Poll::Ready(hints.try_read(bytes))) {
        Poll::Ready(tried) => tried,
        Poll::Pending => None,
    }
}
