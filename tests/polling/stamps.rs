//! The times of scans against the truth of the emulated sensor's motor.

use std::time::{Duration, SystemTime};

use tokio::time::Instant;
use tokio_scip::scan::StampQuality;
use tokio_scip::{BaudRate, Rate, Scan, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, EmulatorBuilder, Fault, Faults, Fixed, Pace};

use crate::common::hooked::{Hooked, Hooks};
use crate::common::{ConnectFn, builder, ms};

/// A sensor on its own USB port, with a motor a little faster than its firmware line says. The timers
/// of tokio's clock make its bytes arrive in whole milliseconds, as on USB.
fn turning() -> EmulatorBuilder {
    let revolution = Duration::from_micros(99_760);
    Emulator::builder().intact_usb().world(Fixed::filled(1234)).revolution(revolution)
}

async fn stream(emulator: &Emulator, rate: Rate) -> (Sensor, ScanStream) {
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let scans = sensor.scans(Window::DETECTION, rate).await.unwrap();
    (sensor, scans)
}

/// Errors of one scan in milliseconds: of its stamp, and of its arrival.
struct Errors {
    stamp: f64,
    arrival: f64,
}

/// Compares a scan with the motor of the sensor that has just sent it.
fn errors(emulator: &Emulator, scan: &Scan) -> Errors {
    let sent = emulator.sent_scans();
    let truth = sent.iter().find(|sent| sent.requested_at >= scan.times().requested_at).unwrap();
    // The window begins 172 steps after the rear.
    let turned = truth.revolution_end.duration_since(scan.times().first_ray_at).as_secs_f64();
    let since_first_ray = scan.scan_time().as_secs_f64() * (1.0 - 172.0 / 1024.0);
    let stamp = since_first_ray - turned;
    let lateness = scan.times().lateness.unwrap_or_default().as_secs_f64();
    let by_wall = scan.times().stamp.duration_since(scan.first_ray_stamp()).unwrap().as_secs_f64();
    assert!((by_wall - since_first_ray - lateness).abs() < 1e-6, "{by_wall} {scan:?}");
    Errors { stamp: stamp * 1e3, arrival: (stamp + lateness) * 1e3 }
}

/// Returns the errors of the next scans.
async fn next_errors(emulator: &Emulator, scans: &mut ScanStream, count: usize) -> Vec<Errors> {
    let mut found = Vec::with_capacity(count);
    for _ in 0..count {
        found.push(errors(emulator, &scans.next().await.unwrap().unwrap()));
    }
    found
}

fn worst(errors: &[Errors], of: fn(&Errors) -> f64) -> f64 {
    errors.iter().map(|errors| of(errors).abs()).fold(0.0, f64::max)
}

#[tokio::test(start_paused = true)]
async fn a_reply_begins_after_the_nul_of_a_break() {
    let emulator = Emulator::builder().pace(Pace::AtOnce).usb().world(Fixed::filled(1234)).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let broken = Faults::none().on("G", Fault::Insert(0, vec![0]));
    emulator.set_faults(broken.on("G", Fault::Pause(1, ms(30))));
    let scan = sensor.scan(Window::DETECTION).await.unwrap();
    // The first ray is 852 of 1,024 steps older than the first byte.
    let age = scan.received_at() - scan.times().first_ray_at;
    assert!((ms(83)..ms(88)).contains(&age), "{age:?}");
    assert!(scan.received_at() - scan.times().requested_at > ms(30));
}

#[tokio::test(start_paused = true)]
async fn stamps_rest_on_the_motor_and_its_period_is_measured() {
    for rate in [Rate::UNLIMITED, Rate::hz(10.0), Rate::hz(5.0)] {
        let emulator = turning().build();
        let (sensor, mut scans) = stream(&emulator, rate).await;
        let first = scans.next().await.unwrap().unwrap();
        assert_eq!(first.times().quality, StampQuality::Arrival);
        assert_eq!((first.times().lateness, first.scan_time()), (None, ms(100)));
        assert_eq!(sensor.stats().motor, None);
        next_errors(&emulator, &mut scans, 30).await;
        assert_eq!(scans.next().await.unwrap().unwrap().times().quality, StampQuality::Motor);
        next_errors(&emulator, &mut scans, 100).await;
        let later = next_errors(&emulator, &mut scans, 200).await;
        assert!(worst(&later, |errors| errors.stamp) < 0.6, "{rate}");
        assert!(worst(&later, |errors| errors.arrival) > 1.0, "{rate}");
        let scan = scans.next().await.unwrap().unwrap();
        let error = scan.scan_time().abs_diff(Duration::from_micros(99_760));
        assert!(error < Duration::from_micros(10), "{error:?}");
        let motor = sensor.stats().motor.unwrap();
        let rpm = 60.0 / motor.revolution.as_secs_f64();
        assert!((rpm - 601.44).abs() < 0.06, "{motor:?}");
        assert_eq!(motor.jumps, 0);
    }
}

