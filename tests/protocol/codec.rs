//! The framing: where replies end, in whatever pieces their bytes arrive. `properties`
//! checks it for any bytes.

use bytes::BytesMut;
use tokio_scip::Window;
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_scip::protocol::{BaudRate, Command, Reply};
use tokio_util::codec::{Decoder, Encoder};

/// Longest reply, as the documentation of `Frame` states it.
const MAX_FRAME: usize = 4096;

/// Decodes `chunks` one after the other, and takes every frame as soon as it is complete.
fn decode<'a>(chunks: impl IntoIterator<Item = &'a [u8]>) -> (Vec<Frame>, BytesMut) {
    let (mut codec, mut buffer, mut frames) = (ScipCodec::default(), BytesMut::new(), Vec::new());
    for chunk in chunks {
        buffer.extend_from_slice(chunk);
        while let Some(frame) = codec.decode(&mut buffer).unwrap() {
            frames.push(frame);
        }
    }
    (frames, buffer)
}

fn reply(bytes: &[u8]) -> Frame {
    Frame::Reply(bytes.into())
}

#[test]
fn w17_a_reply_ends_with_two_line_feeds() {
    let (frames, rest) = decode([&b"L1\n0\n\nV\n0\nVEND:x\n\nG000"[..]]);
    assert_eq!(frames, [reply(b"L1\n0"), reply(b"V\n0\nVEND:x")]);
    assert_eq!(&*rest, b"G000");
}

#[test]
fn w17_an_end_is_found_anywhere() {
    for length in 0..400 {
        for behind in [0, 1, 15, 200] {
            let mut bytes = vec![b'x'; length];
            bytes.extend_from_slice(b"\n\n");
            bytes.resize(length + 2 + behind, b'y');
            let (frames, rest) = decode([&bytes[..]]);
            assert_eq!(frames, [reply(&bytes[..length])], "{behind} bytes behind {length}");
            assert_eq!(rest.len(), behind);
        }
    }
}

#[test]
fn w18_leading_nuls_are_skipped_and_inner_ones_are_not() {
    let (frames, _) = decode([&b"\0\0"[..], b"\0V\n0\n\n\0L1\0\n0\n\n"]);
    assert_eq!(frames, [reply(b"V\n0"), reply(b"L1\0\n0")]);
}

#[test]
fn w19_a15_an_over_long_reply_is_an_item() {
    for extra in [1, 2, 64, 3 * MAX_FRAME] {
        let mut bytes = vec![b'x'; MAX_FRAME + extra];
        bytes.extend_from_slice(b"\n\nL1\n0\n\n");
        for chunk in [1, 7, 1000, bytes.len()] {
            let (frames, rest) = decode(bytes.chunks(chunk));
            let skipped = Frame::Overlong { bytes: MAX_FRAME + extra };
            assert_eq!(frames, [skipped, reply(b"L1\n0")], "{extra} more in chunks of {chunk}");
            assert!(rest.is_empty());
        }
    }
}

#[test]
fn a_reply_of_the_greatest_length_is_a_reply() {
    let mut bytes = vec![b'x'; MAX_FRAME];
    bytes.extend_from_slice(b"\n\n");
    // One size of chunk lets a read end between the two LFs.
    for chunk in [100, MAX_FRAME, MAX_FRAME + 1, bytes.len()] {
        let (frames, _) = decode(bytes.chunks(chunk));
        assert_eq!(frames, [reply(&bytes[..MAX_FRAME])], "in chunks of {chunk}");
    }
}

#[test]
fn w19_endless_garbage_is_not_buffered() {
    let (mut codec, mut buffer) = (ScipCodec::default(), BytesMut::new());
    for _ in 0..1000 {
        buffer.extend_from_slice(&[b'x'; 100]);
        assert_eq!(codec.decode(&mut buffer).unwrap(), None);
        assert!(buffer.len() <= MAX_FRAME);
    }
}

#[test]
fn w20_line_feeds_alone_are_empty_replies() {
    let (frames, rest) = decode([&b"\n\n\n\n\n"[..]]);
    assert_eq!(frames, [reply(b""), reply(b"")]);
    assert_eq!(&*rest, b"\n");
}

