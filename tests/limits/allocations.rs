//! The heap allocations of a scan, from the port to its consumers. The sensor here answers
//! from memory and does not allocate.

use crate::common::instant_sensor::InstantSensor;
use tokio::runtime::{Builder, Runtime};
use tokio_scip::{Rate, ScanStream, Sensor, Window};

/// Makes a runtime on this thread, where allocations are counted.
fn runtime() -> Runtime {
    Builder::new_current_thread().enable_time().start_paused(true).build().unwrap()
}

/// Opens a sensor and a stream at `rate` with copies of it, and lets them run until all
/// buffers have their final size.
async fn open(rate: Rate, subscribers: usize) -> (Sensor, Vec<ScanStream>) {
    let sensor = Sensor::builder().attach(InstantSensor::new()).await.unwrap();
    let stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
    let mut streams = vec![stream; subscribers];
    take(&mut streams, 200).await;
    (sensor, streams)
}

/// Takes `scans` scans from each stream.
async fn take(streams: &mut [ScanStream], scans: usize) {
    for _ in 0..scans {
        for stream in &mut *streams {
            stream.next().await.unwrap().unwrap();
        }
    }
}

/// Counts allocations and scans while each subscriber takes 200 scans. The cost of entering
/// the runtime is subtracted by a run in which each takes one scan.
fn allocations(rate: Rate, subscribers: usize) -> (u64, u64) {
    let runtime = runtime();
    let (sensor, mut streams) = runtime.block_on(open(rate, subscribers));
    let mut count = |each| {
        let before = sensor.stats().scans;
        let counted = allocation_counter::measure(|| runtime.block_on(take(&mut streams, each)));
        (counted.count_total, sensor.stats().scans - before)
    };
    let (one, many) = (count(1), count(201));
    (many.0 - one.0, many.1 - one.1)
}

#[test]
fn a_scan_costs_one_allocation() {
    assert_eq!(allocations(Rate::hz(10.0), 1), (200, 200));
}

#[test]
fn a_scan_at_the_highest_rate_costs_one_allocation() {
    let (allocations, scans) = allocations(Rate::UNLIMITED, 1);
    assert!(scans >= 200);
    assert_eq!(allocations, scans);
}

#[test]
fn subscribers_cost_no_allocation() {
    assert_eq!(allocations(Rate::hz(10.0), 50), (200, 200));
}

#[test]
fn the_counter_counts() {
    let counted = allocation_counter::measure(|| drop(std::hint::black_box(vec![0; 1000])));
    assert_eq!(counted.count_total, 1);
}
