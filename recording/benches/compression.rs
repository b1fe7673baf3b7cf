//! Bytes, CPU time and memory of compressed recordings, on the paused clock: the emulator's rooms at
//! 10 and 40 Hz, each recorded by a process of its own.
//!
//! `cargo bench -p urg-recording --features zstd --bench compression` takes two minutes.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

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
    let bytes = runtime.block_on(record(room, hz, compression));
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

async fn record(room: &str, hz: u64, compression: Compression) -> u64 {
    let path = std::env::temp_dir().join(format!("compression-{}.mcap", std::process::id()));
    let recorder = Recorder::builder().compression(compression);
    let mut recorder = recorder.create(&path).unwrap();
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
    std::fs::remove_file(path).unwrap();
    progress.bytes
}
