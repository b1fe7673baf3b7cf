//! Many sensors at 10 Hz in one process: share of a core, lateness of polls, heap for each
//! sensor. It measures emulated sensors on in-memory links, whose work counts too, and a peer
//! that answers from memory, so that little is measured but the driver.
//!
//! The runtime has one thread. `cargo bench --bench many -- emulated 8000` measures one
//! row, `-- instant 10000 2` one with a runtime of two threads.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

use instant_sensor::InstantSensor;
use support::{cpu_time, percentile};
use tokio::task::JoinSet;
use tokio::time::{sleep, sleep_until};
use tokio_scip::{Rate, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, Fixed, Pace};

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;
#[path = "support/mod.rs"]
mod support;

const PERIOD: Duration = Duration::from_millis(100);
const SPAN: Duration = Duration::from_secs(10);

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    println!("sensor   sensors  scans/s  core %  us/scan  late 50 %  late 99 %  heap KiB each");
    if let [kind, sensors, threads @ ..] = &arguments[..] {
        let threads = threads.first().map_or(1, |threads| threads.parse().unwrap());
        return row(kind, sensors.parse().unwrap(), threads);
    }
    for kind in ["emulated", "instant"] {
        for sensors in [10, 100, 1000, 5000] {
            row(kind, sensors, 1);
        }
    }
    row("instant", 10_000, 2);
}

/// Lateness of each poll, while it is recorded.
type BenchLateness = Arc<Mutex<Option<Vec<Duration>>>>;

fn row(kind: &str, sensors: usize, threads: usize) {
    let mut runtime = match threads {
        1 => tokio::runtime::Builder::new_current_thread(),
        _ => tokio::runtime::Builder::new_multi_thread(),
    };
    let runtime = runtime.worker_threads(threads).enable_all().build().unwrap();
    let late = Vec::with_capacity(sensors * 150);
    let lateness: BenchLateness = Arc::default();
    let mut time = (Duration::ZERO, Duration::ZERO);
    let counted = allocation_counter::measure(|| {
        runtime.block_on(open(kind, sensors, &lateness));
        *lateness.lock().unwrap() = Some(late);
        time = runtime.block_on(async {
            let (start, cpu) = (Instant::now(), cpu_time());
            sleep(SPAN).await;
            (start.elapsed(), cpu_time() - cpu)
        });
    });
    let mut late = lateness.lock().unwrap().take().unwrap();
    let ((elapsed, cpu), scans) = (time, late.len());
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let heap = match threads {
        1 => format!("{:.1}", counted.bytes_current as f64 / 1024.0 / sensors as f64),
        // Counted is what the thread of this function allocates.
        _ => "-".to_owned(),
    };
    println!(
        "{kind:8} {sensors:7} {:8.0} {:7.1} {:8.1} {:7.2} ms {:7.2} ms {heap:>14}",
        scans as f64 / elapsed.as_secs_f64(),
        100.0 * cpu.as_secs_f64() / elapsed.as_secs_f64(),
        1e6 * cpu.as_secs_f64() / scans as f64,
        ms(percentile(&mut late, 0.5)),
        ms(percentile(&mut late, 0.99)),
    );
}

/// Opens the sensors, spreads them over the period, and spawns a task for each that
/// consumes its scans.
async fn open(kind: &str, sensors: usize, lateness: &BenchLateness) {
    let opening: JoinSet<Sensor> = (0..sensors).map(|_| sensor(kind.to_owned())).collect();
    let opened = opening.join_all().await;
    let start = tokio::time::Instant::now();
    for (place, sensor) in (0..).zip(opened) {
        sleep_until(start + PERIOD * place / sensors as u32).await;
        let asked = Instant::now();
        let stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        tokio::spawn(consume(stream, asked, Arc::clone(lateness)));
    }
    sleep(PERIOD * 10).await;
}

async fn sensor(kind: String) -> Sensor {
    if kind == "instant" {
        return Sensor::builder().attach(InstantSensor::new()).await.unwrap();
    }
    let world = Fixed::filled(1234);
    let emulator = Emulator::builder().world(world).pace(Pace::AtOnce).build();
    Sensor::builder().connect(emulator).await.unwrap()
}

/// Records the lateness of each poll. The first one was due just after `start`.
async fn consume(mut stream: ScanStream, start: Instant, lateness: BenchLateness) {
    while let Some(scan) = stream.next().await {
        let since = scan.unwrap().times().requested_at - start;
        let late = Duration::from_nanos((since.as_nanos() % PERIOD.as_nanos()) as u64);
        if let Some(lateness) = &mut *lateness.lock().unwrap() {
            lateness.push(late);
        }
    }
}
