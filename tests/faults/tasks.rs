//! Rows A: tasks, handles, runtimes and processes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use futures::FutureExt;
use tokio::io::AsyncWriteExt;
use tokio::runtime::Builder;
use tokio_scip::{BaudRate, Error, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults};

use super::rig::{instant_sensor, open, scans, streaming, wrong_scans};
use crate::common::endless_port::EndlessPort;
use crate::common::hooked::{Hooked, Hooks};
use crate::common::{ConnectFn, builder, ms, request_of};

const WINDOW: Window = Window::DETECTION;

/// Returns a runtime with a paused clock.
fn runtime() -> tokio::runtime::Runtime {
    Builder::new_current_thread().enable_all().start_paused(true).build().unwrap()
}

#[test]
fn a05_a_runtime_shut_down_answers_everyone() {
    let mut working = 0;
    for steps in 0..120 {
        let first = runtime();
        let emulator =
            first.block_on(async { instant_sensor().baud_rate(BaudRate::B115200).build() });
        let connected = first.block_on(async {
            let opening = tokio::spawn(builder().connect(emulator.clone()));
            let at = tokio::time::sleep(ms(10 * steps));
            let mut sensor = None;
            let work = async {
                let opened = opening.await.unwrap().unwrap();
                let mut stream = opened.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
                sensor = Some((opened, stream.clone()));
                loop {
                    stream.next().await.unwrap().unwrap();
                }
            };
            tokio::select! { () = at => {}, () = work => {} }
            sensor
        });
        drop(first);
        let Some((sensor, mut stream)) = connected else { continue };
        working += 1;
        // Handles outlive the runtime, and work from another one.
        runtime().block_on(async {
            while stream.next().await.is_some_and(|item| item.is_ok()) {}
            assert!(stream.next().await.is_none());
            assert!(matches!(sensor.scan(WINDOW).await.unwrap_err().kind(), ErrorKind::Closed));
            assert!(matches!(sensor.laser_off().await.unwrap_err().kind(), ErrorKind::Closed));
            sensor.close().await;
            assert!(!emulator.is_connected(), "after {steps} steps");
        });
        // Dropped outside of any runtime.
        drop((sensor, stream));
    }
    assert!(working > 30, "{working}");
}

/// Panics, as a defect would, when this many reads are done.
struct PanicAfter(u64);

impl Hooks for PanicAfter {
    fn before_read(&mut self) {
        assert!(self.0 > 0, "injected");
        self.0 -= 1;
    }
}

#[tokio::test(start_paused = true)]
async fn a06_a_driver_that_panics_ends_every_pending_call() {
    std::panic::set_hook(Box::new(|_| {}));
    let mut ended_in_work = 0;
    for reads in 0..60 {
        let emulator = instant_sensor().build();
        let (sensor, driver) = builder().build(ConnectFn(move || {
            Ok(Hooked { port: emulator.link(), hooks: PanicAfter(reads) })
        }));
        let driver = tokio::spawn(driver);
        let work = async {
            sensor.watch_state().connected().await?;
            let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await?;
            ended_in_work += 1;
            loop {
                let (item, scan) = tokio::join!(stream.next(), sensor.scan(WINDOW));
                item.transpose()?;
                scan?;
            }
        };
        let error: Error = work.map(|outcome: Result<(), Error>| outcome.unwrap_err()).await;
        assert!(matches!(error.kind(), ErrorKind::Panicked { .. }), "{error:?}");
        assert!(driver.await.unwrap_err().is_panic());
        assert!(matches!(
            sensor.scan(WINDOW).await.unwrap_err().kind(),
            ErrorKind::Panicked { .. }
        ));
        assert!(matches!(sensor.watch_state().get(), State::Closed { error: Some(_) }));
    }
    assert!(ended_in_work > 10);
    let _ = std::panic::take_hook();
}

