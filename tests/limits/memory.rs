//! The heap memory of a driver, counted to the byte: with any input from its sensor, and
//! with hundreds of drivers together.

use std::time::Duration;

use crate::common::endless_port::EndlessPort;
use crate::common::instant_sensor::InstantSensor;
use crate::common::{ConnectFn, builder};
use allocation_counter::{AllocationInfo, measure};
use futures::StreamExt;
use tokio::runtime::Runtime;
use tokio_scip::port::Connect;
use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::{Emulator, Fixed, Pace};

/// Limit for one sensor, including its task and streams.
const LIMIT: u64 = 32 * 1024;
/// Limit for a sensor in service, with its scans in the usual window and a peer in memory,
/// which takes 2 KiB.
const SERVICE_LIMIT: u64 = 13 * 1024;

fn runtime() -> Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap()
}

fn sensor() -> Emulator {
    Emulator::builder().world(Fixed::filled(1234)).pace(Pace::AtOnce).log_capacity(0).build()
}

/// Measures the heap use of the driver alone over some time.
fn driving<C: Connect>(runtime: &Runtime, connect: C) -> AllocationInfo {
    measure(|| {
        runtime.block_on(async {
            let (sensor, driver) = builder().wait_for_sensor(true).build(connect);
            let driver = tokio::spawn(driver);
            let stream = sensor.scans(Window::FULL, Rate::hz(10.0)).await.unwrap();
            let end = tokio::time::sleep(Duration::from_secs(10));
            stream.take_until(end).for_each(async |item| drop(item)).await;
            sensor.close().await;
            drop(sensor);
            driver.await.unwrap().unwrap();
        });
    })
}

#[test]
fn w19_a_driver_takes_32_kib_at_most() {
    for fast in [true, false] {
        for pattern in [
            &b"x"[..],
            b"\n",
            b"\0",
            b"x\n",
            b"\n\nx",
            b"V\n0\n",
            b"V\n0\nSERI:x\n\n",
            b"G00000001\n0\n00\n\n",
            b"G00076801\n0\nCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCCC",
        ] {
            let runtime = runtime();
            let connect = ConnectFn(move || {
                Ok(if fast { EndlessPort::new(pattern) } else { EndlessPort::slow(pattern) })
            });
            let info = driving(&runtime, connect);
            let text = pattern.escape_ascii();
            println!("{text} for ever, fast: {fast}: {} bytes at the most", info.bytes_max);
            assert!(info.bytes_max <= LIMIT, "{text}, fast: {fast}: {info:?}");
        }
    }
}

#[test]
fn a14_hundreds_of_sensors_need_no_thread() {
    const SENSORS: u64 = 500;
    let runtime = runtime();
    let info = measure(|| {
        runtime.block_on(async {
            let mut streams = Vec::new();
            for _ in 0..SENSORS {
                let emulator = sensor();
                let sensor = builder().connect(emulator).await.unwrap();
                streams.push(sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap());
            }
            for _ in 0..5 {
                for stream in &mut streams {
                    stream.next().await.unwrap().unwrap();
                }
            }
        });
    });
    let each = info.bytes_max / SENSORS;
    println!("{each} bytes for each of {SENSORS} sensors, the emulated sensor included");
    assert!(each <= LIMIT, "{each}");
}

#[test]
fn a_sensor_in_service_takes_13_kib() {
    const SENSORS: u64 = 100;
    let runtime = runtime();
    let mut service = Vec::new();
    let info = measure(|| {
        runtime.block_on(async {
            for _ in 0..SENSORS {
                let sensor = Sensor::builder().attach(InstantSensor::new()).await.unwrap();
                let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
                // The consumer is a task of its own, as in a service.
                let consuming = tokio::spawn(async move {
                    for _ in 0..20 {
                        stream.next().await.unwrap().unwrap();
                    }
                    stream
                });
                service.push((sensor, consuming));
            }
            tokio::time::sleep(Duration::from_secs(1)).await;
        });
    });
    let each = info.bytes_current as u64 / SENSORS;
    println!("{each} bytes for each of {SENSORS} sensors, the peer included");
    assert!(each <= SERVICE_LIMIT, "{each}");
}

/// Blocks that are freed late, such as those of tokio's timers, may make a difference of a few
/// bytes.
const REST: i64 = 1024;

#[test]
fn a_thousand_replugs_leak_no_heap() {
    let runtime = runtime();
    let emulator = sensor();
    let opened = runtime.block_on(builder().connect(emulator.clone())).unwrap();
    let mut kept =
        runtime.block_on(opened.scans(Window::DETECTION, Rate::hz(10.0)).into_future()).unwrap();
    let mut replug = |times: u32| {
        measure(|| {
            runtime.block_on(async {
                for _ in 0..times {
                    let other = opened.clone();
                    let mut passing = other.scans(Window::FULL, Rate::hz(5.0)).await.unwrap();
                    while passing.next().await.unwrap().is_err() {}
                    emulator.unplug();
                    while kept.next().await.unwrap().is_ok() {}
                    emulator.plug_in();
                    while kept.next().await.unwrap().is_err() {}
                }
            });
        })
    };
    // Lists and tables reach the size that they keep.
    replug(100);
    let rest = replug(1000).bytes_current;
    assert!(rest.abs() <= REST, "{rest} bytes more than before");
    assert!(opened.stats().reconnects >= 1_100, "{:?}", opened.stats());
}

#[test]
fn abandoned_requests_leave_the_queue_before_they_expire() {
    let runtime = runtime();
    let emulator = sensor();
    emulator.unplug();
    let builder = builder().wait_for_sensor(true).request_timeout(Duration::from_secs(3600));
    let (sensor, driver) = builder.build(emulator);
    let _driver = runtime.spawn(driver);
    let waiting = measure(|| {
        runtime.block_on(async {
            for _ in 0..10_000 {
                // The driver takes it before it is dropped.
                tokio::select! {
                    biased;
                    _ = async { sensor.scan(Window::FULL).await } => panic!("an answer"),
                    () = tokio::task::yield_now() => {}
                }
            }
        });
    });
    assert!(waiting.bytes_current < 128 * 1024, "{waiting:?}");
}
