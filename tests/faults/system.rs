//! Rows O: ports and the operating system.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{BaudRate, Error, ErrorKind, Rate, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Link};

use super::rig::{instant_sensor, scans, streaming, wrong_scans};
use crate::common::faulty_link::{Call, FaultyLink, LinkFailure};
use crate::common::hooked::{Hooked, Hooks};
use crate::common::{ConnectFn, builder, ms};

const WINDOW: Window = Window::DETECTION;

/// Counts of what the driver did with this port and those before it.
#[derive(Default)]
struct LinkCounts {
    open: AtomicU64,
    discarded: AtomicU64,
    reads_after_end: AtomicU64,
}

/// Counts how a port is used.
struct CountedUse {
    counts: Arc<LinkCounts>,
    ended: bool,
}

impl CountedUse {
    fn new(counts: &Arc<LinkCounts>) -> Self {
        counts.open.fetch_add(1, Relaxed);
        Self { counts: Arc::clone(counts), ended: false }
    }
}

impl Drop for CountedUse {
    fn drop(&mut self) {
        self.counts.open.fetch_sub(1, Relaxed);
    }
}

impl Hooks for CountedUse {
    fn before_read(&mut self) {
        self.counts.reads_after_end.fetch_add(u64::from(self.ended), Relaxed);
    }

    fn after_read(&mut self, count: usize) {
        self.ended |= count == 0;
    }

    fn on_flush(&mut self) {
        panic!("flush called: it waits for the port to drain and blocks the runtime")
    }

    fn on_discard(&mut self) {
        self.counts.discarded.fetch_add(1, Relaxed);
    }
}

#[tokio::test(start_paused = true)]
async fn o01_o03_o16_o17_a_hung_up_port_is_closed_first() {
    let emulator = instant_sensor().build();
    let counts = Arc::new(LinkCounts::default());
    let (inner, links, mut opened) = (emulator.clone(), Arc::clone(&counts), 0);
    let connect = ConnectFn(move || {
        // The system can reuse a port's name only when nobody has the old one open.
        assert_eq!(links.open.load(Relaxed), 0, "the old port is still open");
        opened += 1;
        // Absent at first, then back under another name, which is the connector's concern.
        if opened == 2 {
            return Err(ErrorKind::NoSuchPort { port: "/dev/ttyACM0".to_owned() }.into());
        }
        Ok(Hooked { port: inner.link(), hooks: CountedUse::new(&links) })
    });
    let sensor = builder().depth(16).connect(connect).await.unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let mut delivered = Vec::new();
    for rounds in 1..20 {
        delivered.extend(scans(&mut stream, 2).await);
        emulator.unplug();
        emulator.plug_in();
        assert!(matches!(
            stream.next().await.unwrap().unwrap_err().kind(),
            ErrorKind::Disconnected { .. }
        ));
        tokio::task::yield_now().await;
        assert_eq!((counts.open.load(Relaxed), counts.discarded.load(Relaxed)), (0, rounds));
    }
    sensor.laser_off().await.unwrap();
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
    assert_eq!(counts.reads_after_end.load(Relaxed), 0, "a port was read after its end");
}

#[tokio::test(start_paused = true)]
async fn o05_a_denied_permission_is_not_reported_as_an_unplugged_port() {
    let denied = || ErrorKind::PermissionDenied {
        port: "/dev/ttyACM0".to_owned(),
        group: Some("dialout".to_owned()),
    };
    assert!(denied().to_string().contains("usermod -aG dialout"), "{}", denied());
    // At opening it ends the attempt, even with `wait_for_sensor`.
    let refused = ConnectFn(move || Err::<Link, _>(denied().into()));
    let sensor = builder().wait_for_sensor(true).connect(refused).await.unwrap();
    let error = sensor.watch_state().connected().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::PermissionDenied { .. }), "{error:?}");

    // Later a stream reports it once, and the state shows it.
    let emulator = instant_sensor().build();
    let (inner, mut opened) = (emulator.clone(), 0);
    let connect = ConnectFn(move || {
        opened += 1;
        if (2..50).contains(&opened) { Err(denied().into()) } else { Ok(inner.link()) }
    });
    let sensor = builder().connect(connect).await.unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    scans(&mut stream, 1).await;
    emulator.unplug();
    emulator.plug_in();
    let mut errors = Vec::new();
    while let Ok(Some(Err(error))) = tokio::time::timeout(ms(5000), stream.next()).await {
        errors.push(error);
    }
    let reported = matches!(errors.last().unwrap().kind(), ErrorKind::PermissionDenied { .. });
    assert!(reported && errors.len() <= 2, "{errors:?}");
    let state = sensor.watch_state().get();
    let State::Disconnected { error, .. } = state else { panic!("{state:?}") };
    assert!(matches!(error.kind(), ErrorKind::PermissionDenied { .. }), "{error:?}");
    scans(&mut stream, 1).await;
}

