//! Times of scans in a stream: they rest on the sensor's clock, which is fast or slow, and begins anew.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, sleep};
use tokio_scip::scan::StampQuality;
use tokio_scip::{ErrorKind, Rate, Scan, Window};
use urg_emulator::{Emulator, Fault, Faults, Model};

use super::{next, numbered, revolution};
use crate::common::random::{Random, seeds};
use crate::common::{builder, ms};

/// How much later a scan says that its first ray was than the emulator does, in milliseconds.
pub(super) fn lateness(emulator: &Emulator, scan: &Scan) -> f64 {
    let number = revolution(scan);
    let sent = emulator.sent_scans();
    let sent = sent.iter().rfind(|sent| sent.time.revolution as u32 == number).unwrap();
    let powered_at = sent.revolution_end - sent.time.at;
    let first_ray = powered_at + sent.time.at_step(scan.window().start().into());
    let found = scan.times().first_ray_at;
    let early = first_ray.saturating_duration_since(found).as_secs_f64();
    (found.saturating_duration_since(first_ray).as_secs_f64() - early) * 1e3
}

#[tokio::test(start_paused = true)]
async fn stamps_rest_on_the_sensors_clock() {
    // The clock begins anew after 10 s, and reads 24 bits of milliseconds.
    let wrap = Duration::from_millis(1 << 24);
    for (model, reads, faster) in [
        (Model::Ust10lx, Duration::ZERO, 0.002),
        (Model::Utm30lx, wrap - Duration::from_secs(10), -0.002),
        (Model::Urg04lxUg01, Duration::from_secs(1), 0.001),
    ] {
        let frame = Duration::from_millis(1);
        let emulator = numbered(model).clock(reads, faster).frame(frame).build();
        let sensor = builder().depth(2048).connect(emulator.clone()).await.unwrap();
        for rate in [Rate::UNLIMITED, Rate::hz(10.0)] {
            let mut stream = sensor.scans(Window::new(100..=400).unwrap(), rate).await.unwrap();
            let scan = next(&mut stream).await;
            let first = scan.times().quality;
            assert_eq!(first == StampQuality::Arrival, rate == Rate::UNLIMITED, "{model:?}");
            sleep(Duration::from_secs(10)).await;
            emulator.set_faults(Faults::none().rate(0.1, Fault::Late(Duration::from_millis(5))));
            let mut settled = 0;
            while settled < 100 {
                let scan = next(&mut stream).await;
                let late = lateness(&emulator, &scan);
                if scan.received_at().elapsed() < Duration::from_secs(1) {
                    settled += 1;
                    assert_eq!(scan.times().quality, StampQuality::SensorClock, "{model:?}");
                    // The timers of tokio's clock add up to a millisecond.
                    assert!(late.abs() < 1.0, "{model:?} at {rate}: {late} ms");
                }
            }
            emulator.set_faults(Faults::none());
            // Not of the sensor's clock, which is fast or slow.
            let nominal = scan.geometry().revolution().as_secs_f64();
            let motor = sensor.stats().motor.unwrap();
            assert!((motor.revolution.as_secs_f64() / nominal - 1.0).abs() < 2e-4, "{motor:?}");
            let drift = f64::from(motor.clock_drift_ppm.unwrap());
            assert!((drift - faster * 1e6).abs() < 50.0, "{motor:?}");
        }
    }
}

