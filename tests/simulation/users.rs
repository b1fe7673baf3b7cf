//! The users of the sensor in a run, one task each.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::time::{Instant, sleep, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::scan::StampQuality;
use tokio_scip::{BaudRate, ErrorKind, Rate, Scan, Sensor, Window};
use urg_emulator::{Emulator, Fault, SentScan};

use super::case::SCIP2_LATENCY;
use super::run::Run;
use crate::common::random::Random;

/// How much a stamp may be early, and late if it rests on the sensor's clock.
const EARLIEST: Duration = Duration::from_millis(10);
const LATEST: Duration = Duration::from_millis(10);

fn window(run: &Run, random: &mut Random) -> Window {
    let cluster = [1, 1, 2, 5, 99][random.below(5) as usize];
    let window = match random.below(5) {
        0 => run.case.widest(),
        1 => Window::new(300..=340).unwrap(),
        2 => {
            let widest = run.case.widest();
            let start = widest.start() + random.below(widest.steps() as u64 - 28) as u16;
            Window::new(start..=start + 28).unwrap()
        }
        _ => Window::DETECTION,
    };
    // A copy can pass as the next scan of a window without a spare step (`guide::trust`).
    // `equal_polls_deliver_few_doubled_replies` counts them.
    if run.case.doubles && run.case.protocol == Protocol::Scip1 {
        return if window == Window::FULL { Window::DETECTION } else { window };
    }
    // One wrong value of only a few would leave the scan without a clear identity.
    let clustered = window.with_cluster_count(cluster).unwrap();
    if clustered.points() < 5 { window } else { clustered }
}

/// Reads streams, one after the other, quickly or slowly.
pub(crate) async fn watcher(run: Run, sensor: Sensor, seed: u64) {
    let mut random = Random::new(seed);
    while !run.is_over() {
        let window = window(&run, &mut random);
        let rates = [Rate::UNLIMITED, Rate::hz(10.0), Rate::hz(20.0), Rate::hz(1.0)];
        let rate = *random.pick(&rates);
        let Ok(mut stream) =
            run.call("scans", sensor.clone().scans(window, rate).into_future()).await
        else {
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
            // A dropped `next()` loses nothing.
            let Ok(item) = timeout(random.ms(3000), stream.next()).await else { continue };
            match item.expect("the stream ended") {
                Ok(scan) => check(&run, window, &scan, &mut last),
                Err(error) => {
                    run.trace(format_args!("item: {error}"));
                    run.coverage.lock().unwrap().error(&error);
                }
            }
        }
        run.coverage.lock().unwrap().missed += stream.missed();
    }
}

/// Compares a scan with the truth and with the scan before it.
fn check(run: &Run, window: Window, scan: &Scan, last: &mut Option<(u64, Scan)>) {
    let case = &run.case;
    assert_eq!(scan.window(), case.window_of(window));
    let request = match case.protocol {
        Protocol::Scip2 => case.truth.find(&scan.into()),
        _ => case.truth.check(&scan.into(), case.flips).map(|(request, _)| request),
    };
    let request = request.unwrap_or_else(|wrong| panic!("{wrong}"));
    run.trace(format_args!("scan {} is {request}", scan.sequence()));
    if let Some((before, last)) = last {
        assert!(*before < request, "a scan was delivered twice");
        assert!(last.sequence() < scan.sequence(), "the sequence does not rise");
        let [earlier, later] =
            [last, scan].map(|scan| (scan.times().requested_at, scan.received_at()));
        // A scan that a sensor of SCIP 2 sends unasked may come while the driver awaits another reply.
        let is_later = match case.protocol {
            Protocol::Scip2 => earlier.0 <= later.0 && earlier.1 <= later.1,
            _ => earlier.0 < later.0 && earlier.1 <= later.0,
        };
        assert!(is_later, "time runs back: {earlier:?}, {later:?}");
    }
    *last = Some((request, scan.clone()));
    if case.protocol == Protocol::Scip2 {
        run.coverage.lock().unwrap().scip2_scan();
        if !case.jumps {
            check_stamp(run, request, scan);
        }
    }
    run.coverage.lock().unwrap().checked += 1;
}

