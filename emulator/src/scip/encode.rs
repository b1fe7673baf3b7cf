//! Bytes of replies: echo, status, lines, the 6-bit encoding and its blocks.

/// Length of a line of data, except for the last one (C-42-3320-A p. 3).
const BLOCK_BYTES: usize = 64;

/// Encodes a reply without data: echo, status and the terminator (p. 3).
pub(crate) fn status_only(echo: &[u8], status: &[u8]) -> Vec<u8> {
    let mut reply = Vec::with_capacity(echo.len() + status.len() + 3);
    start(&mut reply, echo, status);
    reply.push(b'\n');
    reply
}

/// Encodes a reply of text lines, such as the reply to `V` (p. 4).
pub(super) fn lines<'a>(echo: &[u8], lines: impl IntoIterator<Item = &'a [u8]>) -> Vec<u8> {
    let mut reply = Vec::with_capacity(256);
    start(&mut reply, echo, b"0");
    for line in lines {
        reply.extend_from_slice(line);
        reply.push(b'\n');
    }
    reply.push(b'\n');
    reply
}

/// Encodes a reply with distance data: two characters per value, 64 bytes per line (p. 5,
/// 6).
pub(super) fn distances(echo: &[u8], values: &[u32]) -> Vec<u8> {
    let mut data = vec![0; 2 * values.len()];
    for (pair, &value) in data.as_chunks_mut().0.iter_mut().zip(values) {
        *pair = [sextet(value >> 6), sextet(value)];
    }
    let mut reply =
        Vec::with_capacity(echo.len() + 5 + data.len() + data.len().div_ceil(BLOCK_BYTES));
    start(&mut reply, echo, b"0");
    for block in data.chunks(BLOCK_BYTES) {
        reply.extend_from_slice(block);
        reply.push(b'\n');
    }
    reply.push(b'\n');
    reply
}

/// Encodes a scan as a sensor in SCIP 2 streams it, unsolicited: three characters per
/// point, a time stamp in milliseconds, and a check character after every line.
pub(crate) fn scip2_scan(values: &[u32], milliseconds: u64) -> Vec<u8> {
    let mut reply = Vec::with_capacity(2200);
    start(&mut reply, b"MD0044072501000", b"99b");
    let stamp = [18, 12, 6, 0].map(|shift| sextet((milliseconds >> shift) as u32 & 0x3F));
    checked_line(&mut reply, &stamp);
    let data: Vec<u8> =
        values.iter().flat_map(|&value| [sextet(0), sextet(value >> 6), sextet(value)]).collect();
    for block in data.chunks(BLOCK_BYTES) {
        checked_line(&mut reply, block);
    }
    reply.push(b'\n');
    reply
}

/// Encodes lines of text as a sensor in SCIP 2 does: each ends with `;` and the sum of the rest.
pub(crate) fn scip2_lines<'a>(echo: &[u8], lines: impl Iterator<Item = &'a [u8]>) -> Vec<u8> {
    let mut reply = Vec::new();
    start(&mut reply, echo, b"00P");
    for line in lines.filter(|line| !line.is_empty()) {
        let sum = line.iter().fold(0_u32, |sum, &byte| sum.wrapping_add(u32::from(byte)));
        reply.extend_from_slice(line);
        reply.extend_from_slice(&[b';', sextet(sum), b'\n']);
    }
    reply.push(b'\n');
    reply
}

fn start(reply: &mut Vec<u8>, echo: &[u8], status: &[u8]) {
    reply.extend_from_slice(echo);
    reply.push(b'\n');
    reply.extend_from_slice(status);
    reply.push(b'\n');
}

fn checked_line(reply: &mut Vec<u8>, line: &[u8]) {
    let sum = line.iter().fold(0_u32, |sum, &byte| sum.wrapping_add(u32::from(byte)));
    reply.extend_from_slice(line);
    reply.extend_from_slice(&[sextet(sum), b'\n']);
}

/// Encodes the low six bits as a character from `0` to `o` (p. 5).
fn sextet(bits: u32) -> u8 {
    (bits & 0x3F) as u8 + 0x30
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_and_the_largest_value() {
        assert_eq!(distances(b"G", &[0, 4095]), b"G\n0\n00oo\n\n");
    }

    #[test]
    fn a_scip2_scan_checks_its_lines() {
        let frame = scip2_scan(&[1234; 3], 0);
        // "0000" sums to 0xC0, whose low six bits are 0; "0CB" three times to
        // 0x21F, whose low six bits, 0x1F, are 'O'.
        assert_eq!(frame, b"MD0044072501000\n99b\n00000\n0CB0CB0CBO\n\n");
    }
}
