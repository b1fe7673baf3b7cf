//! One seed from its start to its end: users and chaos, then no more faults,
//! then nobody.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, sleep, timeout};
use tokio_scip::emulator::Faults;
use tokio_scip::{Error, Rate, Sensor, State, Window};

use super::case::{Case, Opener, SERIAL_NUMBER};
use super::coverage::Coverage;
use super::random::Random;
use super::users;

/// Longer than any call takes. Each of the users may wait for one another's
/// exchanges, and each exchange for six fences.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// What all that act in a run share.
#[derive(Clone)]
pub(crate) struct Run {
    pub(crate) case: Arc<Case>,
    pub(crate) coverage: Arc<Mutex<Coverage>>,
    pub(crate) over: Arc<AtomicBool>,
    pub(crate) healthy: Arc<AtomicBool>,
    /// Whether the laser may be off by request.
    pub(crate) dark: Arc<AtomicBool>,
    trace: Arc<Mutex<DefaultHasher>>,
    start: Instant,
}

/// What came of a seed.
pub(crate) struct Outcome {
    pub(crate) simulated: Duration,
    pub(crate) trace: u64,
    /// How long scans took to flow again, what outlasts the faults not counted,
    /// and whether that is on USB.
    pub(crate) recovery: (Duration, bool),
}

impl Run {
    /// Adds an event to the trace.
    pub(crate) fn note(&self, event: std::fmt::Arguments<'_>) {
        let at = self.start.elapsed();
        if std::env::var_os("SCIP_SIMULATION_TRACE").is_some() {
            eprintln!("{:9.3} {event}", at.as_secs_f64());
        }
        (at, event.to_string()).hash(&mut *self.trace.lock().unwrap());
    }

    pub(crate) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    /// A call that must end, one way or the other.
    pub(crate) async fn call<T>(
        &self,
        name: &str,
        call: impl Future<Output = Result<T, Error>>,
    ) -> Result<T, Error> {
        let outcome = timeout(PATIENCE, call).await;
        let outcome = outcome.unwrap_or_else(|_| panic!("{name} was never answered"));
        match &outcome {
            Ok(_) => self.note(format_args!("{name}: done")),
            Err(error) => {
                self.note(format_args!("{name}: {error}"));
                assert!(!matches!(error, Error::Closed), "the driver ended");
                self.coverage.lock().unwrap().error(error);
            }
        }
        outcome
    }
}

/// Runs a seed on a paused clock of its own.
pub(crate) fn run(seed: u64, coverage: &Arc<Mutex<Coverage>>) -> Outcome {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    let _told = Told(seed);
    runtime.block_on(simulate(seed, coverage))
}

/// Says which seed it was.
struct Told(u64);

impl Drop for Told {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let seed = self.0;
            eprintln!(
                "seed {seed} failed: SCIP_SIMULATION_SEED={seed} SCIP_SIMULATION_TRACE=1 \
                 cargo test --all-features --test simulation seeds"
            );
        }
    }
}

async fn simulate(seed: u64, coverage: &Arc<Mutex<Coverage>>) -> Outcome {
    let mut random = Random::new(seed);
    let run = Run {
        case: Arc::new(Case::draw(&mut random)),
        coverage: Arc::clone(coverage),
        over: Arc::default(),
        healthy: Arc::default(),
        dark: Arc::default(),
        trace: Arc::default(),
        start: Instant::now(),
    };
    let case = &run.case;
    run.note(format_args!("{case:?}"));
    let opener = Opener {
        emulator: case.emulator.clone(),
        script: case.script,
        random: Random::new(random.next()),
        healthy: Arc::clone(&run.healthy),
    };
    let builder = Sensor::builder().jitter_seed(seed).wait_for_sensor();
    let builder = builder.ring_depth(1 + random.below(3) as usize).serial_number(SERIAL_NUMBER);
    let builder = match random.once_in(2) {
        true => builder.baud_rate(*random.pick(&tokio_scip::BaudRate::ALL)),
        false => builder,
    };
    let (sensor, driver) = builder.build(opener);
    let driver = tokio::spawn(driver);

    let mut users = vec![tokio::spawn(users::operator(run.clone(), sensor.clone(), random.next()))];
    for _ in 0..=random.below(3) {
        users.push(tokio::spawn(users::watcher(run.clone(), sensor.clone(), random.next())));
        users.push(tokio::spawn(users::asker(run.clone(), sensor.clone(), random.next())));
    }
    watch_states(&run, &sensor);
    chaos(&run, &sensor, &mut random).await;
    run.over.store(true, Ordering::Relaxed);
    for user in users {
        let done = timeout(PATIENCE * 2, user).await.expect("a user waits for ever");
        done.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()));
    }
    let recovery = recover(&run, &sensor).await;
    check_rest(&run, &sensor).await;

    coverage.lock().unwrap().add(&sensor.stats(), &case.emulator, case.does);
    drop(sensor);
    let end = timeout(PATIENCE, driver).await.expect("the driver does not end");
    end.unwrap().expect("the driver failed");
    assert!(!case.emulator.is_connected(), "the port was not closed");
    let trace = run.trace.lock().unwrap().finish();
    Outcome { simulated: run.start.elapsed(), trace, recovery: (recovery, case.speed.is_none()) }
}

