//! How far `ScanTimes::first_ray_at` and the arrival of each scan are from the truth: the moment at
//! which the emulated motor ended the revolution, not when the emulated sensor wrote its reply.
//! `-- busy [PROCESSES]` measures in real time, beside this number of processes that only compute.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::process::{Child, Command};
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::scan::StampQuality;
use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_emulator::{Emulator, EmulatorBuilder, Fault, Faults, Fixed};

const HOUR: Duration = Duration::from_secs(3600);
const REAL_TIME: Duration = Duration::from_secs(120);
/// Part of a revolution between the first ray of the window and the rear.
const TURNED: f64 = 1.0 - (128.0 + 44.0) / 1024.0;

fn main() {
    println!("{:38} {:>8} {:>7}  {:22}  {:22}", "", "scans", "motor", "stamp", "arrival");
    println!("{:38} {:>8} {:>7}  {:22}  {:22}", "", "", "", "p50, p99, max in ms", "same");
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if let [busy, processes @ ..] = &arguments[..]
        && busy == "busy"
    {
        let processes = processes.first().map_or(0, |processes| processes.parse().unwrap());
        return in_real_time(processes);
    }
    simulated("on USB, an hour", turning(), Rate::UNLIMITED, HOUR, 0);
    simulated("polled at 10 Hz, an hour", turning(), Rate::hz(10.0), HOUR, 0);
    let late =
        || turning().faults(Faults::none().up_to(0.2, Fault::Late(Duration::from_millis(30))));
    simulated("20 % late by up to 30 ms, an hour", late(), Rate::UNLIMITED, HOUR, 0);
    simulated("5 Hz, an hour", turning(), Rate::hz(5.0), HOUR, 0);
    let drifting = turning().drift(0.001);
    simulated("drift 0.1 % an hour, 50 jumps, an hour", drifting, Rate::UNLIMITED, HOUR, 50);
}

/// Emulates a sensor whose motor turns as fast as in the capture. tokio's timers deliver its bytes
/// in whole milliseconds, as USB does.
fn turning() -> EmulatorBuilder {
    let revolution = Duration::from_nanos(99_760_500);
    Emulator::builder()
        .intact_usb()
        .world(Fixed::filled(1234))
        .revolution(revolution)
        .log_capacity(4)
}

/// What was found about all scans of a row.
#[derive(Default)]
struct StampRow {
    stamps: Vec<Duration>,
    arrivals: Vec<Duration>,
    by_motor: usize,
    /// Scans since the latest jump whose stamps were worse than their arrivals, and the
    /// largest number of them after any jump.
    worse: usize,
    most_worse: usize,
    later: usize,
}

impl StampRow {
    fn add(&mut self, emulator: &Emulator, scan: &Scan) {
        let sent = emulator.sent_scans();
        let truth =
            sent.iter().find(|sent| sent.requested_at >= scan.times().requested_at).unwrap();
        let turned = scan.scan_time().mul_f64(TURNED);
        let (end, late) =
            (scan.times().first_ray_at + turned, scan.times().lateness.unwrap_or_default());
        let arrived = end + late;
        let error = |at: Instant| match at >= truth.revolution_end {
            true => at - truth.revolution_end,
            false => truth.revolution_end - at,
        };
        self.stamps.push(error(end));
        self.arrivals.push(error(arrived));
        self.later += usize::from(end > arrived);
        self.by_motor += usize::from(scan.times().quality == StampQuality::Motor);
        self.worse += usize::from(error(end) > error(arrived) + Duration::from_micros(500));
        self.most_worse = self.most_worse.max(self.worse);
    }

    fn print(mut self, name: &str) {
        let mut figures = |times: fn(&mut Self) -> &mut Vec<Duration>| {
            let times = times(&mut self);
            times.sort_unstable();
            let [p50, p99, max] = [0.5, 0.99, 1.0].map(|share| {
                times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1000.0
            });
            format!("{p50:6.2} {p99:6.2} {max:8.2}")
        };
        let (stamps, arrivals) = (figures(|row| &mut row.stamps), figures(|row| &mut row.arrivals));
        let scans = self.stamps.len();
        let share = 100.0 * self.by_motor as f64 / scans as f64;
        println!("{name:38} {scans:8} {share:5.1} %  {stamps}  {arrivals}");
        if self.most_worse > 0 {
            println!("{:38} worse after a jump: {} scans at most", "", self.most_worse);
        }
        assert_eq!(self.later, 0, "a stamp was later than the arrival");
    }
}

/// Measures for `span` of the paused clock.
fn simulated(name: &str, sensor: EmulatorBuilder, rate: Rate, span: Duration, jumps: u32) {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_all().start_paused(true).build().unwrap();
    runtime.block_on(async {
        let emulator = sensor.build();
        let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
        let mut scans = sensor.scans(Window::DETECTION, rate).await.unwrap();
        let (start, mut row) = (Instant::now(), StampRow::default());
        let mut next_jump = start + span / (jumps + 1);
        while start.elapsed() < span {
            row.add(&emulator, &scans.next().await.unwrap().unwrap());
            if jumps > 0 && Instant::now() >= next_jump {
                // Each jump falls on another part of a revolution.
                let jump = (next_jump - start).as_millis() * 37 % 100;
                emulator.delay_motor(Duration::from_millis(jump as u64));
                next_jump += span / (jumps + 1);
                row.worse = 0;
            }
        }
        row.print(name);
    });
}

/// Measures in real time, beside `processes` that only compute.
fn in_real_time(processes: usize) {
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!("load before: {}", load.trim());
    let busy: Vec<BusyLoad> = (0..processes).map(|_| BusyLoad::start()).collect();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let emulator = turning().build();
        let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
        let mut scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let (start, mut row) = (Instant::now(), StampRow::default());
        while start.elapsed() < REAL_TIME {
            row.add(&emulator, &scans.next().await.unwrap().unwrap());
        }
        row.most_worse = 0;
        row.print(&format!("real time, {processes} busy processes"));
    });
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!("load after: {}", load.trim());
    drop(busy);
}

/// A process that computes until it is dropped.
struct BusyLoad(Child);

impl BusyLoad {
    fn start() -> Self {
        Self(Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap())
    }
}

impl Drop for BusyLoad {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
