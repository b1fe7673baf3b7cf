//! The cost of decoding a scan of SCIP 2 with the sum of each line, beside copying the same bytes.
//! With the arguments `instructions NUMBER` it decodes NUMBER times and ends, for callgrind.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::hint::black_box;

use divan::Bencher;
use tokio_scip::Window;
use tokio_scip::protocol::scip2::{Command, Data, Reply, Request, Stream};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    match &arguments[..] {
        [_, work, number] if work == "instructions" => {
            let (request, frame) = scan(Data::Distances);
            for _ in 0..number.parse().unwrap() {
                drop(black_box(Reply::parse(black_box(&request), black_box(&frame)).unwrap()));
            }
        }
        _ => divan::main(),
    }
}

/// A scan of 1,081 points as a UST sends it, without its terminator.
fn scan(data: Data) -> (Request, Vec<u8>) {
    let stream = Stream::new(data, Window::new(0..=1080).unwrap());
    let request = Request::new(Command::Stream(stream), None);
    let mut frame = [request.bytes(), b"\n99b\n01_2b"].concat();
    let values = if data == Data::Intensities { 2 * 1081 } else { 1081 };
    let numbers = (0..values).map(|index: u32| index * 241 % 60_000);
    let characters: Vec<u8> =
        numbers.flat_map(|n| [n >> 12, n >> 6, n].map(|six| (six & 63) as u8 + 0x30)).collect();
    for line in characters.chunks(64) {
        let sum = line.iter().map(|&byte| u32::from(byte)).sum::<u32>();
        frame.push(b'\n');
        frame.extend_from_slice(line);
        frame.push((sum & 63) as u8 + 0x30);
    }
    assert_eq!(Some(frame.len() + 2), request.reply_len());
    (request, frame)
}

/// Copies the bytes into a new block: `to_vec`.
#[divan::bench(sample_size = 100, args = [Data::Distances, Data::Intensities])]
fn copy_to_new_block(bencher: Bencher, data: &Data) {
    let (_, frame) = scan(*data);
    bencher.bench_local(|| drop(black_box(black_box(&frame).to_vec())));
}

/// Checks and decodes the frame.
#[divan::bench(sample_size = 100, args = [Data::Distances, Data::Intensities])]
fn decode(bencher: Bencher, data: &Data) {
    let (request, frame) = scan(*data);
    bencher.bench_local(|| {
        drop(black_box(Reply::parse(black_box(&request), black_box(&frame)).unwrap()));
    });
}
