//! Runs one seed from start to end: users with faults, then users without faults, then no
//! users.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, sleep, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::{Error, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Faults, Received, Verdict};

use super::case::{Case, SERIAL_NUMBER, SimulatedConnect};
use super::coverage::Coverage;
use super::users;
use crate::common::random::Random;

/// Time limit of a call, longer than any takes. Each user may have to wait for the exchanges of
/// the others, and each exchange for six fences.
pub(crate) const CALL_LIMIT: Duration = Duration::from_secs(60);

/// State that all tasks of a run share.
#[derive(Clone)]
pub(crate) struct Run {
    pub(crate) case: Arc<Case>,
    pub(crate) coverage: Arc<Mutex<Coverage>>,
    pub(crate) over: Arc<AtomicBool>,
    pub(crate) healthy: Arc<AtomicBool>,
    /// True while the laser may be off by request, or the driver may remember a request for it
    /// that it could not send.
    pub(crate) laser_may_be_off: Arc<AtomicBool>,
    /// True while the driver may remember a baud rate that it could not set.
    pub(crate) baud_rate_may_wait: Arc<AtomicBool>,
    /// Locked while the operator restarts the sensor, until it has booted.
    pub(crate) restarting: Arc<tokio::sync::Mutex<()>>,
    trace: Arc<Mutex<DefaultHasher>>,
    start: Instant,
}

/// Result of a seed.
pub(crate) struct SimulationOutcome {
    pub(crate) simulated: Duration,
    pub(crate) trace: u64,
    /// Time until scans came again, without what outlasts the faults, and whether the
    /// sensor is on RS-232, on USB, or on RS-232 in SCIP 2.
    pub(crate) recovery: (Duration, usize),
}

impl Run {
    /// Adds an event to the trace.
    pub(crate) fn trace(&self, event: std::fmt::Arguments<'_>) {
        let at = self.start.elapsed();
        if std::env::var_os("SCIP_SIMULATION_TRACE").is_some() {
            eprintln!("{:9.3} {event}", at.as_secs_f64());
        }
        (at, event.to_string()).hash(&mut *self.trace.lock().unwrap());
    }

    pub(crate) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    /// Makes a call that must end, with a value or an error.
    pub(crate) async fn call<T>(
        &self,
        name: &str,
        call: impl Future<Output = Result<T, Error>>,
    ) -> Result<T, Error> {
        let outcome = timeout(CALL_LIMIT, call).await;
        let outcome = outcome.unwrap_or_else(|_| panic!("{name} never ended"));
        match &outcome {
            Ok(_) => self.trace(format_args!("{name}: done")),
            Err(error) => {
                self.trace(format_args!("{name}: {error}"));
                assert!(!matches!(error.kind(), ErrorKind::Closed), "the driver ended");
                self.coverage.lock().unwrap().error(error);
            }
        }
        outcome
    }
}

/// Runs a seed on its own paused clock.
pub(crate) fn run(seed: u64, coverage: &Arc<Mutex<Coverage>>) -> SimulationOutcome {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    let _print = PrintSeed(seed);
    runtime.block_on(simulate(seed, coverage))
}

/// Prints the seed if its run panics.
struct PrintSeed(u64);

impl Drop for PrintSeed {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let seed = self.0;
            eprintln!(
                "seed {seed} failed; to repeat it: SCIP_SIMULATION_SEED={seed} \
                 SCIP_SIMULATION_TRACE=1 cargo test --test it --features serde \
                 simulation::seeds -- --nocapture"
            );
        }
    }
}

