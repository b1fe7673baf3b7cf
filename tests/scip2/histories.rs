//! Random histories of a sensor of SCIP 2: faults of each kind, power cuts, restarts, pulled cables,
//! streams that other programs left, laser settings, single scans beside streams, motors that turn at
//! another speed than the sensor tells. Every scan that arrives is one that the sensor measured, whole
//! and in order, and after the last fault scans come again.
//!
//! `SCIP_SCIP2=2000 cargo test --test it scip2` takes a minute; `SCIP_SCIP2_FIRST=2000` draws others.

use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, sleep, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::{Rate, Scan, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, Fault, Faults, Firmware, Model, Quirk, Values, WorldTime};

use crate::common::builder;
use crate::common::limit::limit;
use crate::common::random::{Random, seeds};

/// Models, with the milliseconds that they tell for a revolution.
const MODELS: [(Model, u32); 4] =
    [(Model::Urg04lx, 100), (Model::Urg04lxUg01, 100), (Model::Utm30lx, 25), (Model::Ust10lx, 25)];
/// Longest time until scans come again.
const RECOVERY: Duration = Duration::from_secs(12);

/// Value of a step in the revolution with this number, counted over all power-ups.
fn value(number: u64, step: usize) -> u32 {
    let digits = [number % 5000, number / 5000 % 5000, step as u64 % 5000];
    30 + digits[step % 3] as u32
}

/// Returns the number of the revolution that a scan shows.
fn number(scan: &Scan, seed: u64) -> u64 {
    let start = usize::from(scan.window().start());
    let mut digits = [0; 3];
    for (step, value) in (start..).zip(scan.raw_values()).take(3) {
        digits[step % 3] = u64::from(value - 30);
    }
    let number = digits[0] + 5000 * digits[1];
    for (step, found) in (start..).zip(scan.raw_values()) {
        assert_eq!(found, value(number, step), "seed {seed}: step {step} of {scan:?}");
    }
    number
}

/// Sensor that shows the number of each revolution, counted over all power-ups.
fn counting(model: Model, revolution: Duration, has_labels: bool) -> Emulator {
    let (mut before, mut powered_at) = (0, None);
    let world = move |time: WorldTime, values: &mut Values| {
        // To within a revolution.
        let powered = Instant::now() - time.at;
        let since = *powered_at.get_or_insert(powered);
        if powered > since + 2 * time.period {
            (before, powered_at) = (before + 100_000, Some(powered));
        }
        for (step, slot) in values.iter_mut().enumerate() {
            *slot = value(before + time.revolution, step);
        }
    };
    let builder = Emulator::builder().model(model).world(world);
    let builder = builder.firmware(Firmware::V31).revolution(revolution);
    if has_labels { builder.build() } else { builder.quirk(Quirk::NoLabels).build() }
}

/// A stream, and what it delivered last.
struct Followed {
    stream: ScanStream,
    rate: Rate,
    latest: Option<u64>,
}

impl Followed {
    /// Reads what is there. Returns the number of scans.
    async fn read(&mut self, seed: u64, may_repeat: bool, within: Duration) -> u64 {
        let (mut count, end) = (0, Instant::now() + within);
        while let Ok(item) = tokio::time::timeout_at(end, self.stream.next()).await {
            let item = item.unwrap_or_else(|| panic!("seed {seed}: the stream ended"));
            let Ok(scan) = item else { continue };
            let now = number(&scan, seed);
            count += 1;
            if let Some(latest) = self.latest.replace(now) {
                let is_once = self.rate == Rate::UNLIMITED && !may_repeat;
                assert!(
                    latest < now || !is_once && latest == now,
                    "seed {seed}: {now} after {latest}"
                );
            }
        }
        count
    }
}

fn window(random: &mut Random) -> Window {
    match random.below(4) {
        0 => Window::degrees(-90.0..=45.0).unwrap(),
        1 => Window::new(100..=200).unwrap(),
        _ => Window::DETECTION,
    }
}

