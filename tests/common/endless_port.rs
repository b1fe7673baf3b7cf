//! A port that delivers bytes without an end.

use std::io;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::ReadBuf;

use super::test_port::{FarEnd, TestPort};

/// A peer that answers no command and repeats the same bytes without an end.
pub(crate) struct EndlessPort {
    pattern: &'static [u8],
    at: usize,
    /// Limits the rate where it is set; otherwise every read fills its buffer.
    rest: Option<tokio::time::Interval>,
}

impl EndlessPort {
    /// Fills every read.
    pub(crate) fn new(pattern: &'static [u8]) -> TestPort<Self> {
        TestPort(Self { pattern, at: 0, rest: None })
    }

    /// Delivers at most 100 bytes a millisecond.
    pub(crate) fn slow(pattern: &'static [u8]) -> TestPort<Self> {
        let rest = Some(tokio::time::interval(Duration::from_millis(1)));
        TestPort(Self { pattern, at: 0, rest })
    }
}

impl FarEnd for EndlessPort {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let mut room = buffer.remaining();
        if let Some(rest) = &mut self.rest {
            ready!(rest.poll_tick(cx));
            room = room.min(100);
        }
        for _ in 0..room {
            buffer.put_slice(&self.pattern[self.at..=self.at]);
            self.at = (self.at + 1) % self.pattern.len();
        }
        Poll::Ready(Ok(()))
    }
}
