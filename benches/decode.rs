//! The cost of decoding the bytes of a full scan into values, beside copying the
//! same bytes and beside a byte-wise decoder.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::hint::black_box;
use std::sync::Arc;

use bytes::BytesMut;
use divan::Bencher;
use tokio_scip::Window;
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_scip::protocol::{Command, Reply};
use tokio_util::codec::{Decoder, Encoder};

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;

fn main() {
    divan::main();
}

fn full_scan() -> Vec<u8> {
    let mut reply = Vec::new();
    instant_sensor::reply(b"G00076801", &mut reply);
    assert_eq!(reply.len(), 1576);
    reply
}

/// Copies the bytes into a warm, allocated buffer.
#[divan::bench(sample_size = 100)]
fn copy(bencher: Bencher) {
    let reply = full_scan();
    let mut buffer = vec![0; reply.len()];
    bencher.bench_local(|| {
        buffer.copy_from_slice(black_box(&reply));
        black_box(&mut buffer);
    });
}

/// Copies the bytes into a new block: `to_vec`.
#[divan::bench(sample_size = 100)]
fn copy_to_new_block(bencher: Bencher) {
    let reply = full_scan();
    bencher.bench_local(|| drop(black_box(black_box(&reply).to_vec())));
}

/// Does what a program with a `Framed` does with a reply: copies it into the read buffer, splits
/// it off, checks it, and decodes it into the values of a `Scan`.
#[divan::bench(sample_size = 100)]
fn crate_decoder(bencher: Bencher) {
    let mut codec = ScipCodec::default();
    codec.encode(&Command::Distances(Window::FULL), &mut BytesMut::new()).unwrap();
    decode(bencher, codec);
}

/// Searches for the end of the reply, as a codec does that has not sent its command.
#[divan::bench(sample_size = 100)]
fn crate_decoder_in_steps(bencher: Bencher) {
    decode(bencher, ScipCodec::default());
}

fn decode(bencher: Bencher, mut codec: ScipCodec) {
    let (reply, command) = (full_scan(), Command::Distances(Window::FULL));
    let mut buffer = BytesMut::with_capacity(4096);
    bencher.bench_local(|| {
        buffer.reserve(4096);
        buffer.extend_from_slice(black_box(&reply));
        let Ok(Some(Frame::Reply(frame))) = codec.decode(&mut buffer) else { panic!("no frame") };
        drop(black_box(Reply::parse(black_box(&command), &frame).unwrap()));
    });
}

/// Makes the same checks byte by byte, into a new block.
#[divan::bench(sample_size = 100)]
fn naive_decoder(bencher: Bencher) {
    let reply = full_scan();
    let mut buffer = Vec::with_capacity(4096);
    bencher.bench_local(|| {
        buffer.clear();
        buffer.extend_from_slice(black_box(&reply));
        drop(black_box(naive(black_box(b"G00076801"), 769, &buffer).unwrap()));
    });
}

/// Returns the values of a reply, decoded one byte after the other, or `None` if it is
/// malformed.
fn naive(command: &[u8], points: usize, bytes: &[u8]) -> Option<Arc<[u16]>> {
    let mut lines: Vec<Vec<u8>> = vec![Vec::new()];
    for &byte in bytes {
        match byte {
            b'\n' if lines.last()?.is_empty() => break,
            b'\n' => lines.push(Vec::new()),
            _ => lines.last_mut()?.push(byte),
        }
    }
    lines.pop();
    if lines.first()? != command || lines.get(1)? != b"0" {
        return None;
    }
    let mut values = Vec::new();
    let mut upper = None;
    let last = lines.len() - 1;
    for (index, line) in lines.iter().enumerate().skip(2) {
        if line.len() > 64 || line.len() < 64 && index != last {
            return None;
        }
        for &byte in line {
            if !(0x30..0x70).contains(&byte) {
                return None;
            }
            let six = u16::from(byte - 0x30);
            match upper.take() {
                None => upper = Some(six),
                Some(upper) => values.push(upper << 6 | six),
            }
        }
    }
    (values.len() == points).then(|| values.into())
}
