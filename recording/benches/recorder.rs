//! A week of recording at 10 Hz, on the paused clock: the memory of the program, and the
//! time that `Recorder::finish` takes. The sensor is emulated, the file is real, and each
//! part of the recording is removed when the next one has begun.
//!
//! `cargo bench -p urg-recording` takes minutes and 7 GB of disk.
//! `-- 86400` records for that many seconds. `-- outgrow FOLDER` records without a sensor, as fast as
//! possible, until the file may not grow (4 GiB on FAT), and then the scans of one more minute.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::path::{Path, PathBuf};
use std::time::Instant;

use futures::FutureExt;
use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_emulator::{Emulator, Fixed, Pace};
use urg_recording::{Entry, Recorder, Recording};

/// Just before a file has all the chunks that its index may have, and a week.
const SPANS: [u64; 2] = [65_500, 7 * DAY];
const DAY: u64 = 24 * 60 * 60;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [mode, folder, ..] = &arguments[..]
        && mode == "outgrow"
    {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        return runtime.block_on(outgrow(Path::new(folder)));
    }
    let spans: Vec<u64> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let folder = std::env::temp_dir().join(format!("recorder-{}", std::process::id()));
    for &seconds in if spans.is_empty() { &SPANS[..] } else { &spans } {
        std::fs::create_dir_all(&folder).unwrap();
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_time().start_paused(true).build().unwrap();
        runtime.block_on(record(&folder.join("run.mcap"), seconds));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

async fn record(path: &Path, seconds: u64) {
    let began = Instant::now();
    let mut recorder = Recorder::create(path).unwrap();
    let emulator = Emulator::builder().world(Fixed::filled(1234)).pace(Pace::AtOnce);
    let builder = Sensor::builder().on_reply(recorder.observer()).depth(64);
    let sensor = builder.connect(emulator.log_capacity(0).build()).await.unwrap();
    let mut scans = sensor.scans(Window::FULL, Rate::hz(10.0)).await.unwrap();
    recorder.describe(&sensor, &scans).await.unwrap();
    let mut files = 1;
    for scan in 0..seconds * 10 {
        let hours = scan / 36_000;
        if scan % 36_000 == 0 && (hours == 1 || hours.is_multiple_of(24)) {
            report(&format!("after {hours} h"), scan, &recorder);
        }
        recorder.record(&scans.next().await.unwrap()).unwrap();
        // Without this the paused clock runs ahead of the disk.
        while recorder.ready().now_or_never().is_none() {
            std::thread::yield_now();
        }
        while files < recorder.progress().files {
            std::fs::remove_file(part(path, files)).unwrap();
            files += 1;
        }
    }
    drop(scans);
    sensor.close().await;
    report("before finish", seconds * 10, &recorder);
    let ending = Instant::now();
    let progress = recorder.finish().await.unwrap();
    let finish = ending.elapsed();
    assert_eq!((progress.lost, progress.lost_replies), (0, 0));
    println!("finish took {finish:.0?}; resident {:.1} MiB", resident_mib());
    println!("all of it {:.0?}\n", began.elapsed());
}

async fn outgrow(folder: &Path) {
    let (path, began) = (folder.join("run.mcap"), Instant::now());
    let mut recorder = Recorder::builder().split_bytes(10_000_000_000).create(&path).unwrap();
    let item = Ok(Scan::builder(Window::DETECTION, [1234; 682]).build().unwrap());
    let (mut scans, mut rest) = (0, 600);
    while rest > 0 {
        recorder.record(&item).unwrap();
        recorder.ready().await;
        scans += 1;
        rest -= u64::from(recorder.progress().has_outgrown_file);
    }
    let progress = recorder.finish().await.unwrap();
    println!("{scans} scans recorded in {:.0?}; {progress:?}", began.elapsed());
    let mut found = 0;
    for number in 1..=progress.files {
        let path = part(&path, number);
        let mut recording = Recording::open(&path).unwrap();
        let entries = recording.by_ref().map(|record| record.unwrap().entry);
        let scans = entries.filter(|entry| matches!(entry, Entry::Scan(_))).count();
        let bytes = path.metadata().unwrap().len();
        println!("{bytes} bytes, {scans} scans, complete: {}", !recording.is_truncated());
        found += scans;
    }
    assert_eq!((found, progress.lost), (scans, 0));
}

fn report(place: &str, scans: u64, recorder: &Recorder) {
    let (progress, memory) = (recorder.progress(), resident_mib());
    let (files, gigabytes) = (progress.files, progress.bytes as f64 / 1e9);
    println!("{place}: {scans} scans, {files} files, {gigabytes:.1} GB; resident {memory:.1} MiB");
}

/// Returns the path of a part of the recording.
fn part(path: &Path, number: u64) -> PathBuf {
    match number {
        1 => path.to_owned(),
        number => path.with_file_name(format!("run_{number:04}.mcap")),
    }
}

/// Returns the resident memory of this process (Linux).
fn resident_mib() -> f64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
    let pages: f64 = pages.split(' ').nth(1).unwrap().parse().unwrap();
    pages * 4096.0 / f64::from(1 << 20)
}