#[tokio::test(start_paused = true)]
async fn stamps_rest_on_thirteen_arrivals_first() {
    for rate in [Rate::UNLIMITED, Rate::hz(10.0)] {
        let (_sensor, mut scans) = stream(&turning().build(), rate).await;
        for number in 0..20 {
            let motor = scans.next().await.unwrap().unwrap().times().quality == StampQuality::Motor;
            assert_eq!(motor, number >= 13, "{rate} {number}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn late_replies_do_not_move_the_stamps() {
    let emulator = turning().faults(Faults::none().up_to(0.2, Fault::Late(ms(30)))).build();
    let (_sensor, mut scans) = stream(&emulator, Rate::UNLIMITED).await;
    next_errors(&emulator, &mut scans, 1000).await;
    let later = next_errors(&emulator, &mut scans, 1000).await;
    assert!(worst(&later, |errors| errors.arrival) > 25.0);
    let mut stamps: Vec<_> = later.iter().map(|errors| errors.stamp.abs()).collect();
    stamps.sort_by(f64::total_cmp);
    assert!(stamps[990] < 0.6, "{}", stamps[990]);
}

#[tokio::test(start_paused = true)]
async fn stamps_recover_five_scans_after_a_jump() {
    let emulator = turning().build();
    let (sensor, mut scans) = stream(&emulator, Rate::hz(10.0)).await;
    next_errors(&emulator, &mut scans, 100).await;
    for (n, jump) in [3, 10, 37, 50, 72, 95].into_iter().enumerate() {
        emulator.delay_motor(ms(jump));
        next_errors(&emulator, &mut scans, 5).await;
        let later = next_errors(&emulator, &mut scans, 100).await;
        assert!(later.iter().all(|errors| errors.stamp <= errors.arrival.max(0.6)), "{jump}");
        assert!(worst(&later, |errors| errors.stamp) < 1.5, "{jump}");
        assert_eq!(sensor.stats().motor.unwrap().jumps, n as u64 + 1);
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_answers_at_once_has_stamps_of_arrival() {
    for (pace, rate) in [(Pace::AtOnce, Rate::UNLIMITED), (Pace::AtOnce, Rate::hz(10.0))] {
        let emulator = turning().pace(pace).build();
        let (sensor, mut scans) = stream(&emulator, rate).await;
        for _ in 0..400 {
            let scan = scans.next().await.unwrap().unwrap();
            assert_eq!(scan.times().quality, StampQuality::Arrival);
            assert_eq!(scan.scan_time(), ms(100));
        }
        assert_eq!(sensor.stats().motor, None);
    }
}

#[tokio::test(start_paused = true)]
async fn other_ports_have_stamps_of_arrival() {
    for emulator in [Emulator::builder().baud_rate(BaudRate::B115200), Emulator::builder()] {
        let emulator = emulator.build();
        let (sensor, mut scans) = match emulator.baud_rate() {
            Some(_) => {
                let sensor =
                    builder().baud_rate(BaudRate::B115200).connect(emulator).await.unwrap();
                let scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
                (sensor, scans)
            }
            None => stream(&emulator, Rate::UNLIMITED).await,
        };
        for _ in 0..100 {
            let scan = scans.next().await.unwrap().unwrap();
            assert_eq!(scan.times().quality, StampQuality::Arrival);
        }
        assert_eq!(sensor.stats().motor, None);
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_is_found_again_is_measured_anew() {
    let emulator = turning().build();
    let (sensor, mut scans) = stream(&emulator, Rate::UNLIMITED).await;
    next_errors(&emulator, &mut scans, 400).await;
    assert!(sensor.stats().motor.is_some());
    emulator.unplug();
    assert!(scans.next().await.unwrap().is_err());
    assert_eq!(sensor.stats().motor, None);
    emulator.plug_in();
    let scan = loop {
        if let Ok(scan) = scans.next().await.unwrap() {
            break scan;
        }
    };
    assert_eq!(scan.times().quality, StampQuality::Arrival);
    next_errors(&emulator, &mut scans, 400).await;
    assert_eq!(scans.next().await.unwrap().unwrap().times().quality, StampQuality::Motor);
}

/// A wall clock that is set forth and back by an hour, each time after some reads.
struct SetClock {
    began: Instant,
    reads: u32,
}

const HOUR: Duration = Duration::from_secs(3600);
const BEGAN: Duration = Duration::from_secs(1_700_000_000);

impl Hooks for SetClock {
    fn after_read(&mut self, count: usize) {
        self.reads += u32::from(count > 0);
    }

    fn wall_clock(&self) -> Option<SystemTime> {
        let set = HOUR * (self.reads / 37 % 2);
        Some(SystemTime::UNIX_EPOCH + BEGAN + self.began.elapsed() + set)
    }
}

#[tokio::test(start_paused = true)]
async fn setting_the_clock_gives_no_time_between() {
    let emulator = turning().build();
    let began = Instant::now();
    let port = move || Ok(Hooked { port: emulator.link(), hooks: SetClock { began, reads: 0 } });
    let sensor = builder().connect(ConnectFn(port)).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    let mut scans_by = [0, 0];
    for _ in 0..200 {
        let scan = scans.next().await.unwrap().unwrap();
        let by_wall = scan.first_ray_stamp().duration_since(SystemTime::UNIX_EPOCH).unwrap();
        let set = by_wall - BEGAN - (scan.times().first_ray_at - began);
        assert!(set == Duration::ZERO || set == HOUR, "{set:?}");
        scans_by[usize::from(set == HOUR)] += 1;
    }
    assert!(scans_by.iter().all(|scans| *scans > 20), "{scans_by:?}");
}
