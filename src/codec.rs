//! [`ScipCodec`]: finds where replies end, and writes commands.
//! [`protocol`](crate::protocol) validates the replies.
//!
//! Searching each scan for its two LFs would take a third longer (`benches/README.md`, item 1). So the
//! codec remembers the last command: it determines where a successful reply to a `G` ends. Only a reply
//! that does not end there is searched. Both ways yield the same kind of frame, for the same parser.

use std::io;

use bytes::{Buf, BufMut, BytesMut};
use tokio_util::codec::{Decoder, Encoder};

use crate::protocol::Command;

/// Longest reply in bytes, without its terminator. A sensor's longest reply has 1,574.
pub(crate) const MAX_FRAME: usize = 4096;
/// Number of bytes that are searched at once.
const BLOCK: usize = 32;
/// Length of a terminator, two LFs.
pub(crate) const TERMINATOR: usize = 2;

/// Bytes `B` between two terminators.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Frame<B = BytesMut> {
    /// Reply without its terminator. It may hold anything:
    /// [`Reply::parse`](crate::protocol::Reply::parse) validates it.
    Reply(B),
    /// More than 4,096 bytes without a terminator, dropped up to and including the next terminator.
    Overlong {
        /// Number of bytes dropped, without the terminator.
        bytes: usize,
    },
}

/// Frame in a buffer: the length of a reply.
impl Frame<usize> {
    /// Number of bytes on the wire, terminator included.
    pub(crate) fn wire_len(&self) -> u64 {
        let (Self::Reply(bytes) | Self::Overlong { bytes }) = self;
        (bytes + TERMINATOR) as u64
    }
}

/// SCIP 1.1 framing for [`tokio_util::codec::Framed`]: a reply ends with two LFs
/// (C-42-3320-A p. 3), a command with one.
///
/// Turns all input into items. Only I/O can fail, so your `Framed` never ends because of
/// what a sensor sent. The decoder skips NULs in front of a reply: a serial line leaves
/// them behind when it changes its speed or breaks.
///
/// After you encode a `G`, the decoder looks for the echo, status `0` and a terminator exactly where
/// the reply must end. It does not search such a frame for an earlier terminator:
/// [`Reply::parse`](crate::protocol::Reply::parse) rejects a reply with one inside.
///
/// Reads can cut the bytes up in any way: the decoder looks at each byte a constant number
/// of times. It holds at most 4,096 bytes and half a terminator.
///
/// ```
/// use bytes::BytesMut;
/// use tokio_scip::codec::{Frame, ScipCodec};
/// use tokio_util::codec::Decoder;
///
/// let mut codec = ScipCodec::default();
/// let mut bytes = BytesMut::from("L1\n0\n");
/// assert_eq!(codec.decode(&mut bytes)?, None);
/// bytes.extend_from_slice(b"\nL0");
/// assert_eq!(codec.decode(&mut bytes)?, Some(Frame::Reply("L1\n0".into())));
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ScipCodec {
    /// Number of bytes at the front of the buffer that are known to hold no terminator.
    searched: usize,
    /// Number of bytes of an over-long frame dropped so far.
    skipped: Option<usize>,
    /// Expected successful reply, if its length is known.
    expected: Option<ExpectedReply>,
    /// Longest frame in bytes, without its terminator.
    max_frame: usize,
}

/// Beginning and length of a successful reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ExpectedReply {
    /// First bytes: of a `G` the echo and the status.
    head: [u8; ExpectedReply::HEAD],
    /// Length including the terminator.
    length: usize,
}

impl ExpectedReply {
    const HEAD: usize = 12;

    /// Expects a scan in reply to `command`, whose bytes are `bytes`. `None` for other commands.
    pub(crate) fn new(command: &Command, bytes: &[u8]) -> Option<Self> {
        let Command::Distances(window) = command else { return None };
        let mut head = *b"         \n0\n";
        for (byte, echo) in head.iter_mut().zip(bytes) {
            *byte = *echo;
        }
        Some(Self { head, length: window.reply_len() })
    }

    /// Length of the frame if `buffer` begins with the expected reply, by its head and its end.
    fn find(&self, buffer: &[u8]) -> Option<usize> {
        let frame = buffer.get(..self.length)?.strip_suffix(b"\n\n")?;
        (frame.first_chunk() == Some(&self.head)).then_some(frame.len())
    }
}

impl Default for ScipCodec {
    fn default() -> Self {
        Self { searched: 0, skipped: None, expected: None, max_frame: MAX_FRAME }
    }
}

impl ScipCodec {
    /// Expects `reply` from now on, if its length is known, and frames of at most `max_frame` bytes.
    pub(crate) fn expect(&mut self, reply: Option<ExpectedReply>, max_frame: usize) {
        (self.expected, self.max_frame) = (reply, max_frame);
    }