#[tokio::test(start_paused = true)]
async fn a06_an_observer_that_panics_ends_the_driver_with_the_cause() {
    let emulator = instant_sensor().build();
    let armed = Arc::new(AtomicBool::new(false));
    let trigger = Arc::clone(&armed);
    let sensor = builder()
        .on_reply(move |_| assert!(!trigger.load(Relaxed), "the disk is on fire"))
        .connect(emulator)
        .await
        .unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    armed.store(true, Relaxed);
    let error = loop {
        match stream.next().await {
            Some(Ok(_)) => {}
            Some(Err(error)) => break error,
            None => panic!("ended without a cause"),
        }
    };
    assert!(error.to_string().contains("the disk is on fire"), "{error}");
    assert!(stream.next().await.is_none());
    let error = sensor.scan(WINDOW).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Panicked { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn a17_closing_at_silence_takes_two_commands() {
    let silent = Faults::none().every(Fault::CommandLost);
    // The command is lost, and would be again after a fence that is answered.
    let twice = Faults::none().at(0, Fault::Lost).at(2, Fault::Lost);
    let (fast, slow) = (Rate::hz(10.0), Rate::hz(0.1));
    for (rate, faults) in [(fast, silent.clone()), (slow, silent), (slow, twice)] {
        let emulator = instant_sensor().build();
        let (sensor, mut stream) = streaming(&emulator, WINDOW, rate).await;
        scans(&mut stream, 1).await;
        emulator.set_faults(faults);
        let asker = sensor.clone();
        let request = tokio::spawn(async move { asker.laser_off().await });
        tokio::time::sleep(ms(150)).await;
        let start = tokio::time::Instant::now();
        sensor.close().await;
        assert!(start.elapsed() <= ms(1500), "{rate}: {:?}", start.elapsed());
        // A fence also confirms a command without a reply.
        assert_eq!(request.await.unwrap().is_ok(), !emulator.is_laser_on());
    }
}

#[tokio::test(start_paused = true)]
async fn a17_closing_waits_for_two_commands_at_most() {
    let silent = Faults::none().every(Fault::CommandLost);
    // The sensor answers the fence before the change, and loses either the reply to the change or
    // only the later ones.
    let from = |first| (first..100).fold(Faults::none(), |faults, n| faults.at(n, Fault::Lost));
    let (unconfirmed, accepted) = (from(1), from(2));
    // Both deadlines count, and the time of their bytes, 100 ms at most. An accepted change takes
    // 200 ms, and its fence 400 ms.
    for (faults, asked_before, limit) in
        [(silent.clone(), 0, 1600), (silent, 150, 1600), (unconfirmed, 0, 1200), (accepted, 0, 800)]
    {
        let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
        let sensor = open(&emulator).await;
        emulator.set_faults(faults);
        let asker = sensor.clone();
        let request = tokio::spawn(async move { asker.set_baud_rate(BaudRate::B115200).await });
        tokio::time::sleep(ms(asked_before)).await;
        tokio::task::yield_now().await;
        let start = tokio::time::Instant::now();
        sensor.close().await;
        assert!(start.elapsed() <= ms(limit), "{:?}", start.elapsed());
        assert!(request.await.unwrap().is_err());
    }
}

/// Returns the time for which this thread has computed. The load of the machine does not add to it.
#[cfg(unix)]
fn computed() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

#[cfg(unix)]
#[tokio::test(start_paused = true)]
async fn a10_sixteen_thousand_requests_without_a_link_take_linear_time() {
    let emulator = instant_sensor().build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    let mut state = sensor.watch_state();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
    let took = async |requests| {
        let start = computed();
        let ask = |sensor: Sensor| tokio::spawn(async move { sensor.scan(WINDOW).await });
        let asking: Vec<_> = (0..requests).map(|_| ask(sensor.clone())).collect();
        for task in asking {
            assert!(matches!(
                task.await.unwrap().unwrap_err().kind(),
                ErrorKind::NoSuchPort { .. }
            ));
        }
        computed() - start
    };
    // Compared with each other, since both depend on the machine. If each request were compared with all
    // that wait, eight times as many would take 64 times as long.
    let few = took(2000).await.max(took(2000).await);
    let many = took(16_000).await.min(took(16_000).await);
    assert!(many < 24 * few, "{few:?} for 2,000, {many:?} for 16,000");
}

#[tokio::test(start_paused = true)]
async fn a08_a_failed_change_keeps_the_baud_rate() {
    let emulator = instant_sensor().baud_rate(BaudRate::B57600).build();
    let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(2.0)).await;
    let mut delivered = scans(&mut stream, 2).await;
    // The sensor refuses; a flipped bit makes that a success; its baud rate stays.
    let faults = Faults::none().at(1, Fault::Status(b'1')).at(1, Fault::Flip(15, b'1' ^ b'0'));
    emulator.set_faults(faults);
    let error = sensor.set_baud_rate(BaudRate::B250000).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NotConfirmed { .. }), "{error:?}");
    delivered.extend(scans(&mut stream, 3).await);
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
    assert_eq!((emulator.baud_rate(), sensor.stats().disconnects), (Some(BaudRate::B57600), 0));
}

