//! An independent encoder of replies, made from the protocol text without the crate.

/// The 64 characters of 6 bits, 0x30 to 0x6f (p. 5), in order.
const CHARACTERS: &[u8; 64] = b"0123456789:;<=>?@ABCDEFGHIJKLMNOPQRSTUVWXYZ[\\]^_`abcdefghijklmno";

/// Encodes a 12-bit value as two characters, the upper six bits first.
pub(crate) fn characters(value: u16) -> [u8; 2] {
    assert!(value < 4096);
    [CHARACTERS[usize::from(value / 64)], CHARACTERS[usize::from(value % 64)]]
}

/// Splits data into lines of 64 bytes, with an LF between them.
pub(crate) fn lines(data: &[u8]) -> Vec<u8> {
    data.chunks(64).collect::<Vec<_>>().join(&b'\n')
}

/// Makes a `G` reply of success to `echo`, without the two LFs at its end.
pub(crate) fn frame(echo: &str, values: &[u16]) -> Vec<u8> {
    let data: Vec<u8> = values.iter().flat_map(|&value| characters(value)).collect();
    [echo.as_bytes(), b"\n0\n", &lines(&data)].concat()
}

/// Makes the same reply with the two LFs.
pub(crate) fn reply(echo: &str, values: &[u16]) -> Vec<u8> {
    [&frame(echo, values)[..], b"\n\n"].concat()
}

/// Splits bytes into frames at every double LF.
pub(crate) fn frames(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut found = Vec::new();
    while let Some(end) = bytes.windows(2).position(|pair| pair == b"\n\n") {
        found.push(&bytes[..end]);
        bytes = &bytes[end + 2..];
    }
    found
}

/// Returns values spread evenly over all 4,096, always the same ones.
pub(crate) fn spread(count: usize) -> Vec<u16> {
    let mut state = 1_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 20) as u16
    };
    (0..count).map(|_| next()).collect()
}

/// Returns values as measured indoors: more than half are error codes, mostly 0, 6, 16
/// and 7; the others are distances of up to 4 metres.
pub(crate) fn indoors(count: usize) -> Vec<u16> {
    let codes = [0, 6, 16, 7, 0, 6];
    spread(count)
        .into_iter()
        .enumerate()
        .map(|(step, value)| if step % 9 < 5 { codes[step % 6] } else { 20 + value % 3981 })
        .collect()
}