/// Compares the time of the first ray with the truth.
fn check_stamp(run: &Run, request: u64, scan: &Scan) {
    let sent = run.case.emulator.sent_scans();
    // Polled before a first revolution had ended, the emulator sends that one too early.
    let is_whole = |sent: &&SentScan| sent.revolution_end <= run.case.truth.measured_at(request);
    let sent = sent.iter().rfind(|sent| sent.time.request == request).filter(is_whole);
    let Some(sent) = sent else { return };
    let powered_at = sent.revolution_end - sent.time.at;
    // A cluster counts as measured in its middle.
    let first = scan.window().start() + u16::from(scan.window().cluster_count()) / 2;
    let truth = powered_at + sent.time.at_step(first.into()) + SCIP2_LATENCY;
    let found = scan.times().first_ray_at;
    let early = truth.saturating_duration_since(found);
    let late = found.saturating_duration_since(truth);
    run.trace(format_args!("stamp {:?} early {early:?} late {late:?}", scan.times().quality));
    let is_by_clock = scan.times().quality == StampQuality::SensorClock;
    // Before the clock has shown the motor, a revolution is taken for as long as the sensor tells.
    let odd_by = if is_by_clock { Duration::ZERO } else { run.case.odd_by };
    assert!(early <= EARLIEST + odd_by, "a stamp is {early:?} early");
    if is_by_clock {
        assert!(late <= LATEST, "a stamp is {late:?} late");
        run.coverage.lock().unwrap().stamp(early.max(late));
    }
}

/// Requests single scans, the version and the state, and often drops the request before it is
/// answered.
pub(crate) async fn requester(run: Run, sensor: Sensor, seed: u64) {
    let mut random = Random::new(seed);
    while !run.is_over() {
        sleep(random.ms(4000)).await;
        let sensor = sensor.clone();
        let limit = random.ms(400);
        let window = window(&run, &mut random);
        if random.once_in(3) {
            let _ = timeout(limit, sensor.scan(window)).await;
            run.trace(format_args!("cancelled"));
        } else if random.once_in(4) {
            let _ = run.call("version", sensor.version()).await;
            let _ = run.call("state", sensor.sensor_state()).await;
        } else if let Ok(scan) = run.call("scan", sensor.scan(window)).await {
            check(&run, window, &scan, &mut None);
        }
    }
}

/// Switches the laser and the baud rate, and restarts the sensor. A run has one operator, so that it
/// knows which state to expect.
pub(crate) async fn operator(run: Run, sensor: Sensor, seed: u64) {
    let mut random = Random::new(seed);
    let emulator = &run.case.emulator;
    while !run.is_over() {
        sleep(random.ms(15_000)).await;
        let speed = *random.pick(&BaudRate::ALL);
        // The sensor is in the state that this operator set, unless another program or a
        // restart came in between.
        let undisturbed = {
            let resets = emulator.counts().resets;
            let alone = !run.case.events.other_program;
            move |now: u64| alone && now == resets
        };
        match random.below(8) {
            0 => {
                run.baud_rate_may_wait.store(true, Ordering::Relaxed);
                let _ = timeout(random.ms(600), sensor.set_baud_rate(speed)).await;
            }
            1 | 2 => {
                run.baud_rate_may_wait.store(true, Ordering::Relaxed);
                if run.call("speed", sensor.set_baud_rate(speed)).await.is_err() {
                    continue;
                }
                run.baud_rate_may_wait.store(false, Ordering::Relaxed);
                if undisturbed(emulator.counts().resets) {
                    let expected = run.case.speed.map(|_| speed);
                    assert_eq!(emulator.baud_rate(), expected, "after a change of speed");
                }
            }
            3 => {
                run.laser_may_be_off.store(true, Ordering::Relaxed);
                let _ = timeout(random.ms(600), sensor.laser_off()).await;
            }
            4 => {
                run.laser_may_be_off.store(true, Ordering::Relaxed);
                if run.call("laser off", sensor.laser_off()).await.is_ok() {
                    assert!(!undisturbed(emulator.counts().resets) || !emulator.is_laser_on());
                    stay_off(&run, &sensor, random.ms(20_000)).await;
                }
            }
            5 if run.case.events.power_cycle => {
                let _restarting = run.restarting.lock().await;
                let outcome = run.call("reboot", sensor.reboot()).await;
                assert!(outcome.is_err() || run.case.protocol == Protocol::Scip2);
                // It answers for another second after its reply, which may be late, or pause for 0.45 s.
                sleep(run.case.lingers + Duration::from_millis(1500) + run.case.boot).await;
            }
            _ => {
                run.laser_may_be_off.store(true, Ordering::Relaxed);
                if run.call("laser on", sensor.laser_on()).await.is_ok() {
                    run.laser_may_be_off.store(false, Ordering::Relaxed);
                    if undisturbed(emulator.counts().resets) {
                        assert!(emulator.is_laser_on(), "after laser_on");
                    }
                }
            }
        }
    }
}