#[tokio::test(start_paused = true)]
async fn o10_s_on_usb_changes_neither_baud_rate() {
    let emulator = instant_sensor().build();
    let sensor = builder().baud_rate(BaudRate::B115200).connect(emulator.clone()).await.unwrap();
    sensor.set_baud_rate(BaudRate::B750000).await.unwrap();
    let state = sensor.watch_state().get();
    assert!(matches!(state, State::Connected { baud_rate: None, .. }), "{state:?}");
    sensor.scan(WINDOW).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn o12_a_refused_baud_rate_is_never_sent() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
    let inner = emulator.clone();
    let connect = ConnectFn(move || {
        let link = FaultyLink::new(inner.link());
        // The first change of baud rate is the one at opening.
        Ok(link.fail(Call::SetBaudRate, 1, LinkFailure::Kind(io::ErrorKind::InvalidInput)))
    });
    let sensor = builder().connect(connect).await.unwrap();
    let error = sensor.set_baud_rate(BaudRate::B750000).await.unwrap_err();
    assert!(
        matches!(error.kind(), ErrorKind::UnsupportedBaudRate { source: Some(_), .. }),
        "{error:?}"
    );
    assert!(emulator.log().iter().all(|line| !line.line.starts_with(b"S")));
    sensor.scan(WINDOW).await.unwrap();
    sensor.set_baud_rate(BaudRate::B115200).await.unwrap();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200));
}

#[tokio::test(start_paused = true)]
async fn o12_a_port_without_baud_rates_is_reported() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
    let inner = emulator.clone();
    let connect = ConnectFn(move || {
        let refuse = |link: FaultyLink<_>, call| {
            link.fail(Call::SetBaudRate, call, LinkFailure::Kind(io::ErrorKind::InvalidInput))
        };
        Ok((0..12).fold(FaultyLink::new(inner.link()), refuse))
    });
    let error = builder().connect(connect).await.unwrap_err();
    let source = std::error::Error::source(&error).map(ToString::to_string);
    assert_eq!(
        source.as_deref(),
        Some("the port supports none of the six baud rates"),
        "{error:?}"
    );
    assert!(emulator.log().is_empty(), "commands were sent at an unknown baud rate");
}

/// As behind a CP2102, which has no 750,000 baud.
#[tokio::test(start_paused = true)]
async fn a_silent_sensor_may_be_at_a_baud_rate_that_the_port_lacks() {
    let emulator = instant_sensor().baud_rate(BaudRate::B750000).build();
    let inner = emulator.clone();
    let connect = ConnectFn(move || {
        let refuse = |link: FaultyLink<_>, pass: u64| {
            link.fail(Call::SetBaudRate, 6 * pass + 5, LinkFailure::Kind(io::ErrorKind::Other))
        };
        Ok((0..5).fold(FaultyLink::new(inner.link()), refuse))
    });
    let error = builder().connect(connect).await.unwrap_err();
    assert!(
        matches!(error.kind(), ErrorKind::NoAnswer { refused, .. } if *refused == [BaudRate::B750000]),
        "{error:?}"
    );
    assert!(error.to_string().contains("power-cycle it if it is at 750000 baud"), "{error}");
}

/// As behind adapters that report the requested baud rate and run at another one.
#[tokio::test(start_paused = true)]
async fn a_sensor_that_is_lost_at_its_new_baud_rate_is_explained() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    // Reply 0 is that to a fence, reply 1 that to `S`.
    emulator
        .set_faults((2..50).fold(Faults::none(), |faults, reply| faults.at(reply, Fault::Lost)));
    let error = sensor.set_baud_rate(BaudRate::B250000).await.unwrap_err();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B250000));
    let text = error.to_string();
    assert!(text.contains("does not answer at the new baud rate"), "{text}");
    assert!(text.contains("some adapters misreport theirs"), "{text}");
}

/// Returns a connector whose first link is the faulty one that `rig` makes; all later links
/// have no fault.
fn first_faulty(
    emulator: &Emulator,
    rig: impl Fn(FaultyLink<Link>) -> FaultyLink<Link> + Send + 'static,
) -> ConnectFn<impl FnMut() -> Result<FaultyLink<Link>, Error> + Send + 'static> {
    let (emulator, mut first) = (emulator.clone(), true);
    ConnectFn(move || {
        let link = FaultyLink::new(emulator.link());
        Ok(if std::mem::take(&mut first) { rig(link) } else { link })
    })
}

