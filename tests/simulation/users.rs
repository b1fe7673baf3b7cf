//! Those who use the sensor in a run, each for itself.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::time::{Instant, sleep, timeout};
use tokio_scip::{BaudRate, Rate, Scan, Sensor, Window};

use super::random::Random;
use super::run::Run;

fn window(random: &mut Random) -> Window {
    let cluster = [1, 1, 2, 5, 99][random.below(5) as usize];
    let window = match random.below(5) {
        0 => Window::FULL,
        1 => Window::new(300..=340).unwrap(),
        2 => {
            let start = random.below(740) as u16;
            Window::new(start..=start + 28).unwrap()
        }
        _ => Window::DETECTION,
    };
    // Of a few points one may be wrong and nobody could tell.
    let clustered = window.with_cluster_count(cluster).unwrap();
    if clustered.points() < 5 { window } else { clustered }
}

/// Follows streams, one after the other, quickly or slowly.
pub(crate) async fn watcher(run: Run, sensor: Sensor, seed: u64) {
    let mut random = Random::new(seed);
    while !run.is_over() {
        let window = window(&mut random);
        let rates = [Rate::MAX, Rate::hz(10.0), Rate::hz(20.0), Rate::hz(1.0)];
        let rate = *random.pick(&rates);
        let Ok(mut stream) = run.call("scans", sensor.clone().scans(window, rate)).await else {
            sleep(random.ms(1000)).await;
            continue;
        };
        let mut last = None;
        let slow = random.once_in(4);
        for _ in 0..random.below(300) {
            if run.is_over() {
                break;
            }
            if slow {
                sleep(random.ms(2000)).await;
            }
            if random.once_in(50) {
                stream = stream.clone();
            }
            // A dropped future loses nothing.
            let Ok(item) = timeout(random.ms(3000), stream.next()).await else { continue };
            match item.expect("the stream ended") {
                Ok(scan) => check(&run, window, &scan, &mut last),
                Err(error) => {
                    run.note(format_args!("item: {error}"));
                    run.coverage.lock().unwrap().error(&error);
                }
            }
        }
        run.coverage.lock().unwrap().missed += stream.missed();
    }
}

/// Holds a scan against the truth and against the one before.
fn check(run: &Run, window: Window, scan: &Scan, last: &mut Option<(u64, Scan)>) {
    assert_eq!(scan.window(), window);
    let (request, _) = run
        .case
        .truth
        .check(&scan.into(), run.case.flips)
        .unwrap_or_else(|wrong| panic!("{wrong}"));
    run.note(format_args!("scan {} is {request}", scan.sequence()));
    if let Some((before, last)) = last {
        assert!(*before < request, "a scan came twice");
        assert!(last.sequence() < scan.sequence(), "the sequence does not rise");
        assert!(last.requested_at() < scan.requested_at(), "time runs back");
        assert!(last.received_at() <= scan.requested_at(), "time runs back");
    }
    *last = Some((request, scan.clone()));
    run.coverage.lock().unwrap().checked += 1;
}

/// Asks for single scans and for the version, and often does not wait for the
/// answer.
pub(crate) async fn asker(run: Run, sensor: Sensor, seed: u64) {
    let mut random = Random::new(seed);
    while !run.is_over() {
        sleep(random.ms(4000)).await;
        let sensor = sensor.clone();
        let patience = random.ms(400);
        let window = window(&mut random);
        if random.once_in(3) {
            let _ = timeout(patience, sensor.scan(window)).await;
            run.note(format_args!("cancelled"));
        } else if random.once_in(4) {
            let _ = run.call("version", sensor.version()).await;
        } else if let Ok(scan) = run.call("scan", sensor.scan(window)).await {
            check(&run, window, &scan, &mut None);
        }
    }
}

/// Switches the laser and the baud rate. There is only one, so that it knows
/// what to expect.
pub(crate) async fn operator(run: Run, sensor: Sensor, seed: u64) {
    let mut random = Random::new(seed);
    let emulator = &run.case.emulator;
    while !run.is_over() {
        sleep(random.ms(15_000)).await;
        let speed = *random.pick(&BaudRate::ALL);
        // What only this operator does is what the sensor is at, unless another
        // hand or a restart was in between.
        let undisturbed = {
            let resets = emulator.counts().resets;
            let alone = !run.case.does.rival;
            move |now: u64| alone && now == resets
        };
        match random.below(7) {
            0 => drop(timeout(random.ms(600), sensor.set_baud_rate(speed)).await),
            1 | 2 if run.call("speed", sensor.set_baud_rate(speed)).await.is_ok() => {
                if undisturbed(emulator.counts().resets) {
                    let expected = run.case.speed.map(|_| speed);
                    assert_eq!(emulator.baud_rate(), expected, "after a change of speed");
                }
            }
            3 => {
                run.dark.store(true, Ordering::Relaxed);
                let _ = timeout(random.ms(600), sensor.laser_off()).await;
            }
            4 => {
                run.dark.store(true, Ordering::Relaxed);
                if run.call("laser off", sensor.laser_off()).await.is_ok() {
                    assert!(!undisturbed(emulator.counts().resets) || !emulator.is_laser_on());
                    stay_dark(&run, &sensor, random.ms(20_000)).await;
                }
            }
            _ => {
                if run.call("laser on", sensor.laser_on()).await.is_ok() {
                    run.dark.store(false, Ordering::Relaxed);
                    if undisturbed(emulator.counts().resets) {
                        assert!(emulator.is_laser_on(), "after laser_on");
                    }
                }
            }
        }
    }
}

/// Nobody polls while the laser is off, and a sensor that was away has it off
/// again when it is back.
async fn stay_dark(run: &Run, sensor: &Sensor, time: Duration) {
    let (emulator, off) = (&run.case.emulator, Instant::now());
    let now = || (sensor.stats().reconnects, emulator.counts().resets);
    let (mut reconnects, mut resets) = now();
    let mut restarted = off;
    while off.elapsed() < time {
        sleep(Duration::from_millis(100)).await;
        let latest = now();
        if latest.1 > resets {
            restarted = Instant::now();
        }
        // A restart right behind the recovery goes unseen until the sensor is
        // asked for something.
        let since = restarted.elapsed() > Duration::from_millis(500);
        if latest.0 > reconnects && since && !run.case.does.rival {
            assert!(!emulator.is_laser_on(), "the laser is on after a recovery");
            run.coverage.lock().unwrap().darkened += 1;
        }
        (reconnects, resets) = latest;
    }
    let polls = emulator.log().into_iter().filter(|received| {
        let line = &received.line;
        let poll = line.len() == 9 && line[0] == b'G' && line[1..4] != line[4..7];
        poll && received.at >= off && !received.garbled
    });
    let polls: Vec<_> = polls.collect();
    assert!(run.case.does.rival || polls.is_empty(), "polled with the laser off: {polls:?}");
}
