//! Reads in spite of tokio's budget. Once it is used up, a port that takes part returns `Pending` or
//! `WouldBlock` even if it has bytes. The driver would take a flood for a quiet line, and a reply that
//! is there for a missed deadline.

use std::future::{Future, poll_fn};
use std::io;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use bytes::BufMut;
use tokio::io::AsyncReadExt;
use tokio::task::coop::unconstrained;

use crate::port::Port;

/// Reads bytes, or returns `Pending` if the port has none.
pub(super) fn poll_read(
    port: &mut Box<dyn Port>,
    cx: &mut Context<'_>,
    buffer: &mut impl BufMut,
) -> Poll<io::Result<usize>> {
    pin!(unconstrained(port.read_buf(buffer))).poll(cx)
}

/// Reads without waiting. Returns `None` if the port cannot.
pub(super) fn try_read(port: &mut Box<dyn Port>, bytes: &mut [u8]) -> Option<io::Result<usize>> {
    let hints = port.hints()?;
    let read = pin!(unconstrained(poll_fn(|_| Poll::Ready(hints.try_read(bytes)))));
    match read.poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(read) => read,
        Poll::Pending => None,
    }
}
