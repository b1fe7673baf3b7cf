//! The growth of the cost of scans: with the points of a window, the rate, the streams of one
//! sensor, the consumers of one stream, and the sensors. The peer answers at once from
//! memory, so that little is measured but the driver. The clock is paused: each row does
//! a known amount of work as fast as it can.
//!
//! `cargo bench --bench growth` prints a table for each quantity. `-- sensors 1000` runs
//! one load a single time, for `valgrind --cache-sim=yes`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::time::Duration;

use instant_sensor::InstantSensor;
use support::{cpu_time, median, us};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, sleep_until};
use tokio_scip::{Rate, ScanStream, Sensor, Window};

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;
#[path = "support/mod.rs"]
mod support;

/// Runs of each row. The median counts.
const ROUNDS: usize = 5;
/// Scans that a row delivers at least, over all its consumers.
const SCANS: u64 = 20_000;
const HZ: f64 = 10.0;

/// Load of one row.
#[derive(Debug, Clone, Copy)]
struct Load {
    sensors: u64,
    /// Streams of each sensor, each with a window of its own and so with polls of its own.
    streams: u64,
    /// Consumers of each stream, which share its polls.
    consumers: u64,
    points: u16,
    rate: f64,
}

const USUAL: Load = Load { sensors: 1, streams: 1, consumers: 1, points: 682, rate: HZ };

impl Load {
    /// Scans that consumers get in a second of the paused clock.
    fn per_second(self) -> f64 {
        (self.sensors * self.streams * self.consumers) as f64 * self.rate
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if let [name, count] = &arguments[..] {
        assert_eq!(name, "sensors");
        let load = Load { sensors: count.parse().unwrap(), ..USUAL };
        return println!("{:.2} us/poll", us(cost(load)));
    }
    table(
        "points of a window",
        [1, 10, 100, 200, 400, 682].map(|points| (f64::from(points), Load { points, ..USUAL })),
    );
    table("rate in Hz", [1.0, 10.0, 100.0, 1000.0].map(|rate| (rate, Load { rate, ..USUAL })));
    table(
        "streams of a sensor, each polled",
        [1, 3, 10, 30, 100].map(|streams| {
            // Narrow windows, so that each stream has another one.
            (streams as f64, Load { streams, points: 100, rate: 1.0, ..USUAL })
        }),
    );
    table(
        "consumers of a stream",
        [1, 10, 100, 1000].map(|consumers| (consumers as f64, Load { consumers, ..USUAL })),
    );
    table(
        "sensors",
        [1, 10, 100, 1000, 5000].map(|sensors| (sensors as f64, Load { sensors, ..USUAL })),
    );
}

/// Prints a row for each load: the CPU time of a poll, of a scan that a consumer gets, and
/// of a second of the sensors' time, and that relative to the first row and its quantity.
fn table<const ROWS: usize>(name: &str, rows: [(f64, Load); ROWS]) {
    println!("\n{name}: us/poll  us/scan  ms/s of the sensors' time  growth");
    let mut first = None;
    for (quantity, load) in rows {
        let each = median((0..ROUNDS).map(|_| us(cost(load))));
        let second = each * load.per_second() / 1e3;
        let (quantity_0, second_0) = *first.get_or_insert((quantity, second));
        let growth = (second / second_0) / (quantity / quantity_0);
        let poll = each * load.consumers as f64;
        println!("{quantity:10} {poll:12.2} {each:8.3} {second:10.3} {growth:10.2}");
    }
}

/// Returns the CPU time for each scan that a consumer gets.
fn cost(load: Load) -> Duration {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    runtime.block_on(async {
        let (_sensors, mut consumers) = open(load).await;
        let span = Duration::from_secs_f64((SCANS as f64 / load.per_second()).max(2.0));
        let cpu = cpu_time();
        let end = Instant::now() + span;
        let mut tasks = JoinSet::new();
        for stream in consumers.drain(..) {
            tasks.spawn(consume(stream, end));
        }
        let scans: u64 = tasks.join_all().await.into_iter().sum();
        let expected = load.per_second() * span.as_secs_f64();
        assert!(scans as f64 >= 0.98 * expected, "{load:?}: {scans} of {expected}");
        (cpu_time() - cpu) / u32::try_from(scans).unwrap()
    })
}

/// Opens the sensors and their streams, spread over a period.
async fn open(load: Load) -> (Vec<Sensor>, Vec<ScanStream>) {
    let (mut sensors, mut streams) = (Vec::new(), Vec::new());
    let period = Duration::from_secs_f64(1.0 / load.rate);
    let start = Instant::now();
    for number in 0..load.sensors {
        sleep_until(start + period * number as u32 / load.sensors as u32).await;
        let sensor = Sensor::builder().attach(InstantSensor::new()).await.unwrap();
        for place in 0..load.streams {
            let first = 44 + place as u16;
            let window = Window::new(first..=first + load.points - 1).unwrap();
            let stream = sensor.scans(window, Rate::hz(load.rate)).await.unwrap();
            streams.extend((1..load.consumers).map(|_| stream.clone()));
            streams.push(stream);
        }
        sensors.push(sensor);
    }
    sleep(period * 3).await;
    (sensors, streams)
}

/// Counts the scans until `end`.
async fn consume(mut stream: ScanStream, end: Instant) -> u64 {
    let mut scans = 0;
    while let Ok(Some(scan)) = tokio::time::timeout_at(end, stream.next()).await {
        scan.unwrap();
        scans += 1;
    }
    scans
}