#[tokio::test(start_paused = true)]
async fn o13_a_stalled_write_reopens_the_port() {
    let emulator = instant_sensor().build();
    let connect = first_faulty(&emulator, |link| link.fail(Call::Write, 5, LinkFailure::Stall));
    let sensor = builder().connect(connect).await.unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let start = Instant::now();
    let mut delivered = Vec::new();
    loop {
        match stream.next().await.unwrap() {
            Ok(scan) => delivered.push(scan),
            Err(error) => {
                break assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error:?}");
            }
        }
    }
    delivered.extend(scans(&mut stream, 3).await);
    // A poll and six fences, one pass of 2.5 s over the baud rates, and a new port.
    assert!(start.elapsed() < Duration::from_secs(8), "{:?}", start.elapsed());
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
    assert_eq!(sensor.stats().disconnects, 1);
}

#[tokio::test(start_paused = true)]
async fn o14_commands_arrive_whole_through_a_slow_port() {
    for most in [1, 2, 3, 7] {
        let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
        let inner = emulator.clone();
        let connect = ConnectFn(move || Ok(FaultyLink::new(inner.link()).partial_writes(most)));
        let sensor = builder().baud_rate(BaudRate::B500000).connect(connect).await.unwrap();
        let scan = sensor.scan(WINDOW).await.unwrap();
        sensor.laser_off().await.unwrap();
        assert_eq!(wrong_scans(&emulator, &[scan]), [""; 0]);
        assert_eq!(emulator.counts().malformed, 0);
    }
}

#[tokio::test(start_paused = true)]
async fn o15_an_interrupted_call_is_retried_and_not_reported() {
    for kind in [io::ErrorKind::Interrupted, io::ErrorKind::WouldBlock] {
        let emulator = instant_sensor().baud_rate(BaudRate::B115200).build();
        let connect = first_faulty(&emulator, move |mut link| {
            for call in 0..1000 {
                link = link.fail(Call::Read, call, LinkFailure::Kind(kind));
                link = link.fail(Call::Write, call, LinkFailure::Kind(kind));
            }
            link
        });
        let sensor = builder().connect(connect).await.unwrap();
        let mut stream = sensor.scans(WINDOW, Rate::hz(5.0)).await.unwrap();
        for _ in 0..20 {
            stream.next().await.unwrap().unwrap();
        }
        let stats = sensor.stats();
        assert_eq!((stats.disconnects, stats.timeouts), (0, 0), "{kind}");
    }
}

#[test]
fn o18_messages_and_guide_name_the_programs_that_probe_new_ports() {
    // The driver cannot prevent that they probe; messages and guide name them.
    let busy = ErrorKind::Busy { port: "/dev/ttyACM0".to_owned() }.to_string();
    assert!(busy.contains("gpsd") && busy.contains("sudo fuser /dev/ttyACM0"), "{busy}");
    // Neither exists on Windows.
    let busy = ErrorKind::Busy { port: "COM3".to_owned() }.to_string();
    assert_eq!(busy, "COM3 is in use: stop the program that has it open");
    let guide = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/guide/operating.md"));
    for remedy in ["ENV{ID_MM_DEVICE_IGNORE}=\"1\"", "USBAUTO=\"false\""] {
        assert!(guide.contains(remedy), "the guide has no {remedy}");
    }
}

#[tokio::test(start_paused = true)]
async fn o20_delays_of_adapters_cost_no_scan() {
    for delay in [16, 40, 100] {
        let emulator = instant_sensor().baud_rate(BaudRate::B115200).latency(ms(delay)).build();
        let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(2.0)).await;
        for _ in 0..10 {
            stream.next().await.unwrap().unwrap();
        }
        assert_eq!(sensor.stats().timeouts, 0, "{delay} ms");
    }
}

#[tokio::test]
async fn o22_a_dead_tcp_connection_is_replaced() {
    let emulator = instant_sensor().build();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let served = emulator.clone();
    let (hang_up, mut hung_up) = tokio::sync::mpsc::channel::<()>(1);
    let _server = tokio::spawn(async move {
        loop {
            let (stream, _) = listener.accept().await.unwrap();
            // Closes with a reset instead of an orderly end.
            stream.set_zero_linger().unwrap();
            tokio::select! {
                _ = served.serve(stream) => {}
                _ = hung_up.recv() => {}
            }
        }
    });
    // Short limits, because this runs in real time.
    let builder = builder().reply_latency(ms(200)).open_timeout(ms(300));
    let sensor = builder.backoff(ms(1)..=ms(10)).open(format!("tcp://{address}")).await.unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(50.0)).await.unwrap();
    scans(&mut stream, 2).await;
    hang_up.send(()).await.unwrap();
    while stream.next().await.unwrap().is_ok() {}
    scans(&mut stream, 2).await;
    assert_eq!(sensor.stats().disconnects, 1);
    // Half open: the connection exists, and nothing arrives.
    emulator.set_faults(Faults::none().every(Fault::Lost));
    let mut state = sensor.watch_state();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.map(drop).unwrap();
    emulator.set_faults(Faults::none());
    scans(&mut stream, 2).await;
}