#[test]
fn a11_the_driver_never_times_anything_by_the_wall_clock() {
    // One file reads the wall clock, for a scan's stamp, which is not computed with.
    let mut asking = Vec::new();
    let mut folders = vec![std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/driver")];
    let mut files = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            // Those have scans of their own.
            if path.ends_with("tests.rs") {
                continue;
            }
            files += 1;
            let text = std::fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
            let asks = |line: &str| line.contains("SystemTime::") && !line.contains("use ");
            assert!(!code.contains("UNIX_EPOCH"), "{path:?}");
            if code.contains("wall_clock") || code.lines().any(asks) {
                asking.push(path);
            }
        }
    }
    assert!(files > 5, "the sources were not read");
    assert!(matches!(&asking[..], [path] if path.ends_with("transport/mod.rs")), "{asking:?}");
}

#[test]
fn a12_a_runtime_without_a_timer_panics_with_tokios_own_message() {
    let emulator = runtime().block_on(async { instant_sensor().build() });
    let no_timer = Builder::new_current_thread().build().unwrap();
    let caught = |work: &dyn Fn()| {
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_err();
        let text = caught.downcast_ref::<&str>().map(|text| (*text).to_owned());
        text.or_else(|| caught.downcast_ref::<String>().cloned()).unwrap()
    };
    let text = caught(&|| {
        let (_sensor, driver) = builder().build(emulator.clone());
        let _ = no_timer.block_on(driver);
    });
    assert!(text.contains("timers are disabled") || text.contains("enable_time"), "{text}");
    // Without any runtime opening panics; building, requesting and dropping do not.
    let text = caught(&|| drop(Sensor::open("tcp://127.0.0.1:1").now_or_never()));
    assert!(text.contains("runtime"), "{text}");
    let (sensor, driver) = builder().build(emulator.clone());
    drop(driver);
    let scan = sensor.scan(WINDOW).now_or_never();
    assert!(scan.is_none_or(|scan| matches!(scan.unwrap_err().kind(), ErrorKind::Closed)));
}

#[tokio::test(start_paused = true)]
async fn a13_a_port_that_always_has_bytes_starves_no_other_task() {
    for pattern in [&b"x"[..], b"\n", b"\0"] {
        let beats = Arc::new(AtomicU64::new(0));
        let heart = tokio::spawn({
            let beats = Arc::clone(&beats);
            async move {
                loop {
                    beats.fetch_add(1, Relaxed);
                    tokio::time::sleep(ms(1)).await;
                }
            }
        });
        let opened = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&opened);
        let connect = ConnectFn(move || {
            count.fetch_add(1, Relaxed);
            Ok(EndlessPort::new(pattern))
        });
        let (sensor, driver) = builder().wait_for_sensor(true).build(connect);
        let driver = tokio::spawn(driver);
        // The clock is paused: it advances only when the driver has yielded.
        tokio::time::sleep(Duration::from_secs(10)).await;
        assert!(beats.load(Relaxed) > 9_900, "{}", beats.load(Relaxed));
        assert!((5..30).contains(&opened.load(Relaxed)), "{}", opened.load(Relaxed));
        drop(sensor);
        drop((driver, heart.abort()));
    }
}

#[tokio::test(start_paused = true)]
async fn a16_a_killed_process_leaves_nothing_broken() {
    for (left, speed) in [
        (&b"L0\n"[..], BaudRate::B19200),
        (b"G0447", BaudRate::B750000),
        (b"S2500000000000\n", BaudRate::B115200),
        (b"G04472501\nV\nL0\nG0007", BaudRate::B57600),
    ] {
        let emulator: Emulator = instant_sensor().baud_rate(speed).build();
        let mut link = emulator.link();
        link.set_baud_rate(speed).unwrap();
        link.write_all(left).await.unwrap();
        tokio::time::sleep(ms(10)).await;
        drop(link);
        let (_sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(1.0)).await;
        let scan = scans(&mut stream, 1).await.remove(0);
        assert!(request_of(&scan).is_some(), "{}", left.escape_ascii());
    }
}
