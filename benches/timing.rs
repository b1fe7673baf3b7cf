//! The lateness of polls on the real clock, beside the ticks of a bare
//! `tokio::time::interval`; and the time from the last byte of a reply until its
//! consumer has the scan, beside a task that waits in a bare read. All four run side by
//! side on one current-thread runtime.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::fs::File;
use std::io::Write;
use std::sync::mpsc;
use std::time::Duration;
use tokio::time::Instant;

use instant_sensor::InstantSensor;
use support::terminal::{self, Terminal};
use support::{percentile, us};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{MissedTickBehavior, interval, sleep};
use tokio_scip::{Rate, Sensor, Window};
use tokio_serial::SerialStream;

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;
#[path = "support/mod.rs"]
mod support;

const PERIOD: Duration = Duration::from_millis(10);
const SAMPLES: usize = 3000;

fn main() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let (polls, ticks, scans, reads) = runtime.block_on(async {
        let polls = tokio::spawn(lateness_of_polls());
        sleep(PERIOD / 4).await;
        let ticks = tokio::spawn(lateness_of_ticks());
        sleep(PERIOD / 4).await;
        let scans = tokio::spawn(latency_of_scans());
        sleep(PERIOD / 4).await;
        let reads = tokio::spawn(latency_of_reads());
        tokio::try_join!(polls, ticks, scans, reads).unwrap()
    });
    println!("microseconds                              median     99 %");
    for (what, mut samples) in [
        ("lateness of a poll", polls),
        ("lateness of a tick of a bare interval", ticks),
        ("last byte written to scan held", scans),
        ("last byte written to bare read done", reads),
    ] {
        let (median, most) = (percentile(&mut samples, 0.5), percentile(&mut samples, 0.99));
        println!("{what:38} {:9.0} {:8.0}", us(median), us(most));
    }
}

async fn lateness_of_polls() -> Vec<Duration> {
    let sensor = Sensor::builder().attach(InstantSensor::new()).await.unwrap();
    let start = Instant::now();
    let mut stream = sensor.scans(Window::DETECTION, Rate::every(PERIOD)).await.unwrap();
    let mut samples = Vec::new();
    while samples.len() < SAMPLES {
        let scan = stream.next().await.unwrap().unwrap();
        let since = scan.times().requested_at - start;
        samples.push(Duration::from_nanos((since.as_nanos() % PERIOD.as_nanos()) as u64));
    }
    samples
}

async fn lateness_of_ticks() -> Vec<Duration> {
    let start = Instant::now();
    let mut ticks = interval(PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut samples = Vec::new();
    while samples.len() < SAMPLES {
        ticks.tick().await;
        let since = start.elapsed();
        samples.push(Duration::from_nanos((since.as_nanos() % PERIOD.as_nanos()) as u64));
    }
    samples
}

async fn latency_of_scans() -> Vec<Duration> {
    let terminal = Terminal::open();
    let written = serve_and_report(terminal.master);
    let sensor = Sensor::open(terminal.path.to_str().unwrap()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::every(PERIOD)).await.unwrap();
    let (mut samples, mut times) = (Vec::new(), Vec::new());
    while samples.len() < SAMPLES {
        let sequence = stream.next().await.unwrap().unwrap().sequence();
        let held = Instant::now();
        times.extend(written.try_iter());
        samples.push(held - times[sequence as usize]);
    }
    samples
}

async fn latency_of_reads() -> Vec<Duration> {
    let terminal = Terminal::open();
    let written = serve_and_report(terminal.master);
    let path = terminal.path.to_str().unwrap();
    let mut port = SerialStream::open(&tokio_serial::new(path, 19_200)).unwrap();
    let (mut ticks, mut buffer) = (interval(PERIOD), vec![0; 4096]);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let (mut samples, mut times) = (Vec::new(), Vec::new());
    while samples.len() < SAMPLES {
        ticks.tick().await;
        AsyncWriteExt::write_all(&mut port, b"G04472501\n").await.unwrap();
        let mut length = 0;
        while length < 1399 {
            length += port.read(&mut buffer[length..]).await.unwrap();
        }
        let held = Instant::now();
        times.extend(written.try_iter());
        samples.push(held - times[samples.len()]);
    }
    samples
}

/// Plays a sensor on a thread of its own, and reports when it has written the last byte
/// of each scan. That byte is sent alone, after the rest was read.
fn serve_and_report(mut master: File) -> mpsc::Receiver<Instant> {
    let (report, written) = mpsc::channel();
    std::thread::spawn(move || {
        let (mut command, mut reply) = (Vec::new(), Vec::new());
        while terminal::read_command(&mut master, &mut command).is_some() {
            reply.clear();
            instant_sensor::reply(&command, &mut reply);
            let (last, rest) = reply.split_last().unwrap();
            master.write_all(rest).unwrap();
            std::thread::sleep(Duration::from_micros(300));
            let now = Instant::now();
            // The fence that opens the port does not count.
            if command.starts_with(b"G04") && report.send(now).is_err() {
                return;
            }
            if master.write_all(&[*last]).is_err() {
                return;
            }
        }
    });
    written
}
