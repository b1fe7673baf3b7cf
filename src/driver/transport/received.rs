//! [`ReceivedFrame`]: a frame where it lies in the input, with its times.

use std::time::SystemTime;

use bytes::{Buf, BytesMut};
use tokio::time::Instant;

use crate::codec::{Frame, TERMINATOR};

/// Times of a command and its reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReplyTimes {
    pub(crate) requested: Instant,
    /// When the first byte was read.
    pub(crate) began: Instant,
    /// When the last byte was read.
    pub(crate) received: Instant,
    /// Wall-clock time when the first byte arrived.
    pub(crate) stamp: SystemTime,
    /// True if the reply comes from a recording: its time tells nothing about the motor.
    pub(crate) is_replayed: bool,
}

/// Frame received after a command. Dropping it removes it from the input.
#[derive(Debug)]
pub(crate) struct ReceivedFrame<'a> {
    pub(super) input: &'a mut BytesMut,
    pub(super) frame: Frame<usize>,
    pub(crate) times: ReplyTimes,
}

impl ReceivedFrame<'_> {
    pub(crate) fn frame(&self) -> Frame<&[u8]> {
        match self.frame {
            Frame::Reply(length) => Frame::Reply(self.input.get(..length).unwrap_or_default()),
            Frame::Overlong { bytes } => Frame::Overlong { bytes },
        }
    }

    /// Number of its bytes on the wire.
    pub(crate) fn wire_len(&self) -> u64 {
        self.frame.wire_len()
    }
}

impl Drop for ReceivedFrame<'_> {
    fn drop(&mut self) {
        let Frame::Reply(length) = self.frame else { return };
        let end = length + TERMINATOR;
        if end < self.input.len() {
            self.input.advance(end);
        } else {
            // Cheaper than `advance`, and the next reply starts at the front of the buffer again.
            self.input.clear();
        }
    }
}
