//! Each call on a port fails once, in each way that a system has. The caller gets a typed
//! error or a success, in time; afterwards everything works again, and no port is left
//! open.

use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::common::faulty_link::{Call, CallCounter, FaultyLink, LinkFailure};
use crate::common::{ConnectFn, builder, request_of, truthful};
use tokio::time::{Instant, timeout};
use tokio_scip::port::Connect;
use tokio_scip::{BaudRate, Error, ErrorKind, Rate, Sensor, Window};
use urg_emulator::{Emulator, Pace};

/// Returns a small window, whose reply arrives in few reads.
fn window() -> Window {
    Window::new(300..=320).unwrap()
}

/// EIO, ENODEV, and kinds of errors; the end of input; no response.
const FAILURES: [LinkFailure; 7] = [
    LinkFailure::Errno(5),
    LinkFailure::Errno(19),
    LinkFailure::Kind(io::ErrorKind::ConnectionReset),
    LinkFailure::Kind(io::ErrorKind::Interrupted),
    LinkFailure::Kind(io::ErrorKind::WouldBlock),
    LinkFailure::End,
    LinkFailure::Stall,
];

/// A sequence of calls by a service.
#[derive(Clone, Copy, Debug)]
enum FailureScenario {
    Open,
    Stream,
    Speed,
    Reconnect,
}

/// Runs the scenario, and returns the first error.
async fn run(scenario: FailureScenario, sensor: &Sensor, emulator: &Emulator) -> Result<(), Error> {
    match scenario {
        FailureScenario::Open => sensor.watch_state().connected().await,
        FailureScenario::Stream | FailureScenario::Reconnect => {
            sensor.watch_state().connected().await?;
            let mut stream = sensor.scans(window(), Rate::hz(5.0)).await?;
            let mut first = None;
            for round in 0..2 {
                let mut scans = 0;
                while scans < 2 {
                    match stream.next().await {
                        Some(Ok(scan)) => {
                            assert!(request_of(&scan).is_some(), "a wrong scan");
                            scans += 1;
                        }
                        Some(Err(error)) => first = first.or(Some(error)),
                        None => return Err(first.unwrap_or(ErrorKind::Closed.into())),
                    }
                }
                if round == 0 && matches!(scenario, FailureScenario::Reconnect) {
                    emulator.unplug();
                    emulator.plug_in();
                }
            }
            first.map_or(Ok(()), Err)
        }
        FailureScenario::Speed => {
            sensor.watch_state().connected().await?;
            sensor.set_baud_rate(BaudRate::B57600).await?;
            sensor.set_baud_rate(BaudRate::B250000).await
        }
    }
}

/// Opens links to the sensor, and counts those that are open. Calls are counted over all
/// links, so that the n-th call is the n-th of the scenario.
fn connect(
    emulator: &Emulator,
    writes: usize,
    failure: Option<(Call, u64, LinkFailure)>,
    counters: &Arc<Mutex<Vec<CallCounter>>>,
) -> impl Connect {
    let (emulator, counters) = (emulator.clone(), Arc::clone(counters));
    ConnectFn(move || {
        let mut counters = counters.lock().unwrap();
        let link = FaultyLink::new(emulator.link()).partial_writes(writes);
        let done: u64 = counters.iter().map(|counter| calls(counter, failure)).sum();
        let failed = counters.iter().any(|counter| counter.failures() > 0);
        counters.push(link.counter());
        Ok(match failure {
            Some((call, n, failure)) if n >= done && !failed => link.fail(call, n - done, failure),
            _ => link,
        })
    })
}

fn calls(counter: &CallCounter, failure: Option<(Call, u64, LinkFailure)>) -> u64 {
    match failure.map(|(call, ..)| call) {
        Some(Call::Read) => counter.reads(),
        Some(Call::Write) => counter.writes(),
        _ => counter.baud_rate_changes(),
    }
}

