//! The order of rays, with late replies at random: a scan never begins before the last ray of the scan
//! before it on the same link.
//!
//! `SCIP_LATE=1000 cargo test --release --test it ray_order:: -- --nocapture` draws 1,000 links;
//! `SCIP_LATE_FIRST=1000000` draws others.

use std::time::Duration;

use futures::FutureExt;
use tokio::time::{Instant, sleep};
use tokio_scip::{BaudRate, Rate, Scan, Window};
use urg_emulator::{Emulator, EmulatorBuilder, Fault, Faults, Fixed, Pace};

use crate::common::random::{Random, seeds};
use crate::common::{builder, ms};

fn draw_window(random: &mut Random) -> Window {
    let (a, b) = (random.below(769) as u16, random.below(769) as u16);
    let any = Window::new(a.min(b)..=a.max(b)).unwrap();
    let window = *random.pick(&[Window::FULL, Window::DETECTION, any]);
    window.with_cluster_count(1 + random.below(3) as u8).unwrap()
}

/// Returns the scans of these streams over 20 s, in the order of their polls.
async fn scans(emulator: EmulatorBuilder, streams: &[(Window, Rate)]) -> Vec<Scan> {
    let emulator = emulator.world(Fixed::filled(1234)).build();
    let mut building = builder();
    if let Some(baud_rate) = emulator.baud_rate() {
        building = building.baud_rate(baud_rate);
    }
    let sensor = building.connect(emulator).await.unwrap();
    let mut open = Vec::new();
    for (window, rate) in streams {
        open.push(sensor.scans(*window, *rate).depth(2000).await.unwrap());
    }
    sleep(ms(20_000)).await;
    let mut all = Vec::new();
    for mut stream in open {
        while let Some(Some(item)) = stream.next().now_or_never() {
            all.extend(item.ok());
        }
    }
    all.sort_by_key(|scan| scan.times().requested_at);
    // Equal streams share their polls.
    all.dedup_by_key(|scan| scan.times().requested_at);
    all
}

fn last_ray_at(scan: &Scan) -> Instant {
    scan.times().first_ray_at + scan.time_increment() * (scan.len() as u32 - 1)
}

/// Returns when the first ray was measured at the latest, if only this reply counts.
fn by_arrival(scan: &Scan) -> Instant {
    let turned = 0.5 - f64::from(scan.angle_min()) / std::f64::consts::TAU;
    scan.received_at() - scan.scan_time().mul_f64(turned) + Duration::from_micros(1)
}

#[tokio::test(start_paused = true)]
async fn scans_never_overlap() {
    for seed in seeds("SCIP_LATE", 60) {
        let random = &mut Random::new(seed);
        let longest = ms(*random.pick(&[0, 30, 95, 300]));
        let share = *random.pick(&[0.02, 0.2, 1.0]);
        let revolution = Duration::from_micros(99_600 + random.below(800));
        let emulator = Emulator::builder()
            .revolution(revolution)
            .faults(Faults::none().up_to(share, Fault::Late(longest)).seed(seed));
        let emulator = match random.below(4) {
            0 => emulator.intact_usb(),
            1 => emulator.usb(),
            2 => emulator.baud_rate(BaudRate::B750000),
            _ => emulator.baud_rate(BaudRate::B115200),
        };
        let mut streams = Vec::new();
        for _ in 0..1 + random.below(2) {
            let rates = [Rate::UNLIMITED, Rate::hz(10.0), Rate::hz(7.3), Rate::hz(5.0)];
            streams.push((draw_window(random), *random.pick(&rates)));
        }
        let scans = scans(emulator, &streams).await;
        assert!(scans.len() > 20, "{seed}: {}", scans.len());
        for pair in scans.windows(2) {
            let overlap =
                last_ray_at(&pair[0]).saturating_duration_since(pair[1].times().first_ray_at);
            assert_eq!(overlap, Duration::ZERO, "{seed}: {longest:?} {share} {streams:?}");
        }
        // A scan is no later than the late ones before it make it.
        for scan in &scans {
            assert!(scan.times().first_ray_at <= by_arrival(scan) + longest, "{seed}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn repeated_revolutions_do_not_delay_stamps() {
    let halves = [Window::new(384..=725).unwrap(), Window::new(44..=383).unwrap()];
    for streams in [
        vec![(Window::DETECTION, Rate::hz(50.0))],
        halves.map(|half| (half, Rate::hz(10.0))).into(),
    ] {
        let scans = scans(Emulator::builder().pace(Pace::AtOnce), &streams).await;
        // The driver has seen that they come faster than the motor turns.
        for scan in scans.iter().skip(10) {
            assert!(scan.times().first_ray_at <= by_arrival(scan), "{streams:?}");
        }
    }
}
