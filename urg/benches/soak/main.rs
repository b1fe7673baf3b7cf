//! A soak on the real clock: emulated sensors on pseudo-terminals at 10 Hz, replugged
//! once a minute. One process records and has eight streams that come and go, another is
//! `urg serve` with 20 clients. Reports the memory, file descriptors and threads of both,
//! and the scans that were missed.
//!
//! `cargo bench -p urg --bench soak -- 2h` prints a row every ten seconds
//! (Linux). Ctrl-C ends it early with a verdict. Ends with 1 if a limit of
//! `verdict.rs` is exceeded.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod library;
mod process;
mod verdict;
mod viewers;

use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::time::{Instant, MissedTickBehavior, interval, sleep};
use urg_emulator::{Emulator, Pty};
use urg_recording::{Entry, Recording};

use self::process::{Library, Sample, Server};
use self::verdict::Outcome;
use self::viewers::Viewers;

const SAMPLE_INTERVAL: Duration = Duration::from_secs(10);
const REPLUG_INTERVAL: Duration = Duration::from_secs(60);
const UNPLUGGED: Duration = Duration::from_secs(2);
/// A sensor is powered by its cable, and silent for a while after that.
const BOOT_TIME: Duration = Duration::from_secs(1);
/// A real sensor answers ten commands a second, and the recorder alone sends so many.
const REVOLUTION: Duration = Duration::from_millis(25);

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let mut runtime = tokio::runtime::Builder::new_multi_thread();
    let runtime = runtime.worker_threads(2).enable_all().build().unwrap();
    match &arguments[..] {
        [role, port, file] if role == "library" => runtime.block_on(library::run(port, file)),
        [span] => {
            let is_good = runtime.block_on(soak(duration(span)));
            std::process::exit(i32::from(!is_good));
        }
        _ => println!("not run: it needs a duration, such as 2h or 120s"),
    }
}

fn duration(text: &str) -> Duration {
    let (number, unit) = text.split_at(text.len() - 1);
    let seconds = match unit {
        "s" => 1,
        "m" => 60,
        "h" => 3600,
        _ => panic!("invalid duration `{text}`: expected a number and s, m or h, such as 2h"),
    };
    Duration::from_secs(number.parse::<u64>().expect("a whole number") * seconds)
}

/// Runs for `span`. Returns whether everything is within its limits.
async fn soak(span: Duration) -> bool {
    let folder = std::env::temp_dir().join(format!("soak-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let sensors: Vec<_> = ["library", "serve"]
        .map(|name| {
            let (port, emulator) = (folder.join(name), emulator());
            let pty = Pty::open(&emulator, Some(&port)).unwrap();
            tokio::spawn(pty.serve());
            (port, emulator)
        })
        .into();
    let recording = folder.join("run.mcap");
    let mut library = Library::start(&sensors[0].0, &recording).await;
    let mut server = Server::start(&sensors[1].0).await;
    let viewers = Viewers::start(server.address);

    let mut outcome = Outcome::default();
    let (mut parts_read, mut replugs) = (0, 0);
    let (start, mut ticks) = (Instant::now(), interval(SAMPLE_INTERVAL));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    ticks.tick().await;
    let end = start + span;
    let mut next_replug = start + REPLUG_INTERVAL / 2;
    println!("{}", Sample::HEADER);
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            () = tokio::time::sleep_until(next_replug) => {
                next_replug += REPLUG_INTERVAL;
                replugs += 1;
                replug(&sensors).await;
                continue;
            }
            () = tokio::time::sleep_until(end) => break,
            _ = tokio::signal::ctrl_c() => break,
        }
        let counts = library.report().await;
        let [library, server] = [&library.process, &server.process].map(Sample::from_process);
        let served = viewers.counts();
        let seconds = start.elapsed().as_secs();
        println!(
            "{seconds:6} s  {library}  {server}  {:7} scans, {} missed, {} slow  {:8} scans, {} missed",
            counts["recorded"],
            counts["missed"],
            counts["slow_missed"],
            served.scans,
            served.missed,
        );
        outcome.samples.push([library, server]);
        // All files but the last are complete.
        while parts_read + 1 < counts["files"] {
            parts_read += 1;
            outcome.scans_in_files += take_part(&recording, parts_read).await;
        }
    }
    // The last replug is over, and its scans have come.
    sleep(Duration::from_secs(15)).await;
    outcome.replugs = replugs;
    outcome.served_metrics = viewers::metrics(server.address).await;
    outcome.served = viewers.counts();
    drop(viewers);
    outcome.counts = library.finish().await;
    server.process.kill().await.unwrap();
    while parts_read < outcome.counts["files"] {
        parts_read += 1;
        outcome.scans_in_files += take_part(&recording, parts_read).await;
    }
    std::fs::remove_dir_all(&folder).unwrap();
    println!("\nafter {:.1} min:", start.elapsed().as_secs_f64() / 60.0);
    outcome.report()
}

fn emulator() -> Emulator {
    Emulator::builder().revolution(REVOLUTION).boot_time(BOOT_TIME).log_capacity(0).build()
}

/// Unplugs all sensors, and plugs them in again.
async fn replug(sensors: &[(PathBuf, Emulator)]) {
    for (_, sensor) in sensors {
        sensor.unplug();
    }
    sleep(UNPLUGGED).await;
    for (_, sensor) in sensors {
        sensor.power_cycle();
        sensor.plug_in();
    }
}

/// Counts the scans in a part of the recording, which must be complete, and removes it.
async fn take_part(recording: &Path, number: u64) -> u64 {
    let path = match number {
        1 => recording.to_owned(),
        number => recording.with_file_name(format!("run_{number:04}.mcap")),
    };
    let count = || {
        let mut recording = Recording::open(&path).unwrap();
        let entries = recording.by_ref().map(|record| record.unwrap().entry);
        let scans = entries.filter(|entry| matches!(entry, Entry::Scan(_))).count() as u64;
        assert!(!recording.is_truncated(), "{} is cut off", path.display());
        std::fs::remove_file(&path).unwrap();
        scans
    };
    tokio::task::block_in_place(count)
}
