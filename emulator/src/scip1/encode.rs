//! Bytes of replies: a status, lines of text, and distances of two characters.

use crate::reply::{BLOCK_BYTES, Reply, sextet};

/// Encodes a reply without data (p. 3).
pub(crate) fn status_only(echo: &[u8], status: u8) -> Vec<u8> {
    Reply::new(echo, &[status]).end()
}

/// Encodes a reply of text lines, such as the reply to `V` (p. 4).
pub(super) fn lines<'a>(echo: &[u8], lines: impl IntoIterator<Item = &'a [u8]>) -> Vec<u8> {
    let mut reply = Reply::new(echo, b"0");
    lines.into_iter().for_each(|line| reply.line(line));
    reply.end()
}

/// Encodes a reply with distance data: two characters per value, 64 bytes per line (p. 5,
/// 6).
pub(super) fn distances(echo: &[u8], values: &[u32]) -> Vec<u8> {
    let mut data = vec![0; 2 * values.len()];
    for (pair, &value) in data.as_chunks_mut().0.iter_mut().zip(values) {
        *pair = [sextet(value >> 6), sextet(value)];
    }
    lines(echo, data.chunks(BLOCK_BYTES))
}
