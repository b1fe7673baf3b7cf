//! [`ScipCodec`]: finds where replies end, and writes commands. What a reply
//! says is the business of [`protocol`].

use std::io;

use bytes::{Buf, BufMut, BytesMut};
use tokio_util::codec::{Decoder, Encoder};

use crate::protocol::{self, Command, Window};

/// The longest reply in bytes, its terminator not counted; the longest that a
/// sensor sends has 1,574.
pub const MAX_FRAME: usize = 4096;

/// What came between two terminators.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Frame {
    /// A reply without its terminator. It may be anything: only
    /// [`Reply::parse`](crate::protocol::Reply::parse) tells what it is worth.
    Reply(BytesMut),
    /// More than [`MAX_FRAME`] bytes without a terminator, thrown away up to
    /// and with the next one.
    Overlong {
        /// How many bytes were thrown away, the terminator not counted.
        bytes: usize,
    },
}

/// The framing of SCIP 1.1, for [`tokio_util::codec::Framed`]: a reply ends
/// with two LF (C-42-3320-A p. 3), a command with one.
///
/// Whatever comes is an item: only I/O can make this decoder fail, so a
/// `Framed` never ends because of what a sensor sent. NULs in front of a reply,
/// which a line that changes its speed or breaks leaves behind, are skipped.
///
/// Looks at each byte a constant number of times, however the bytes are cut up
/// by reading, and holds at most [`MAX_FRAME`] of them and half a terminator
/// back.
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
    /// How many bytes of the buffer hold no terminator.
    searched: usize,
    /// How many bytes of an over-long frame are gone already.
    skipped: Option<usize>,
}

impl ScipCodec {
    /// Forgets what it knows of the buffer, for when that was emptied.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Takes the reply to the `G` for `window` off the buffer, if all of it is
    /// there, and its values take the place of `values`: in one pass, which
    /// looks for no terminator, and without a copy.
    ///
    /// True means that [`decode`](Decoder::decode) would have given this very
    /// reply, and [`Reply::parse`](protocol::Reply::parse) a success. False means that it is for them to
    /// tell what is there: the buffer is as it was, and `values` may hold
    /// anything.
    ///
    /// ```
    /// use bytes::BytesMut;
    /// use tokio_scip::Window;
    /// use tokio_scip::codec::ScipCodec;
    ///
    /// let mut buffer = BytesMut::from("G38438501\n0\nCB06\n\nL1");
    /// let (window, mut values) = (Window::new(384..=385)?, Vec::new());
    /// assert!(ScipCodec::default().decode_scan(window, &mut buffer, &mut values));
    /// assert_eq!((&values[..], &buffer[..]), (&[1234, 6][..], &b"L1"[..]));
    /// # Ok::<(), tokio_scip::protocol::WindowError>(())
    /// ```
    pub fn decode_scan(
        &mut self,
        window: Window,
        buffer: &mut BytesMut,
        values: &mut Vec<u16>,
    ) -> bool {
        let length = window.reply_len();
        let frame = buffer.get(..length).and_then(|reply| reply.strip_suffix(b"\n\n"));
        // A right one has no empty line, so no terminator before its end.
        let right = self.skipped.is_none()
            && frame.is_some_and(|frame| protocol::decode_scan(window, frame, values));
        if right {
            buffer.advance(length);
            self.searched = 0;
        }
        right
    }
}

impl Decoder for ScipCodec {
    type Item = Frame;
    type Error = io::Error;

    fn decode(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Frame>> {
        if self.searched == 0 && self.skipped.is_none() {
            let nulls = buffer.iter().take_while(|&&byte| byte == 0).count();
            buffer.advance(nulls);
        }
        // The terminator may lie across what was searched and what is new.
        let from = self.searched.saturating_sub(1);
        let found = buffer.get(from..).and_then(find_terminator);
        let Some(length) = found.map(|at| from + at) else {
            self.searched = buffer.len();
            // Half a terminator is no part of the frame.
            let half = usize::from(buffer.ends_with(b"\n"));
            if buffer.len() - half > MAX_FRAME || self.skipped.is_some() && buffer.len() > 1 {
                let useless = buffer.len() - 1;
                buffer.advance(useless);
                *self.skipped.get_or_insert(0) += useless;
                self.searched = 1;
            }
            return Ok(None);
        };
        let frame = buffer.split_to(length);
        buffer.advance(2);
        self.searched = 0;
        match self.skipped.take() {
            Some(skipped) => Ok(Some(Frame::Overlong { bytes: skipped + length })),
            None if length > MAX_FRAME => Ok(Some(Frame::Overlong { bytes: length })),
            None => Ok(Some(Frame::Reply(frame))),
        }
    }

    fn decode_eof(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Frame>> {
        let frame = self.decode(buffer)?;
        if frame.is_none() {
            // Half a reply is worth nothing once the stream has ended.
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
        Ok(())
    }
}

/// Where the first two LF in a row are.
fn find_terminator(bytes: &[u8]) -> Option<usize> {
    // Large steps first, then smaller ones to where they stopped.
    let mut at = skip::<128>(bytes, 0);
    at = skip::<16>(bytes, at);
    let pairs = bytes.get(at..)?.windows(2);
    pairs.into_iter().position(|pair| pair == b"\n\n").map(|found| at + found)
}

/// Where to look on from `at` after as many whole blocks as no terminator
/// begins in.
fn skip<const BLOCK: usize>(bytes: &[u8], at: usize) -> usize {
    let blocks = |from: usize| bytes.get(from..).unwrap_or_default().as_chunks::<BLOCK>().0;
    let free = blocks(at).iter().zip(blocks(at + 1)).take_while(|(first, second)| {
        // Zero where both are LF. No branch inside: the compiler makes vector
        // instructions of it.
        let pairs = first.iter().zip(second.iter());
        pairs.fold(u8::MAX, |least, (a, b)| least.min((a ^ b'\n') | (b ^ b'\n'))) != 0
    });
    at + free.count() * BLOCK
}