async fn play(seed: u64) {
    limit();
    let mut random = Random::new(seed);
    let (model, told) = *random.pick(&MODELS);
    let per_mille = if random.once_in(2) { 870 + random.below(261) as u32 } else { 1000 };
    let revolution = Duration::from_micros((told * per_mille).into());
    let emulator = counting(model, revolution, random.below(3) > 0);
    // A URG-04LX begins in SCIP 1.1, which has no sums.
    let waiting = builder().depth(1000).wait_for_sensor(true).protocol(Protocol::Scip2);
    let sensor: Sensor = waiting.connect(emulator.clone()).await.unwrap();
    let begun = Instant::now();
    let mut streams = Vec::new();
    for _ in 0..1 + random.below(3) {
        let rate = *random.pick(&[
            Rate::UNLIMITED,
            Rate::hz(20.0),
            Rate::hz(10.0),
            Rate::hz(1.0),
            Rate::hz(0.5),
        ]);
        let stream = sensor.scans(window(&mut random), rate).await.unwrap();
        streams.push(Followed { stream, rate, latest: None });
    }
    // After a jump, a scan that was sent before has another time. While the laser should be off and is not,
    // the driver polls, and may get the latest scan of the stream again.
    let (mut is_on, mut may_repeat) = (true, false);
    for _ in 0..6 {
        match random.below(9) {
            0 => emulator.power_cycle(),
            1 => {
                emulator.unplug();
                sleep(random.ms(300)).await;
                emulator.plug_in();
            }
            2 => {
                is_on = random.once_in(2);
                may_repeat |= !is_on;
                let switched = async {
                    if is_on { sensor.laser_on().await } else { sensor.laser_off().await }
                };
                let _ = timeout(Duration::from_secs(8), switched).await;
            }
            3 => {
                let single = timeout(Duration::from_secs(8), sensor.scan(window(&mut random)));
                if let Ok(Ok(scan)) = single.await {
                    number(&scan, seed);
                }
            }
            4 => {
                // Another program leaves a stream.
                let mut link = emulator.link();
                let _ = link.write_all(b"MD0044072501000\n").await;
            }
            5 => {
                let _ = timeout(Duration::from_secs(8), sensor.reboot()).await;
            }
            _ => {
                let fault = random_fault(&mut random);
                may_repeat |= matches!(fault, Fault::ClockJump(_));
                emulator.set_faults(Faults::none().rate(0.2, fault).seed(random.next()));
            }
        }
        let time = random.ms(3000);
        for followed in &mut streams {
            followed.read(seed, may_repeat, time).await;
        }
    }
    emulator.set_faults(Faults::none());
    if !is_on {
        let switched = timeout(Duration::from_secs(60), sensor.laser_on()).await;
        assert!(switched.is_ok(), "seed {seed}: the laser is not switched on");
    }
    let end = Instant::now() + RECOVERY;
    for followed in &mut streams {
        let mut count = 0;
        let enough = if followed.rate == Rate::hz(0.5) { 1 } else { 5 };
        while count < enough {
            assert!(
                Instant::now() < end,
                "seed {seed}: {} of {model:?} has no scans",
                followed.rate
            );
            count += followed.read(seed, may_repeat, Duration::from_millis(100)).await;
        }
    }
    let revolution = sensor.geometry().await.unwrap().revolution();
    let lost = sensor.stats().lost as u32 * revolution;
    assert!(lost < begun.elapsed(), "seed {seed}: {lost:?} of scans are lost");
}

fn random_fault(random: &mut Random) -> Fault {
    random
        .pick(&[
            Fault::CommandLost,
            Fault::Lost,
            Fault::Late(Duration::from_millis(200)),
            Fault::Late(Duration::from_millis(700)),
            Fault::Doubled,
            Fault::Drop(30..45),
            Fault::Repeat(10..90),
            Fault::Cut(100),
            Fault::Damaged,
            Fault::Merged,
            Fault::Noise(40),
            Fault::Garbage(b"GD0000108001\n00P\n".to_vec()),
            Fault::Pause(60, Duration::from_millis(300)),
            Fault::Status(b'M'),
            Fault::Ignored,
            Fault::WrongSum,
            Fault::ClockJump(-5000),
            Fault::ClockJump(5000),
            Fault::Reset(50),
            Fault::HangUp(70),
        ])
        .clone()
}

#[test]
fn every_scan_of_a_history_is_right() {
    for seed in seeds("SCIP_SCIP2", 60) {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        runtime.enable_all().start_paused(true).build().unwrap().block_on(play(seed));
    }
}
