//! Scans a second and CPU time a scan, polled as fast as a sensor answers, on a
//! pseudo-terminal with the sensor in another process. It is compared with a floor, which
//! only writes a command and reads until the reply has ended.
//!
//! `cargo bench --bench round_trip` prints a table. With the arguments of one poller
//! (`floor`, `tokio`, `current` or `multi`) and one sensor (`instant` or `emulated`) it
//! runs only these, for `strace -cf`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::io::{Read, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use support::server::Server;
use support::{cpu_time, median, terminal, us};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;
use tokio_scip::{Rate, Sensor, Window};
use tokio_serial::SerialStream;
use urg_emulator::{Emulator, Fixed, Pace, Pty};

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;
#[path = "support/mod.rs"]
mod support;

const ROUNDS: usize = 15;

/// Sensors in the other process, and the number of polls in a round.
const SENSORS: [(&str, usize); 2] = [("instant", 8_000), ("emulated", 200)];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["serve", sensor] => serve(sensor),
        [poller, sensor] => {
            let (_, polls) = SENSORS.into_iter().find(|(name, _)| *name == sensor).unwrap();
            let server = Server::start(sensor);
            println!("{poller}: {:?}", poll(poller, &server.path, polls));
        }
        _ => table(),
    }
}

fn table() {
    println!("sensor    poller   scans/s  of floor  CPU us/scan  of floor");
    for (sensor, polls) in SENSORS {
        let server = Server::start(sensor);
        let pollers = ["floor", "tokio", "current", "multi"];
        // They run side by side in each round: a load that disturbs one disturbs all.
        let rounds: Vec<[RoundTripCost; 4]> =
            (0..ROUNDS).map(|_| pollers.map(|poller| poll(poller, &server.path, polls))).collect();
        for (index, poller) in pollers.into_iter().enumerate() {
            let of = |figure: fn(&RoundTripCost) -> f64| {
                median(rounds.iter().map(|r| figure(&r[index])))
            };
            let to_floor = |figure: fn(&RoundTripCost) -> f64| {
                median(rounds.iter().map(|r| figure(&r[index]) / figure(&r[0])))
            };
            println!(
                "{sensor:9} {poller:8} {:7.0}  {:8.2}  {:11.1}  {:8.2}",
                of(RoundTripCost::rate),
                to_floor(RoundTripCost::rate),
                of(RoundTripCost::cpu),
                to_floor(RoundTripCost::cpu),
            );
        }
    }
}

/// Time and CPU time of a number of scans.
#[derive(Debug)]
struct RoundTripCost {
    scans: usize,
    time: Duration,
    cpu: Duration,
}

impl RoundTripCost {
    fn rate(&self) -> f64 {
        self.scans as f64 / self.time.as_secs_f64()
    }

    /// Returns microseconds of CPU time a scan.
    fn cpu(&self) -> f64 {
        us(self.cpu) / self.scans as f64
    }
}

fn poll(poller: &str, path: &Path, scans: usize) -> RoundTripCost {
    match poller {
        "floor" => floor(path, scans),
        "tokio" => tokio(path, scans),
        "current" => {
            driver(Builder::new_current_thread().enable_all().build().unwrap(), path, scans)
        }
        "multi" => driver(Builder::new_multi_thread().enable_all().build().unwrap(), path, scans),
        _ => panic!("{poller}: use floor, tokio, current or multi"),
    }
}

/// Polls with one write and as few reads as possible, without decoding.
fn floor(path: &Path, scans: usize) -> RoundTripCost {
    let mut port = terminal::open(path);
    let mut buffer = [0; 4096];
    let mut scan = || {
        port.write_all(b"G04472501\n").unwrap();
        let mut length = 0;
        while !buffer[..length].ends_with(b"\n\n") {
            length += port.read(&mut buffer[length..]).unwrap();
        }
        assert_eq!(length, 1399);
    };
    scan();
    let (start, cpu) = (Instant::now(), cpu_time());
    (0..scans).for_each(|_| scan());
    RoundTripCost { scans, time: start.elapsed(), cpu: cpu_time() - cpu }
}

/// Does the same on tokio: a port of tokio-serial, a deadline for each read, no decoding,
/// one task.
fn tokio(path: &Path, scans: usize) -> RoundTripCost {
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    let path = path.to_str().unwrap().to_owned();
    let polling = runtime.spawn(async move {
        let mut port = SerialStream::open(&tokio_serial::new(path, 19_200)).unwrap();
        let mut buffer = [0; 4096];
        let mut scan = async || {
            AsyncWriteExt::write_all(&mut port, b"G04472501\n").await.unwrap();
            let mut length = 0;
            while !buffer[..length].ends_with(b"\n\n") {
                let read = AsyncReadExt::read(&mut port, &mut buffer[length..]);
                length += timeout(Duration::from_millis(500), read).await.unwrap().unwrap();
            }
            assert_eq!(length, 1399);
        };
        scan().await;
        let (start, cpu) = (Instant::now(), cpu_time());
        for _ in 0..scans {
            scan().await;
        }
        RoundTripCost { scans, time: start.elapsed(), cpu: cpu_time() - cpu }
    });
    runtime.block_on(polling).unwrap()
}

/// Polls through the driver, with the consumer in a task of its own. Scans that the
/// consumer missed count too: on another thread it may be too slow to see each of them.
fn driver(runtime: Runtime, path: &Path, polls: usize) -> RoundTripCost {
    let path = path.to_str().unwrap().to_owned();
    let polling = runtime.spawn(async move {
        let sensor = Sensor::open(path).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let mut next = async || stream.next().await.unwrap().unwrap().sequence();
        let before = next().await;
        let (start, cpu) = (Instant::now(), cpu_time());
        let mut scans = 0;
        while scans < polls {
            scans = (next().await - before) as usize;
        }
        let cost = RoundTripCost { scans, time: start.elapsed(), cpu: cpu_time() - cpu };
        sensor.close().await;
        cost
    });
    runtime.block_on(polling).unwrap()
}

/// Plays the sensor, and prints the path of its pseudo-terminal.
fn serve(sensor: &str) {
    if sensor == "instant" {
        let terminal = terminal::Terminal::open();
        println!("{}", terminal.path.display());
        terminal::serve(terminal.master);
        return;
    }
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let world = Fixed::filled(1234);
        let emulator = Emulator::builder().world(world).pace(Pace::AtOnce).build();
        let pty = Pty::open(&emulator, None).unwrap();
        println!("{}", pty.path().display());
        pty.serve().await.unwrap();
    });
}
