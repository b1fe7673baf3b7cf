//! Bytes of replies: the sum of each line, texts, and numbers in characters of six bits.

use crate::format::{BLOCK_BYTES, Reply, sextet};

/// Low six bits of the sum of a line's bytes (C-42-03320B p. 9).
fn sum(line: &[u8]) -> u8 {
    sextet(line.iter().map(|&byte| u32::from(byte)).sum())
}

fn with_sum(line: &[u8]) -> Vec<u8> {
    [line, &[sum(line)]].concat()
}

/// Encodes a reply without data.
pub(super) fn status_only(echo: &[u8], status: [u8; 2]) -> Vec<u8> {
    Reply::new(echo, &with_sum(&status)).end()
}

/// Encodes a reply with one line of characters.
pub(super) fn characters(echo: &[u8], line: &[u8]) -> Vec<u8> {
    let mut reply = Reply::new(echo, b"00P");
    reply.line(&with_sum(line));
    reply.end()
}

/// Encodes lines of a key, a colon and a value. The semicolon after them is not in the sum; if
/// `ends_early`, neither is the text from `<-` on.
pub(super) fn texts<L: AsRef<[u8]>>(
    echo: &[u8],
    lines: impl IntoIterator<Item = L>,
    ends_early: bool,
) -> Vec<u8> {
    let mut reply = Reply::new(echo, b"00P");
    for line in lines {
        let line = line.as_ref();
        let arrow = line.windows(2).position(|two| two == b"<-").filter(|_| ends_early);
        let summed = line.get(..arrow.unwrap_or(line.len())).unwrap_or_default();
        reply.line(&[line, b";", &[sum(summed)]].concat());
    }
    reply.end()
}

/// Encodes a scan: its time, and blocks of 64 characters.
pub(super) fn scan(echo: &[u8], status: [u8; 2], time: &[u8], data: &[u8]) -> Vec<u8> {
    let mut reply = Reply::new(echo, &with_sum(&status));
    reply.line(&with_sum(time));
    data.chunks(BLOCK_BYTES).for_each(|block| reply.line(&with_sum(block)));
    reply.end()
}

/// Encodes the low bits of a number in `N` characters, upper bits first (p. 6 to 8).
pub(super) fn number<const N: usize>(number: u64) -> [u8; N] {
    let mut characters = [b'0'; N];
    let mut rest = number;
    for character in characters.iter_mut().rev() {
        *character = sextet(rest as u32);
        rest >>= 6;
    }
    characters
}
