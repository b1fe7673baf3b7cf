//! Many UST-10LX at 40 Hz over TCP, read by one thread: scans, those that were lost, share of a core.
//! The sensors are emulated in another process. `cargo bench --bench ethernet -- 32 60` measures 32 of
//! them for 60 s; with `taskset -c 0` in front of it both processes share one core.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;

use support::cpu_time;
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};
use tokio_scip::{Rate, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, Model};

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;
#[path = "support/mod.rs"]
mod support;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let numbers: Vec<u64> = arguments.iter().filter_map(|text| text.parse().ok()).collect();
    let sensors = numbers.first().map_or(32, |sensors| *sensors as usize);
    let span = Duration::from_secs(numbers.get(1).copied().unwrap_or(10));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    match &arguments[..] {
        [serve, ..] if serve == "serve" => runtime.block_on(emulate(sensors)),
        _ => runtime.block_on(measure(sensors, span)),
    }
}

/// Prints the port of each sensor, and emulates them until the process is killed.
async fn emulate(sensors: usize) {
    let mut serving = JoinSet::new();
    for seed in 0..sensors as u64 {
        let emulator = Emulator::builder().model(Model::Ust10lx).seed(seed).build();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        println!("{}", listener.local_addr().unwrap());
        serving.spawn(async move { emulator.serve_tcp(listener).await });
    }
    serving.join_all().await;
}

async fn measure(sensors: usize, span: Duration) {
    let mut emulators = Command::new(std::env::current_exe().unwrap())
        .args(["serve", &sensors.to_string()])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(emulators.stdout.take().unwrap()).lines();
    let opening: JoinSet<Sensor> = lines.take(sensors).map(|line| open(line.unwrap())).collect();
    let mut reading = JoinSet::new();
    for sensor in opening.join_all().await {
        let scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED);
        let stream = scans.depth(64).await.unwrap();
        reading.spawn(read(sensor, stream, span));
    }
    sleep(Duration::from_secs(1)).await;
    let (start, cpu) = (Instant::now(), cpu_time());
    sleep(span).await;
    let share = (cpu_time() - cpu).as_secs_f64() / start.elapsed().as_secs_f64();
    let counts = reading.join_all().await;
    emulators.kill().unwrap();
    emulators.wait().unwrap();
    let [scans, lost] = [0, 1].map(|at| counts.iter().map(|count| count[at]).sum::<u64>());
    println!(
        "{sensors} sensors, {} s: {scans} scans, {lost} lost, {:.1} % of a core, {:.1} us a scan",
        span.as_secs(),
        100.0 * share,
        1e6 * share * span.as_secs_f64() / scans as f64,
    );
    assert_eq!(lost, 0, "a scan was lost");
}

async fn open(address: String) -> Sensor {
    Sensor::open(format!("tcp://{address}")).await.unwrap()
}

/// Reads scans from the second second on. Returns their number, and how many were lost or missed.
async fn read(sensor: Sensor, mut stream: ScanStream, span: Duration) -> [u64; 2] {
    let begin = Instant::now() + Duration::from_secs(1);
    let (mut scans, mut before) = (0, None);
    loop {
        let scan = stream.next().await.unwrap().unwrap();
        let at = scan.received_at();
        if at < begin {
            continue;
        }
        let known = || sensor.stats().lost + stream.missed();
        let before = *before.get_or_insert_with(known);
        if at >= begin + span {
            return [scans, known() - before];
        }
        scans += 1;
    }
}