/// A UBG-04LX-F01 says 2,400 rpm, and turns in 28 ms. Of a slow stream, five of its revolutions last as
/// long as six that are a little too short.
#[tokio::test(start_paused = true)]
async fn a_motor_may_turn_at_another_speed_than_the_sensor_tells() {
    for (model, revolution, slow) in [
        (Model::Utm30lx, Duration::from_micros(28_010), Rate::hz(8.0)),
        (Model::Ust10lx, Duration::from_micros(22_300), Rate::hz(5.0)),
        (Model::Urg04lxUg01, Duration::from_micros(111_030), Rate::hz(1.0)),
    ] {
        for rate in [Rate::UNLIMITED, slow] {
            let emulator = numbered(model).revolution(revolution).build();
            let sensor = builder().depth(64).connect(emulator.clone()).await.unwrap();
            let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
            for count in 0..200 {
                let scan = next(&mut stream).await;
                if count < 50 {
                    continue;
                }
                assert_eq!(scan.times().quality, StampQuality::SensorClock, "{model:?} {rate}");
                let late = lateness(&emulator, &scan);
                assert!(late.abs() < 1.0, "{model:?} {rate} {late} ms");
                let found = scan.scan_time().as_secs_f64() / revolution.as_secs_f64();
                assert!((found - 1.0).abs() < 2e-3, "{model:?} {rate} {found}");
            }
            assert_eq!(sensor.stats().motor.unwrap().jumps, 0, "{model:?} {rate}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn stamps_rest_on_twenty_arrivals_first() {
    let sensor = builder().connect(numbered(Model::Ust10lx).build()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    for number in 0..30 {
        let quality = next(&mut stream).await.times().quality;
        assert_eq!(quality == StampQuality::SensorClock, number >= 20, "{number}");
    }
}

/// Between two streams such a motor turns six times in what seem seven revolutions.
#[tokio::test(start_paused = true)]
async fn short_streams_do_not_hide_the_speed_of_the_motor() {
    let revolution = Duration::from_micros(110_300);
    for pause in (200..1200).step_by(100).map(Duration::from_millis) {
        let emulator = numbered(Model::Urg04lxUg01).revolution(revolution).build();
        let sensor = builder().depth(64).connect(emulator.clone()).await.unwrap();
        for scans in [1; 10].into_iter().chain([2; 10]).chain([60]) {
            let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
            for count in 1..=scans {
                let scan = next(&mut stream).await;
                if scan.times().quality == StampQuality::SensorClock {
                    let late = lateness(&emulator, &scan);
                    assert!(late.abs() < 2.0, "{pause:?}: {late} ms");
                }
                if count == 60 {
                    let found = scan.scan_time().as_secs_f64() / revolution.as_secs_f64();
                    assert!((found - 1.0).abs() < 2e-3, "{pause:?}: {found}");
                }
            }
            drop(stream);
            sleep(pause).await;
        }
    }
}

#[tokio::test(start_paused = true)]
async fn t15_a_scan_after_a_cut_one_has_its_own_time() {
    let emulator = numbered(Model::Utm30lx).build();
    let sensor = builder().depth(64).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    // Without its end it runs into the next scan.
    emulator.set_faults(Faults::none().at(1, Fault::Cut(10)));
    for _ in 0..5 {
        let scan = next(&mut stream).await;
        let late = lateness(&emulator, &scan);
        // A scan takes 10 ms on USB.
        assert!((0.0..10.5).contains(&late), "{late} ms");
    }
}

#[tokio::test(start_paused = true)]
async fn a_scan_after_a_damaged_answer_has_its_own_time() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().depth(64).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    emulator.set_faults(Faults::none().on("QT", Fault::Status(b'z')));
    let error = sensor.laser_off().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Malformed { .. }), "{error}");
    for _ in 0..5 {
        let scan = next(&mut stream).await;
        let late = lateness(&emulator, &scan);
        assert!((0.0..1.5).contains(&late), "{late} ms");
    }
}

#[tokio::test(start_paused = true)]
async fn stamps_after_a_pause_are_right() {
    for (model, faster) in
        [(Model::Ust10lx, 0.002), (Model::Utm30lx, -0.002), (Model::Utm30lx, 1e-3)]
    {
        // Too short to learn the clock's rate, or to learn it well enough for the pause.
        for counts in [[30, 60, 30], [80, 100, 120], [150, 200, 250]] {
            let emulator = numbered(model).clock(Duration::ZERO, faster).build();
            let sensor = builder().depth(64).connect(emulator.clone()).await.unwrap();
            for count in counts {
                let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
                let mut stamped = 0;
                for _ in 0..count {
                    let scan = next(&mut stream).await;
                    if scan.times().quality == StampQuality::SensorClock {
                        let late = lateness(&emulator, &scan);
                        assert!(late.abs() < 1.5, "{model:?} {late} ms");
                        stamped += 1;
                    }
                }
                assert_eq!(stamped, count - 20, "{model:?}");
                drop(stream);
                sleep(Duration::from_secs(20)).await;
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn d15_a_sensor_that_restarted_between_two_streams_has_a_new_clock() {
    let emulator = numbered(Model::Utm30lx).build();
    let sensor = builder().depth(64).connect(emulator.clone()).await.unwrap();
    for _ in 0..2 {
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        for _ in 0..400 {
            let Ok(scan) = stream.next().await.unwrap() else { continue };
            assert!(lateness(&emulator, &scan).abs() < 11.0, "{scan:?}");
        }
        drop(stream);
        // Its clock reads the same when the next stream begins.
        sleep(Duration::from_secs(20)).await;
        emulator.power_cycle();
        sleep(Duration::from_millis(10_025)).await;
    }
}

/// During a pause the clock may drift by any amount, which does not count as a jump.
#[tokio::test(start_paused = true)]
async fn only_jumps_of_the_clock_are_counted() {
    for seed in seeds("SCIP_JUMPS", 6) {
        let mut random = Random::new(seed);
        let (model, least) = *random.pick(&[(Model::Ust10lx, 2000), (Model::Urg04lxUg01, 5000)]);
        let faster = (random.below(4001) as f64 - 2000.0) / 1e6;
        let reads = ms(random.below(1 << 24));
        let emulator = numbered(model).clock(reads, faster).frame(ms(1)).build();
        let sensor = builder().idle_probe(None).connect(emulator.clone()).await.unwrap();
        let (window, mut jumps) = (Window::new(384..=384).unwrap(), 0);
        for _ in 0..6 {
            let mut stream = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
            let end = Instant::now() + ms(least) + random.ms(10_000);
            while Instant::now() < end {
                next(&mut stream).await;
            }
            let motor = sensor.stats().motor.unwrap();
            assert_eq!(motor.jumps, jumps, "seed {seed}: {motor:?}");
            drop(stream);
            // Up to three turns of the clock.
            let longest = 10_u64.pow(random.below(5) as u32 + 3) / 2;
            let pause = random.below(longest);
            sleep(ms(pause)).await;
            if random.once_in(4) {
                // More than the clock can have drifted.
                let by = 100 + least as i64 + pause as i64 / 50;
                emulator.jump_clock(if random.once_in(2) { by } else { -by });
                jumps += 1;
            }
        }
    }
}

/// A sensor may take all of a revolution to send a scan: faster than RS-232, its line is not full.
#[tokio::test(start_paused = true)]
async fn a_sensor_that_sends_all_the_time_keeps_its_clock() {
    let emulator = numbered(Model::Ust10lx).build();
    let (near, far) = tokio::io::duplex(1 << 16);
    let (mut from_sensor, mut to_sensor) = tokio::io::split(emulator.link());
    let (mut from_driver, mut to_driver) = tokio::io::split(far);
    tokio::spawn(async move { tokio::io::copy(&mut from_driver, &mut to_sensor).await });
    tokio::spawn(async move {
        // 24 pieces of a scan.
        let mut piece = [0; 145];
        while let Ok(length @ 1..) = from_sensor.read(&mut piece).await {
            sleep(ms(1)).await;
            to_driver.write_all(&piece[..length]).await.unwrap();
        }
    });
    let sensor = builder().depth(64).attach(near).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    for number in 0..80 {
        let times = next(&mut stream).await.times();
        assert!(number < 30 || times.quality == StampQuality::SensorClock, "{number}: {times:?}");
    }
}