async fn simulate(seed: u64, coverage: &Arc<Mutex<Coverage>>) -> SimulationOutcome {
    let mut random = Random::new(seed);
    let run = Run {
        case: Arc::new(Case::draw(&mut random)),
        coverage: Arc::clone(coverage),
        over: Arc::default(),
        healthy: Arc::default(),
        laser_may_be_off: Arc::default(),
        baud_rate_may_wait: Arc::default(),
        restarting: Arc::default(),
        trace: Arc::default(),
        start: Instant::now(),
    };
    let case = &run.case;
    run.trace(format_args!("{case:?}"));
    let connect = SimulatedConnect {
        emulator: case.emulator.clone(),
        script: case.script,
        random: Random::new(random.next()),
        is_ready: seed % 2 == 1,
        healthy: Arc::clone(&run.healthy),
    };
    fastrand::seed(seed);
    let builder = Sensor::builder().wait_for_sensor(true);
    let builder = builder.depth(1 + random.below(3) as usize).serial_number(SERIAL_NUMBER);
    let builder = match random.once_in(2) {
        true => builder.baud_rate(*random.pick(&tokio_scip::BaudRate::ALL)),
        false => builder,
    };
    let builder = match case.protocol {
        Protocol::Scip2 => builder.protocol(Protocol::Scip2),
        _ => builder,
    };
    let (sensor, driver) = builder.build(connect);
    let driver = tokio::spawn(driver);

    let mut users = vec![tokio::spawn(users::operator(run.clone(), sensor.clone(), random.next()))];
    for _ in 0..=random.below(3) {
        users.push(tokio::spawn(users::watcher(run.clone(), sensor.clone(), random.next())));
        users.push(tokio::spawn(users::requester(run.clone(), sensor.clone(), random.next())));
    }
    watch_states(&run, &sensor);
    cause_faults(&run, &sensor, &mut random).await;
    run.over.store(true, Ordering::Relaxed);
    for user in users {
        let done = timeout(CALL_LIMIT * 2, user).await.expect("a user's task does not end");
        done.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()));
    }
    let recovery = recover(&run, &sensor).await;
    check_rest(&run, &sensor).await;

    coverage.lock().unwrap().add(&sensor.stats(), &case.emulator, case.events);
    drop(sensor);
    let end = timeout(CALL_LIMIT, driver).await.expect("the driver does not end");
    end.unwrap().expect("the driver failed");
    assert!(!case.emulator.is_connected(), "the port was not closed");
    let trace = run.trace.lock().unwrap().finish();
    if case.protocol == Protocol::Scip2 {
        coverage.lock().unwrap().scip2(run.start.elapsed());
    }
    let port = match (case.speed, case.protocol) {
        (None, _) => 1,
        (Some(_), Protocol::Scip2) => 2,
        (Some(_), _) => 0,
    };
    SimulationOutcome { simulated: run.start.elapsed(), trace, recovery: (recovery, port) }
}

/// Traces each state, and fails if one is the end of the driver.
fn watch_states(run: &Run, sensor: &Sensor) {
    let (run, mut state) = (run.clone(), sensor.watch_state());
    tokio::spawn(async move {
        while let Some(state) = state.changed().await {
            if let State::Closed { error } = &state {
                assert!(error.is_none(), "the driver ended: {error:?}");
                return;
            }
            run.coverage.lock().unwrap().state(&state);
        }
    });
}

/// Switches faults on and off, and causes the events of the case.
async fn cause_faults(run: &Run, sensor: &Sensor, random: &mut Random) {
    let (case, emulator) = (&run.case, &run.case.emulator);
    if case.refuses || case.events.other_sensor {
        // Another sensor, or one that twice does not confirm its identity, ends opening for
        // good.
        sensor.watch_state().connected().await.unwrap();
    }
    let end = Instant::now() + Duration::from_secs(60) + random.ms(120_000);
    while Instant::now() < end {
        emulator.set_faults(case.faults.clone().seed(random.next()));
        sleep(Duration::from_secs(1) + random.ms(20_000)).await;
        if random.once_in(5) {
            emulator.set_faults(Faults::none());
            sleep(random.ms(3000)).await;
        }
        let deed = random.below(5);
        run.trace(format_args!("deed {deed}"));
        match deed {
            0 if case.events.unplug => {
                emulator.unplug();
                if random.once_in(2) && case.events.power_cycle {
                    emulator.power_cycle();
                }
                sleep(random.ms(8000)).await;
                if case.events.other_sensor {
                    emulator.set_serial_number("H9999999");
                    emulator.plug_in();
                    sleep(random.ms(8000)).await;
                    emulator.unplug();
                    sleep(random.ms(2000)).await;
                    emulator.set_serial_number(SERIAL_NUMBER);
                }
                emulator.plug_in();
            }
            1 if case.events.power_cycle => emulator.power_cycle(),
            2 if case.events.other_program => {
                // Another program uses the port for a moment.
                let mut link = emulator.link();
                let says: &[&[u8]] = match case.protocol {
                    Protocol::Scip2 => {
                        &[b"SS115200\n", b"QT\n", b"GD004", b"MD0044072501000\n", b"RS\n"]
                    }
                    _ => &[b"S1152000000000\n", b"L0\n", b"G0007", b"G00076801\n"],
                };
                let bytes = *random.pick(says);
                let _ = link.write_all(bytes).await;
                sleep(random.ms(1000)).await;
            }
            3 if case.events.unrequested_bytes => {
                let says = [b"hello\n\n".to_vec(), vec![b'x'; 5000], b"\n".to_vec(), vec![0]];
                emulator.inject(random.pick(&says).clone());
            }
            _ => {}
        }
    }
}

