//! [`ScipCodec`]: finds where replies end, and writes commands. Which reply is a
//! good one is decided by [`protocol`](crate::protocol).
//!
//! A search for the two LFs of a full scan costs half as much again as decoding it
//! (887 instructions, and 1,609 for all else; `.ci/callgrind`). So the codec
//! remembers the last command: a reply of success to a `G` ends at a place that the
//! command determines, and only a reply that does not end there is searched. There
//! is one kind of frame either way, and one parser for it.

use std::io;

use bytes::{Buf, BufMut, BytesMut};
use tokio_util::codec::{Decoder, Encoder};

use crate::protocol::{Command, Window};

/// The longest reply in bytes, its terminator not counted; the longest that a
/// sensor sends has 1,574.
pub const MAX_FRAME: usize = 4096;
/// The length of a terminator, two LFs.
pub(crate) const TERMINATOR: usize = 2;

/// The bytes between two terminators: in a buffer of their own, as a slice (`&[u8]`), or
/// only their number (`usize`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Frame<B = BytesMut> {
    /// A reply without its terminator. It may be anything:
    /// [`Reply::parse`](crate::protocol::Reply::parse) validates it.
    Reply(B),
    /// More than [`MAX_FRAME`] bytes without a terminator, dropped up to and
    /// with the next one.
    Overlong {
        /// The number of bytes dropped, the terminator not counted.
        bytes: usize,
    },
}

impl<B: AsRef<[u8]>> Frame<B> {
    /// Returns how many bytes the frame had on the wire, its terminator included.
    pub(crate) fn wire_len(&self) -> u64 {
        let length = match self {
            Self::Reply(reply) => reply.as_ref().len(),
            Self::Overlong { bytes } => *bytes,
        };
        (length + TERMINATOR) as u64
    }
}

/// The framing of SCIP 1.1, for [`tokio_util::codec::Framed`]: a reply ends
/// with two LF (C-42-3320-A p. 3), a command with one.
///
/// All input becomes items: only I/O can make this decoder fail, so a `Framed`
/// never ends because of what a sensor sent. NULs in front of a reply, which a
/// line that changes its speed or breaks leaves behind, are skipped.
///
/// After a `G` was encoded, a frame with its echo, status `0` and a terminator
/// exactly where its reply must end is not searched for an earlier terminator;
/// a reply with one inside is malformed, and
/// [`Reply::parse`](crate::protocol::Reply::parse) rejects it.
///
/// Looks at each byte a constant number of times, however the bytes are cut up
/// by reading, and holds at most [`MAX_FRAME`] of them and half a terminator.
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
#[derive(Debug, Clone, Default)]
pub struct ScipCodec {
    /// The number of bytes at the front of the buffer that hold no terminator.
    searched: usize,
    /// The number of bytes of an over-long frame that were dropped already.
    skipped: Option<usize>,
    /// The reply of success to the last command, if that was a `G`.
    expected: Option<ExpectedScan>,
}

/// The beginning and the length of a reply of success to a `G`.
#[derive(Debug, Clone, Copy)]
struct ExpectedScan {
    /// The echo and the status.
    head: [u8; ExpectedScan::HEAD],
    /// The length with the terminator.
    length: usize,
}

impl ExpectedScan {
    const HEAD: usize = 12;

    fn new(window: &Window) -> Self {
        let mut head = *b"         \n0\n";
        for (byte, echo) in head.iter_mut().zip(&*Command::Distances(*window).bytes()) {
            *byte = *echo;
        }
        Self { head, length: window.reply_len() }
    }

    /// Returns the length of the frame if `buffer` begins with the expected
    /// reply, judged by its head and its end.
    fn find(&self, buffer: &[u8]) -> Option<usize> {
        let frame = buffer.get(..self.length)?.strip_suffix(b"\n\n")?;
        (frame.first_chunk() == Some(&self.head)).then_some(frame.len())
    }
}