#[test]
fn a15_half_a_reply_is_dropped_without_error() {
    let (mut codec, mut buffer) = (ScipCodec::default(), BytesMut::from(&b"V\n0\n\nG00"[..]));
    assert_eq!(codec.decode_eof(&mut buffer).unwrap(), Some(reply(b"V\n0")));
    assert_eq!(codec.decode_eof(&mut buffer).unwrap(), None);
    assert!(buffer.is_empty());
}

/// Returns a window of 33 points, its reply and its values.
fn scan() -> (Window, &'static [u8], Vec<u16>) {
    let reply = b"G00003201\n0\n\
        0123456789:;<=>?@ABCDEFGHIJKLMNOPQRSTUVWXYZ[\\]^_`abcdefghijklmno\n01\n\n";
    let values = (0..64).step_by(2).map(|n| n * 64 + n + 1).chain([1]).collect();
    (Window::new(0..=32).unwrap(), reply, values)
}

/// Makes a codec that has encoded the `G` for `window`.
fn expecting(window: Window) -> ScipCodec {
    let mut codec = ScipCodec::default();
    codec.encode(&Command::Distances(window), &mut BytesMut::new()).unwrap();
    codec
}

#[test]
fn an_expected_scan_is_the_frame_found() {
    let (window, reply, expected) = scan();
    let bytes = [reply, reply, b"L1\n0\n\n"].concat();
    for split in 0..reply.len() {
        let (mut codec, mut buffer) = (expecting(window), BytesMut::from(&bytes[..split]));
        assert_eq!(codec.decode(&mut buffer).unwrap(), None, "split at {split}");
        buffer.extend_from_slice(&bytes[split..]);
        for _ in 0..2 {
            let Some(Frame::Reply(frame)) = codec.decode(&mut buffer).unwrap() else { panic!() };
            assert_eq!(frame, reply[..reply.len() - 2], "split at {split}");
            let reply = Reply::parse(&Command::Distances(window), &frame).unwrap();
            assert_eq!(reply.values(), expected);
        }
        assert_eq!(codec.decode(&mut buffer).unwrap(), Some(self::reply(b"L1\n0")));
    }
}

#[test]
fn w12_an_expected_scan_with_a_terminator_inside_is_malformed() {
    let (window, reply, _) = scan();
    let mut bytes = reply.to_vec();
    bytes[20..22].copy_from_slice(b"\n\n");
    let frames: Vec<Frame> = {
        let (mut codec, mut buffer) = (expecting(window), BytesMut::from(&bytes[..]));
        std::iter::from_fn(|| codec.decode(&mut buffer).unwrap()).collect()
    };
    for frame in &frames {
        let Frame::Reply(frame) = frame else { panic!() };
        assert!(Reply::parse(&Command::Distances(window), frame).is_err());
    }
    assert!(!frames.is_empty());
}

#[test]
fn w19_an_over_long_reply_hides_no_scan() {
    let (window, reply, _) = scan();
    let (mut codec, mut buffer) = (expecting(window), BytesMut::new());
    buffer.extend_from_slice(&[b'G'; MAX_FRAME + 1]);
    assert_eq!(codec.decode(&mut buffer).unwrap(), None);
    // The last byte is kept, because it may be half a terminator.
    assert_eq!(&*buffer, b"G");
    buffer.extend_from_slice(&reply[1..]);
    assert_eq!(&*buffer, reply);
    let bytes = MAX_FRAME + reply.len() - 2;
    assert_eq!(codec.decode(&mut buffer).unwrap(), Some(Frame::Overlong { bytes }));
}

#[test]
fn a_command_ends_with_one_line_feed() {
    let mut buffer = BytesMut::new();
    for command in [
        Command::Version,
        Command::LaserOff,
        Command::BaudRate(BaudRate::B115200),
        Command::Distances(Window::DETECTION),
    ] {
        ScipCodec::default().encode(&command, &mut buffer).unwrap();
    }
    assert_eq!(&*buffer, b"V\nL0\nS1152000000000\nG04472501\n");
}