/// Notes each state, and none may be the end.
fn watch_states(run: &Run, sensor: &Sensor) {
    let (run, mut state) = (run.clone(), sensor.state());
    tokio::spawn(async move {
        while state.changed().await.is_ok() {
            let state = state.borrow_and_update().clone();
            if let State::Closed { error } = &state {
                assert!(error.is_none(), "the driver gave up: {error:?}");
                return;
            }
            run.coverage.lock().unwrap().state(&state);
        }
    });
}

/// Faults come and go, and worse.
async fn chaos(run: &Run, sensor: &Sensor, random: &mut Random) {
    let (case, emulator) = (&run.case, &run.case.emulator);
    if case.refuses || case.does.stranger {
        // Another sensor, or one that twice refuses to say who it is, ends an
        // opening for good.
        sensor.opened().await.unwrap();
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
        run.note(format_args!("deed {deed}"));
        match deed {
            0 if case.does.unplug => {
                emulator.unplug();
                if random.once_in(2) && case.does.power_cycle {
                    emulator.power_cycle();
                }
                sleep(random.ms(8000)).await;
                if case.does.stranger {
                    emulator.set_serial_number("H9999999");
                    emulator.plug_in();
                    sleep(random.ms(8000)).await;
                    emulator.unplug();
                    sleep(random.ms(2000)).await;
                    emulator.set_serial_number(SERIAL_NUMBER);
                }
                emulator.plug_in();
            }
            1 if case.does.power_cycle => emulator.power_cycle(),
            2 if case.does.rival => {
                // Another program takes the port for a moment.
                let mut link = emulator.link();
                let says: [&[u8]; 4] = [b"S1152000000000\n", b"L0\n", b"G0007", b"G00076801\n"];
                let bytes = *random.pick(&says);
                let _ = link.write_all(bytes).await;
                sleep(random.ms(1000)).await;
            }
            3 if case.does.chatter => {
                let says = [b"hello\n\n".to_vec(), vec![b'x'; 5000], b"\n".to_vec(), vec![0]];
                emulator.inject(random.pick(&says).clone());
            }
            _ => {}
        }
    }
}

/// No more faults: scans flow again in time.
async fn recover(run: &Run, sensor: &Sensor) -> Duration {
    let (case, emulator) = (&run.case, &run.case.emulator);
    run.note(format_args!("faults stop"));
    let limit = Duration::from_secs(if case.speed.is_none() { 2 } else { 5 });
    // What outlasts the faults, and what is no part of the recovery.
    let mut allowance = case.lingers;
    run.healthy.store(true, Ordering::Relaxed);
    emulator.set_faults(Faults::none());
    if case.script.fails {
        // A port that fails later is a fault that has not stopped. One that hangs
        // is given up at a deadline, and reopened after the longest back-off.
        emulator.unplug();
        emulator.plug_in();
        allowance += Duration::from_millis(1500);
    }
    let start = Instant::now();
    let dark = run.dark.load(Ordering::Relaxed);
    if dark {
        // To be switched on and confirmed, each a turn of the motor or two.
        allowance += Duration::from_millis(500);
    }
    loop {
        let scanned = async {
            if dark {
                sensor.laser_on().await?;
            }
            sensor.scans(Window::DETECTION, Rate::hz(10.0)).await
        };
        let Ok(mut stream) = run.call("recovery", scanned).await else {
            sleep(Duration::from_millis(10)).await;
            continue;
        };
        let flows = async { while !matches!(stream.next().await, Some(Ok(_))) {} };
        timeout(PATIENCE, flows).await.expect("scans never flow again");
        break;
    }
    let took = start.elapsed();
    let within = limit + allowance;
    assert!(took <= within, "scans flow again after {took:?}, not within {within:?}");
    took.saturating_sub(allowance)
}

/// With nothing to do the driver knows where the sensor is.
async fn check_rest(run: &Run, sensor: &Sensor) {
    sleep(Duration::from_secs(2)).await;
    let emulator = &run.case.emulator;
    let State::Connected { baud_rate, streaming, .. } = sensor.state().borrow().clone() else {
        panic!("not connected: {:?}", sensor.state().borrow());
    };
    assert_eq!(baud_rate, emulator.baud_rate());
    assert!(!streaming && emulator.is_laser_on());
    let counts = emulator.counts();
    assert!(run.case.torn || counts.malformed == 0, "{counts:?}: {:?}", emulator.log());
    // What is garbled while the speed is looked for is answered, too.
    assert!(run.case.overlaps || counts.overlapping <= counts.garbled, "{counts:?}");
    let scans = counts.scans;
    sleep(Duration::from_secs(5)).await;
    assert_eq!(emulator.counts().scans, scans, "polls without a stream");
}