/// Ends all faults and checks that scans come again in time.
async fn recover(run: &Run, sensor: &Sensor) -> Duration {
    let (case, emulator) = (&run.case, &run.case.emulator);
    run.trace(format_args!("faults stop"));
    let limit = match (case.speed, case.protocol) {
        (None, _) => 2,
        // After a power cut it has lost its protocol, too.
        (Some(_), Protocol::Scip2) => 7,
        (Some(_), _) => 5,
    };
    let limit = Duration::from_secs(limit);
    // The time that outlasts the faults, and that is no part of the recovery.
    let mut allowance = case.lingers;
    run.healthy.store(true, Ordering::Relaxed);
    emulator.set_faults(Faults::none());
    if case.script.fails {
        // A port that fails later is a fault that has not ended. One that hangs is
        // closed at a deadline, and reopened after the longest back-off.
        emulator.unplug();
        emulator.plug_in();
        allowance += Duration::from_millis(1500);
    }
    drop(run.restarting.lock().await);
    let start = Instant::now();
    let laser_may_be_off = run.laser_may_be_off.load(Ordering::Relaxed);
    // The driver first sends what it remembers: a command and a fence, which take one or two
    // revolutions each.
    for may_wait in [laser_may_be_off, run.baud_rate_may_wait.load(Ordering::Relaxed)] {
        if may_wait {
            allowance += Duration::from_millis(500);
        }
    }
    loop {
        let scanned = async {
            if laser_may_be_off {
                sensor.laser_on().await?;
            }
            sensor.scans(Window::DETECTION, Rate::hz(10.0)).await
        };
        let Ok(mut stream) = run.call("recovery", scanned).await else {
            sleep(Duration::from_millis(10)).await;
            continue;
        };
        let flows = async { while !matches!(stream.next().await, Some(Ok(_))) {} };
        timeout(CALL_LIMIT, flows).await.expect("no scan came after the faults");
        break;
    }
    let took = start.elapsed();
    let within = limit + allowance;
    assert!(took <= within, "scans came again after {took:?}, expected within {within:?}");
    took.saturating_sub(allowance)
}

/// Checks that without streams the driver is connected, silent, and at the sensor's
/// baud rate.
async fn check_rest(run: &Run, sensor: &Sensor) {
    sleep(Duration::from_secs(2)).await;
    let emulator = &run.case.emulator;
    let State::Connected { baud_rate, streaming, .. } = sensor.watch_state().get() else {
        panic!("not connected: {:?}", sensor.watch_state().get());
    };
    assert_eq!(baud_rate, emulator.baud_rate());
    assert!(!streaming && emulator.is_laser_on());
    let counts = emulator.counts();
    // What finds the protocol of a silent sensor: the fence of SCIP 1.1.
    let looks_for_scip1 = |line: &Received| {
        run.case.protocol == Protocol::Scip2 && line.line.len() == 9 && line.line.starts_with(b"G")
    };
    let log = emulator.log();
    let mut malformed =
        log.iter().filter(|line| line.verdict == Verdict::Malformed && !line.garbled);
    assert!(run.case.torn || malformed.all(looks_for_scip1), "{counts:?}");
    // If it sees a stream before the fence is answered, it ends that at once.
    let ends_stream = |lines: &[Received]| matches!(lines, [fence, end] if looks_for_scip1(fence) && end.line.starts_with(b"QT"));
    let ends_streams = log.windows(2).filter(|lines| ends_stream(lines)).count() as u64;
    // Garbled commands while the baud rate is looked for are answered, too.
    let may_overlap = counts.garbled + ends_streams;
    assert!(run.case.overlaps || counts.overlapping <= may_overlap, "{counts:?}");
    let scans = counts.scans;
    sleep(Duration::from_secs(5)).await;
    assert_eq!(emulator.counts().scans, scans, "polls without a stream");
}