/// Runs the scenario with one failing call, if any. Returns the number of reads, writes and changes of
/// the baud rate.
async fn with_failure(
    scenario: FailureScenario,
    writes: usize,
    failure: Option<(Call, u64, LinkFailure)>,
    reconnect: bool,
) -> [u64; 3] {
    let emulator =
        truthful().baud_rate(BaudRate::B19200).pace(Pace::AtOnce).log_capacity(0).build();
    let counters: Arc<Mutex<Vec<CallCounter>>> = Arc::default();
    let builder = builder().wait_for_sensor(true).reconnect(reconnect);
    let (sensor, driver) = builder.build(connect(&emulator, writes, failure, &counters));
    let mut driver = tokio::spawn(driver);
    let outcome = timeout(Duration::from_secs(60), run(scenario, &sensor, &emulator)).await;
    let outcome = outcome.unwrap_or_else(|_| panic!("{scenario:?} hangs after {failure:?}"));
    if let Err(error) = &outcome {
        use ErrorKind::{Disconnected, NoAnswer, NotConfirmed, Timeout, UnsupportedBaudRate};
        let typed = matches!(
            error.kind(),
            Disconnected { .. }
                | Timeout { .. }
                | NoAnswer { .. }
                | NotConfirmed { .. }
                | UnsupportedBaudRate { .. }
        );
        assert!(typed, "{scenario:?} {failure:?}: {error:?}");
        assert!(failure.is_some() || matches!(scenario, FailureScenario::Reconnect), "{error:?}");
    }
    if reconnect {
        // The failure occurs once, so scans come again.
        let start = Instant::now();
        while sensor.scan(window()).await.is_err() {}
        let took = start.elapsed();
        assert!(took < Duration::from_secs(15), "{scenario:?} {failure:?}: {took:?}");
        assert!(!driver.is_finished());
    }
    if failure.is_some() {
        let failed = counters.lock().unwrap().iter().any(|counter| counter.failures() > 0);
        assert!(failed, "{scenario:?}: {failure:?} was not reached");
    }
    let totals =
        counters.lock().unwrap().iter().fold([0; 3], |[reads, writes, speeds], counter| {
            [
                reads + counter.reads(),
                writes + counter.writes(),
                speeds + counter.baud_rate_changes(),
            ]
        });
    sensor.close().await;
    let ended = timeout(Duration::from_secs(1), &mut driver).await;
    assert!(
        ended.is_ok_and(|driver| driver.is_ok()),
        "{scenario:?} {failure:?}: the driver panicked or does not end"
    );
    assert!(!emulator.is_connected(), "{scenario:?} {failure:?}: the port is still open");
    totals
}

/// Lets every n-th call of each kind fail in every way.
async fn every_call_fails_once(scenario: FailureScenario) {
    for (reconnect, writes) in [(true, usize::MAX), (true, 3), (false, usize::MAX)] {
        if !reconnect && matches!(scenario, FailureScenario::Reconnect) {
            continue;
        }
        let totals = with_failure(scenario, writes, None, reconnect).await;
        for (call, total) in [Call::Read, Call::Write, Call::SetBaudRate].into_iter().zip(totals) {
            assert!(total > 0);
            // Partial writes change no other calls.
            if writes < usize::MAX && !matches!(call, Call::Write) {
                continue;
            }
            for n in 0..total {
                for failure in FAILURES {
                    with_failure(scenario, writes, Some((call, n, failure)), reconnect).await;
                }
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn o02_every_call_fails_once_while_opening() {
    every_call_fails_once(FailureScenario::Open).await;
}

#[tokio::test(start_paused = true)]
async fn o02_every_call_fails_once_under_a_stream() {
    every_call_fails_once(FailureScenario::Stream).await;
}

#[tokio::test(start_paused = true)]
async fn o02_every_call_fails_once_during_changes_of_baud_rate() {
    every_call_fails_once(FailureScenario::Speed).await;
}

#[tokio::test(start_paused = true)]
async fn o02_every_call_fails_once_around_a_reconnect() {
    every_call_fails_once(FailureScenario::Reconnect).await;
}