    /// Finds the first frame in `buffer` and leaves a reply there, for the driver to validate in place.
    ///
    /// For a reply, returns its length. Remove it and the two LFs behind it. Bytes that belong to
    /// no reply are removed: NULs in front of a reply, and an over-long frame with its terminator.
    pub(crate) fn find(&mut self, buffer: &mut BytesMut) -> Option<Frame<usize>> {
        if self.searched == 0 && self.skipped.is_none() && buffer.first() == Some(&0) {
            let nulls = buffer.iter().take_while(|&&byte| byte == 0).count();
            buffer.advance(nulls);
        }
        let Some(length) = self.find_end(buffer) else {
            self.searched = buffer.len();
            // The first LF of a split terminator does not count towards the frame.
            let half = usize::from(buffer.ends_with(b"\n"));
            if buffer.len() - half > self.max_frame || self.skipped.is_some() && buffer.len() > 1 {
                let useless = buffer.len() - 1;
                buffer.advance(useless);
                *self.skipped.get_or_insert(0) += useless;
                self.searched = 1;
            }
            return None;
        };
        self.searched = 0;
        let skipped = self.skipped.take();
        if skipped.is_none() && length <= self.max_frame {
            return Some(Frame::Reply(length));
        }
        buffer.advance(length + TERMINATOR);
        Some(Frame::Overlong { bytes: skipped.unwrap_or(0) + length })
    }

    /// Forgets all progress. Call it after you empty the buffer.
    pub(crate) fn reset(&mut self) {
        (self.searched, self.skipped) = (0, None);
    }

    /// Number of bytes missing from `buffer`, if it begins with the expected reply.
    pub(crate) fn missing(&self, buffer: &[u8]) -> Option<usize> {
        let reply = self.expected.filter(|reply| buffer.first_chunk() == Some(&reply.head))?;
        reply.length.checked_sub(buffer.len()).filter(|missing| *missing > 0)
    }

    /// Finds the end of the first frame in `buffer`. Returns the length without the
    /// terminator, or `None` if the frame is incomplete.
    fn find_end(&self, buffer: &[u8]) -> Option<usize> {
        if self.skipped.is_none()
            && let Some(length) = self.expected.as_ref().and_then(|reply| reply.find(buffer))
        {
            return Some(length);
        }
        // A terminator may straddle the searched and the new bytes.
        let from = self.searched.saturating_sub(1);
        let found = buffer.get(from..).and_then(find_terminator);
        found.map(|at| from + at)
    }
}

impl Decoder for ScipCodec {
    type Item = Frame;
    type Error = io::Error;

    fn decode(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Frame>> {
        Ok(self.find(buffer).map(|frame| match frame {
            Frame::Reply(length) => {
                let mut reply = buffer.split_to(length + TERMINATOR);
                reply.truncate(length);
                Frame::Reply(reply)
            }
            Frame::Overlong { bytes } => Frame::Overlong { bytes },
        }))
    }

    fn decode_eof(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Frame>> {
        let frame = self.decode(buffer)?;
        if frame.is_none() {
            // No more bytes follow the end of the stream: an incomplete reply stays incomplete.
            buffer.clear();
            self.reset();
        }
        Ok(frame)
    }
}

impl Encoder<&Command> for ScipCodec {
    type Error = io::Error;

    fn encode(&mut self, command: &Command, buffer: &mut BytesMut) -> io::Result<()> {
        let bytes = command.bytes();
        buffer.reserve(bytes.len() + 1);
        buffer.put_slice(&bytes);
        buffer.put_u8(b'\n');
        self.expect(ExpectedReply::new(command, &bytes), MAX_FRAME);
        Ok(())
    }
}

/// Finds the first two LFs in a row.
fn find_terminator(bytes: &[u8]) -> Option<usize> {
    // Whole blocks first, while no terminator begins in them.
    let after = bytes.get(1..).unwrap_or_default().as_chunks::<BLOCK>().0;
    let pairs = bytes.as_chunks::<BLOCK>().0.iter().zip(after);
    let mut at = BLOCK * pairs.take_while(|(first, second)| !has_pair(first, second)).count();
    while bytes.get(at..at + TERMINATOR)? != b"\n\n" {
        at += 1;
    }
    Some(at)
}

/// Returns true if both blocks have an LF at the same place.
fn has_pair(first: &[u8; BLOCK], second: &[u8; BLOCK]) -> bool {
    // Zero where both bytes are LF. Without a branch, the compiler emits vector instructions.
    let pairs = first.iter().zip(second).map(|(a, b)| (a ^ b'\n') | (b ^ b'\n'));
    pairs.fold(u8::MAX, u8::min) == 0
}