/// Returns true for the command of a scan, of either protocol: a fence or a probe has one step.
fn is_poll(line: &[u8]) -> bool {
    match line {
        [b'G', steps @ ..] if line.len() == 9 => steps[..3] != steps[3..6],
        [b'G' | b'M', b'D', steps @ ..] if steps.len() >= 8 => steps[..4] != steps[4..8],
        _ => false,
    }
}

/// Returns true if commands or their replies were lost.
fn loses_commands(emulator: &Emulator) -> bool {
    emulator.fault_count(&Fault::CommandLost) + emulator.fault_count(&Fault::Lost) > 0
}

/// Time between two looks at the driver.
const LOOKS: Duration = Duration::from_millis(100);

/// Checks that nothing is polled while the laser is off, and that the laser of a sensor
/// that was away is switched off again.
async fn stay_off(run: &Run, sensor: &Sensor, time: Duration) {
    let (emulator, off) = (&run.case.emulator, Instant::now());
    let now = || (sensor.stats().reconnects, emulator.counts().resets);
    let (mut reconnects, mut resets) = now();
    let (mut restarted, mut doubts) = (off, Vec::new());
    // A sensor that seems to refuse both `L0` and to measure is polled until the next `L0`.
    let may_doubt = run.case.refuses || run.case.flips > 0;
    while off.elapsed() < time {
        sleep(LOOKS).await;
        let latest = now();
        if latest.1 > resets {
            restarted = Instant::now();
        }
        // A restart right after the recovery is not visible until the next request.
        let since = restarted.elapsed() > Duration::from_millis(500);
        // A sensor that lost both `L0`, or seems to refuse them, is asked again after a second, and
        // until then the driver does not say that its laser is off.
        let reason = sensor.freshness().check(Duration::ZERO).err().and_then(|stale| stale.source);
        let is_told = reason.is_some_and(|reason| matches!(reason.kind(), ErrorKind::LaserOff));
        if !is_told && (may_doubt || loses_commands(emulator)) {
            doubts.push(Instant::now());
        } else if latest.0 > reconnects && since && !run.case.events.other_program {
            assert!(!emulator.is_laser_on(), "the laser is on after a recovery");
            run.coverage.lock().unwrap().kept_off += 1;
        }
        (reconnects, resets) = latest;
    }
    let mut doubt_until = off;
    let polls = emulator.log().into_iter().filter(|received| {
        let line = &received.line;
        if may_doubt && line == b"L0" {
            doubt_until = off.max(received.at + Duration::from_secs(8));
        }
        let poll = is_poll(line);
        let at = received.at;
        // It may have been sent before the laser was switched off, since a look at the driver.
        let is_doubted = doubts.iter().any(|doubt| {
            let span = *doubt - Duration::from_millis(200)..=*doubt + LOOKS;
            span.contains(&at)
        });
        poll && at >= doubt_until && !received.garbled && !is_doubted
    });
    let polls: Vec<_> = polls.collect();
    assert!(
        run.case.events.other_program || polls.is_empty(),
        "polled with the laser off: {polls:?}"
    );
}