impl ScipCodec {
    /// Finds the first frame in `buffer` and leaves it there, for a reader that validates a
    /// reply where it lies: [`decode`](Decoder::decode) is this and a buffer for the frame,
    /// which costs a fifth as much as decoding a scan.
    ///
    /// A reply has the returned number of bytes, at the front of `buffer`, and the two LFs
    /// of its terminator behind them. The caller removes both. Bytes that are in no reply
    /// are removed: NULs in front of it, and an over-long frame with its terminator.
    ///
    /// ```
    /// use bytes::{Buf, BytesMut};
    /// use tokio_scip::codec::{Frame, ScipCodec};
    ///
    /// let mut codec = ScipCodec::default();
    /// let mut buffer = BytesMut::from("\0L1\n0\n\nL0");
    /// assert_eq!(codec.find(&mut buffer), Some(Frame::Reply(4)));
    /// assert_eq!(buffer[..4], *b"L1\n0");
    /// buffer.advance(4 + 2);
    /// assert_eq!(codec.find(&mut buffer), None);
    /// assert_eq!(buffer[..], *b"L0");
    /// ```
    pub fn find(&mut self, buffer: &mut BytesMut) -> Option<Frame<usize>> {
        if self.searched == 0 && self.skipped.is_none() && buffer.first() == Some(&0) {
            let nulls = buffer.iter().take_while(|&&byte| byte == 0).count();
            buffer.advance(nulls);
        }
        let Some(length) = self.find_end(buffer) else {
            self.searched = buffer.len();
            // Half a terminator is no part of the frame.
            let half = usize::from(buffer.ends_with(b"\n"));
            if buffer.len() - half > MAX_FRAME || self.skipped.is_some() && buffer.len() > 1 {
                let useless = buffer.len() - 1;
                buffer.advance(useless);
                *self.skipped.get_or_insert(0) += useless;
                self.searched = 1;
            }
            return None;
        };
        self.searched = 0;
        let skipped = self.skipped.take();
        if skipped.is_none() && length <= MAX_FRAME {
            return Some(Frame::Reply(length));
        }
        buffer.advance(length + TERMINATOR);
        Some(Frame::Overlong { bytes: skipped.unwrap_or(0) + length })
    }

    /// Forgets what was searched or skipped, for when the buffer was emptied.
    pub fn reset(&mut self) {
        *self = Self { expected: self.expected, ..Self::default() };
    }

    /// Returns the number of bytes that are missing in `buffer`, if it begins with a reply
    /// of success to the last command, and that was a `G`.
    pub(crate) fn missing(&self, buffer: &[u8]) -> Option<usize> {
        let scan = self.expected.filter(|scan| buffer.first_chunk() == Some(&scan.head))?;
        scan.length.checked_sub(buffer.len()).filter(|missing| *missing > 0)
    }

    /// Returns the length of the first frame in `buffer`, its terminator not
    /// counted, if all of it is there.
    fn find_end(&self, buffer: &[u8]) -> Option<usize> {
        if self.skipped.is_none()
            && let Some(length) = self.expected.as_ref().and_then(|scan| scan.find(buffer))
        {
            return Some(length);
        }
        // The terminator may lie across what was searched and what is new.
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
            // The rest of a reply cannot come after the end of the stream.
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
        self.expected = match command {
            Command::Distances(window) => Some(ExpectedScan::new(window)),
            _ => None,
        };
        Ok(())
    }
}

/// Returns the place of the first two LFs in a row.
fn find_terminator(bytes: &[u8]) -> Option<usize> {
    // Large steps first, then smaller ones to where they stopped.
    let mut at = skip::<128>(bytes, 0);
    at = skip::<16>(bytes, at);
    let pairs = bytes.get(at..)?.windows(2);
    pairs.into_iter().position(|pair| pair == b"\n\n").map(|found| at + found)
}

/// Skips as many whole blocks from `at` as no terminator begins in, and returns
/// the place behind them.
fn skip<const BLOCK: usize>(bytes: &[u8], at: usize) -> usize {
    if bytes.len() - at <= BLOCK {
        // Bytes that come one by one are searched one by one.
        return at;
    }
    let blocks = |from: usize| bytes.get(from..).unwrap_or_default().as_chunks::<BLOCK>().0;
    let free = blocks(at).iter().zip(blocks(at + 1)).take_while(|(first, second)| {
        // Zero where both are LF. Without a branch inside, the compiler emits
        // vector instructions.
        let pairs = first.iter().zip(second.iter());
        pairs.fold(u8::MAX, |least, (a, b)| least.min((a ^ b'\n') | (b ^ b'\n'))) != 0
    });
    at + free.count() * BLOCK
}
