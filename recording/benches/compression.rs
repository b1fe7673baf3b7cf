//! Bytes, CPU time and memory of compressed recordings, on the paused clock: the emulator's rooms at
//! 10 and 40 Hz, each recorded by a process of its own.
//!
//! `cargo bench -p urg-recording --features zstd --bench compression` takes two minutes. `-- levels`
//! compresses their chunks again, at other levels of zstd, several as one, and without `/scan`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use futures::FutureExt;
use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::{Emulator, Pace, Room};
use urg_recording::{Compression, Recorder};

/// Time to record at 10 Hz; at 40 Hz it is a quarter, for as many scans.
const SCANS: u64 = 6_000;
/// Clock ticks of `/proc` in a second.
const TICKS: f64 = 100.0;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [room, hz, compression] = &arguments[..] {
        return child(room, hz.parse().unwrap(), named(compression));
    }
    if arguments.iter().any(|argument| argument == "levels") {
        return levels();
    }
    println!("room  Hz   compression  bytes a scan  of plain  CPU a scan  of plain  peak memory");
    for room in ["easy", "hard"] {
        for hz in ["10", "40"] {
            let mut plain = None;
            for compression in ALL {
                // The fastest of three: others use the cores, too.
                let runs = (0..3).map(|_| run(room, hz, compression));
                let [bytes, cpu, memory] = runs.min_by(|a, b| a[1].total_cmp(&b[1])).unwrap();
                let [all_bytes, all_cpu, all_memory] = *plain.get_or_insert([bytes, cpu, memory]);
                println!(
                    "{room:<4}  {hz}   {compression:<11}  {bytes:>12.0}  {:>8.3}  {cpu:>7.1} us  \
                     {:>8.2}  {memory:.1} MiB ({:+.1})",
                    bytes / all_bytes,
                    cpu / all_cpu,
                    memory - all_memory
                );
            }
        }
    }
}

/// Returns bytes and microseconds a scan, and MiB.
fn run(room: &str, hz: &str, compression: Compression) -> [f64; 3] {
    let mut command = Command::new(std::env::current_exe().unwrap());
    let output = command.args([room, hz, &compression.to_string()]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let numbers: Vec<f64> = text.split_whitespace().map(|part| part.parse().unwrap()).collect();
    numbers.try_into().unwrap()
}

fn child(room: &str, hz: u64, compression: Compression) {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    let path = std::env::temp_dir().join(format!("compression-{}.mcap", std::process::id()));
    let bytes = runtime.block_on(record(&path, room, hz, compression));
    std::fs::remove_file(path).unwrap();
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
    let ticks: f64 = fields[11..13].iter().map(|ticks| ticks.parse::<f64>().unwrap()).sum();
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.split("VmHWM:").nth(1).unwrap().split_whitespace().next().unwrap();
    let scans = SCANS as f64;
    println!(
        "{} {} {}",
        bytes as f64 / scans,
        ticks / TICKS * 1e6 / scans,
        peak.parse::<f64>().unwrap() / 1024.0
    );
}

const ALL: [Compression; 3] = [Compression::Plain, Compression::Lz4, Compression::Zstd];

fn named(name: &str) -> Compression {
    ALL.into_iter().find(|one| one.to_string() == name).unwrap()
}

/// Records of each chunk of a plain file, in pairs: their channel, or `None` for a definition.
fn chunks(file: &[u8]) -> Vec<Vec<(Option<u8>, &[u8])>> {
    let (mut rest, mut chunks) = (&file[8..], Vec::new());
    while rest.len() > 8 {
        let (chunk, after) = split(rest);
        rest = after;
        if chunk[0] == 0x06 {
            let (mut records, mut found) = (&chunk[9 + 40..], Vec::new());
            while !records.is_empty() {
                let (record, after) = split(records);
                found.push(((record[0] == 0x05).then_some(record[9]), record));
                records = after;
            }
            chunks.push(found);
        }
    }
    chunks
}

/// Splits off a record.
fn split(bytes: &[u8]) -> (&[u8], &[u8]) {
    bytes.split_at(9 + u64::from_le_bytes(bytes[1..9].try_into().unwrap()) as usize)
}

fn levels() {
    println!("room  Hz   chunk  /scan  level  of plain  encoder alone");
    for (room, hz) in [("easy", 10), ("easy", 40), ("hard", 10), ("hard", 40)] {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_time().start_paused(true).build().unwrap();
        let path = std::env::temp_dir().join(format!("levels-{}.mcap", std::process::id()));
        runtime.block_on(record(&path, room, hz, Compression::Plain));
        let file = std::fs::read(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        let chunks = chunks(&file);
        let all: usize = chunks.iter().flatten().map(|(_, record)| record.len()).sum();
        for (seconds, has_scan, levels) in [
            (1, true, &[1, 3, 5][..]),
            (10, true, &[3, 5]),
            (60, true, &[3, 5]),
            (1, false, &[0, 3]),
        ] {
            let parts = chunks.chunks(seconds).map(|part| part.iter().flatten());
            let is_kept = |channel: &Option<u8>| has_scan || *channel != Some(0);
            let parts = parts.map(|part| part.filter(|(channel, _)| is_kept(channel)));
            let parts: Vec<Vec<u8>> =
                parts.map(|part| part.flat_map(|(_, record)| *record).copied().collect()).collect();
            for level in levels {
                let (bytes, time) = encoded(&parts, *level);
                println!(
                    "{room:<4}  {hz}  {seconds:>4} s  {has_scan:<5}  {level:>5}  {:>8.3}  {:>8.1} us a scan",
                    bytes as f64 / all as f64,
                    time.as_secs_f64() * 1e6 / SCANS as f64
                );
            }
        }
    }
}

/// CPU time of this thread.
fn cpu_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    Duration::from_nanos(text.split(' ').next().unwrap().parse().unwrap())
}

/// Compresses each part at a level, where 0 is none. Returns the bytes, and the CPU time.
fn encoded(parts: &[Vec<u8>], level: i32) -> (usize, Duration) {
    let (mut context, began) = (zstd_safe::CCtx::create(), cpu_time());
    let mut out = vec![0; zstd_safe::compress_bound(parts.iter().map(Vec::len).max().unwrap())];
    let lengths = parts.iter().map(|part| match level {
        0 => part.len(),
        level => context.compress(&mut out[..], part, level).unwrap(),
    });
    (lengths.sum(), cpu_time() - began)
}

async fn record(path: &Path, room: &str, hz: u64, compression: Compression) -> u64 {
    let recorder = Recorder::builder().compression(compression);
    let mut recorder = recorder.create(path).unwrap();
    let builder = Emulator::builder().pace(Pace::AtOnce).log_capacity(0);
    let builder = builder.revolution(Duration::from_millis(1000 / hz));
    let emulator = match room {
        "hard" => builder.world(Room::hard(0)),
        _ => builder.world(Room::new(0)),
    };
    let sensor = Sensor::builder().depth(64).on_reply(recorder.observer());
    let sensor = sensor.connect(emulator.build()).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(hz as f64)).await.unwrap();
    recorder.describe(&sensor, &scans).await.unwrap();
    for _ in 0..SCANS {
        recorder.record(&scans.next().await.unwrap()).unwrap();
        // Without this the paused clock runs ahead of the disk.
        while recorder.ready().now_or_never().is_none() {
            std::thread::yield_now();
        }
    }
    drop(scans);
    sensor.close().await;
    let progress = recorder.finish().await.unwrap();
    assert_eq!((progress.lost, progress.lost_replies), (0, 0));
    progress.bytes
}
