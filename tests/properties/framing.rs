//! The framing, compared with a reference that has no chunks.

use bytes::BytesMut;
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_util::codec::Decoder;

use super::script::Script;

/// Longest reply, as the documentation of `Frame` states it.
const MAX_FRAME: usize = 4096;

/// Splits bytes into frames in the plainest way, without regard for speed or memory.
fn reference(mut bytes: &[u8]) -> Vec<Frame> {
    let mut frames = Vec::new();
    loop {
        while let [0, rest @ ..] = bytes {
            bytes = rest;
        }
        let Some(end) = bytes.windows(2).position(|pair| pair == b"\n\n") else { return frames };
        let frame = &bytes[..end];
        frames.push(match frame.len() {
            0..=MAX_FRAME => Frame::Reply(frame.into()),
            bytes => Frame::Overlong { bytes },
        });
        bytes = &bytes[end + 2..];
    }
}

/// Any bytes in any chunks make the frames of the reference, and at most one frame is
/// ever buffered.
pub(crate) fn chunks_make_no_difference(script: &[u8]) {
    let mut script = Script::new(script);
    let (mut codec, mut buffer) = (ScipCodec::default(), BytesMut::new());
    let (mut bytes, mut frames) = (Vec::new(), Vec::new());
    while !script.is_over() {
        let piece = match script.byte() {
            0 => b"\n".to_vec(),
            1 => b"\n\n".to_vec(),
            2 => vec![0],
            3 => vec![b'x'; script.below(3 * MAX_FRAME)],
            4 => vec![b'x'; MAX_FRAME - 2 + script.below(5)],
            length => script.take(usize::from(length) % 64).to_vec(),
        };
        let chunk = 1 + script.below(piece.len() + 1).max(piece.len() / 8);
        for chunk in piece.chunks(chunk) {
            buffer.extend_from_slice(chunk);
            while let Some(frame) = codec.decode(&mut buffer).unwrap() {
                frames.push(frame);
            }
            assert!(buffer.len() <= MAX_FRAME + 1);
        }
        bytes.extend_from_slice(&piece);
    }
    assert_eq!(frames, reference(&bytes));
}
