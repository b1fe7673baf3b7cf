//! Opening: the search for the sensor, the change to the wanted baud rate, and each way to
//! fail.

use std::collections::HashSet;
use std::future::pending;
use std::io;
use std::mem::discriminant;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use crate::common::faulty_link::FaultyLink;
use crate::common::hooked::{Hooked, Hooks};
use crate::common::{ConnectFn, builder, ms, truthful};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
use tokio::time::Instant;
use tokio_scip::port::{Connect, StreamPort};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Error, ErrorKind, Sensor, SensorBuilder, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Firmware, Mode, Pace};

async fn fails(emulator: &Emulator) -> Error {
    builder().connect(emulator.clone()).await.unwrap_err()
}

fn baud_rate(sensor: &Sensor) -> Option<BaudRate> {
    sensor.watch_state().get().baud_rate()
}

#[tokio::test(start_paused = true)]
async fn o08_a_sensor_is_found_at_each_baud_rate_and_keeps_it() {
    for speed in BaudRate::ALL {
        let emulator = truthful().baud_rate(speed).build();
        let start = Instant::now();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        assert!(start.elapsed() < ms(4000), "{speed}: {:?}", start.elapsed());
        assert_eq!((baud_rate(&sensor), emulator.baud_rate()), (Some(speed), Some(speed)));
        assert_eq!(sensor.scan(Window::DETECTION).await.unwrap().len(), 682);
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_is_changed_from_each_baud_rate_to_each() {
    for from in BaudRate::ALL {
        for to in BaudRate::ALL {
            let emulator = truthful().baud_rate(from).build();
            let sensor = builder().baud_rate(to).connect(emulator.clone()).await.unwrap();
            assert_eq!((baud_rate(&sensor), emulator.baud_rate()), (Some(to), Some(to)));
            assert_eq!(sensor.scan(Window::DETECTION).await.unwrap().len(), 682);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_on_usb_has_no_baud_rate_and_needs_none() {
    for firmware in [Firmware::Text, Firmware::V3] {
        let emulator = truthful().firmware(firmware).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        assert_eq!(baud_rate(&sensor), None);
        sensor.scan(Window::FULL).await.unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn the_version_is_read_from_both_kinds_of_firmware() {
    let emulator = truthful().firmware(Firmware::V3).serial_number("H0713090").build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let before = emulator.counts().commands;
    let version = sensor.version().await.unwrap();
    assert_eq!(version.product, "SOKUIKI Sensor URG-04LX");
    assert_eq!(version.serial_number, "H0713090");
    assert!(version.status.is_some());
    assert_eq!(emulator.counts().commands, before, "the version was asked for again");

    let emulator = truthful().firmware(Firmware::Text).build();
    let sensor = builder().connect(emulator).await.unwrap();
    let version = sensor.version().await.unwrap();
    assert_eq!(version.vendor, "Hokuyo Automatic Co., Ltd.");
    assert_eq!((version.status, version.specification), (None, None));
}

#[tokio::test(start_paused = true)]
async fn a_silent_sensor_is_an_error_after_all_baud_rates() {
    let emulator = truthful().baud_rate(BaudRate::B19200).faults(Faults::none().every(Fault::Lost));
    let start = Instant::now();
    let error = builder().name("left").connect(emulator.build()).await.unwrap_err();
    assert!(
        matches!(error.kind(), ErrorKind::NoAnswer { baud_rate: None, searched: true, .. }),
        "{error:?}"
    );
    assert!(start.elapsed() >= Duration::from_secs(5) && start.elapsed() < ms(5600));
    assert!(error.to_string().starts_with("left does not answer at any baud rate"));
}

#[tokio::test(start_paused = true)]
async fn a_silent_sensor_on_usb_is_an_error() {
    let error = fails(&truthful().faults(Faults::none().every(Fault::Lost)).build()).await;
    assert!(
        matches!(error.kind(), ErrorKind::NoAnswer { baud_rate: None, searched: false, .. }),
        "{error:?}"
    );
    // These have a sensor's USB id.
    assert!(error.to_string().contains("UST-05LN or UTX-10LN does not speak SCIP"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn bytes_that_are_no_reply_are_counted_in_the_error() {
    let (near, mut far) = duplex(256);
    far.write_all(b"hello\n\n").await.unwrap();
    let error = builder().attach(near).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NoAnswer { bytes: 7, .. }), "{error:?}");
    assert!(error.to_string().starts_with("the sensor does not answer"), "{error}");
    assert_eq!(error.sensor(), None, "a stream has no name");
}

#[tokio::test(start_paused = true)]
async fn w24_d05_d06_scip_2_is_recognised_at_once() {
    for mode in [Mode::Scip2, Mode::Scip2Streaming] {
        let emulator = truthful().build();
        emulator.set_mode(mode);
        let start = Instant::now();
        let scip1 = builder().name("left").protocol(Protocol::Scip1);
        let error = scip1.connect(emulator.clone()).await.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::WrongProtocol { .. }), "{error:?}");
        let text = error.to_string();
        assert!(text.starts_with("left speaks SCIP 2"), "{text}");
        assert!(text.contains("you asked for SCIP 1.1"), "{text}");
        builder().connect(emulator).await.unwrap();
        assert!(start.elapsed() < ms(1000));
    }
}

#[tokio::test(start_paused = true)]
async fn w22_a_loopback_is_distinguished_from_a_silent_sensor() {
    let (near, mut far) = duplex(256);
    tokio::spawn(async move {
        let (mut read, mut write) = tokio::io::split(&mut far);
        let _ = tokio::io::copy(&mut read, &mut write).await;
    });
    let error = builder().name("left").attach(near).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Loopback), "{error:?}");
    assert!(error.to_string().starts_with("left returns what is written to it"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn w22_an_echo_of_the_commands_is_a_loopback_too() {
    // Half-duplex wiring: every command comes back, then its reply follows.
    let emulator = truthful().build();
    let (near, mut far) = duplex(4096);
    tokio::spawn(async move {
        let mut link = emulator.link();
        let (mut command, mut reply) = ([0; 64], [0; 4096]);
        loop {
            tokio::select! {
                read = far.read(&mut command) => {
                    let read = read.unwrap_or(0);
                    if read == 0 { return }
                    far.write_all(&command[..read]).await.unwrap();
                    link.write_all(&command[..read]).await.unwrap();
                }
                read = link.read(&mut reply) => {
                    far.write_all(&reply[..read.unwrap()]).await.unwrap();
                }
            }
        }
    });
    let error = builder().attach(near).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Loopback), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn w21_translated_line_ends_are_reported_at_once() {
    let start = Instant::now();
    let error = fails(&truthful().faults(Faults::none().every(Fault::CrLf)).build()).await;
    assert!(start.elapsed() < ms(1000), "{:?}", start.elapsed());
    let source = std::error::Error::source(&error).unwrap().to_string();
    assert!(source.contains("raw mode"), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn a_malformed_first_reply_spares_the_opening() {
    // A byte of the data that is no character of SCIP.
    let emulator = truthful().faults(Faults::none().at(0, Fault::Flip(12, 0x80))).build();
    let malformed = builder().connect(emulator).await.unwrap().stats().malformed;
    assert_eq!((malformed.character, malformed.total()), (1, 1));
}

#[tokio::test(start_paused = true)]
async fn two_programs_begin_with_different_fences() {
    async fn first_fence(builder: SensorBuilder) -> Vec<u8> {
        let emulator = truthful().build();
        builder.connect(emulator.clone()).await.unwrap();
        let log = emulator.log();
        log.into_iter().find(|received| received.line.starts_with(b"G")).unwrap().line
    }
    assert_eq!(first_fence(builder()).await, first_fence(builder()).await);
    let mut different = HashSet::new();
    for _ in 0..5 {
        different.insert(first_fence(Sensor::builder()).await);
    }
    assert!(different.len() > 1, "{different:?}");
}

#[tokio::test(start_paused = true)]
async fn an_unplugged_sensor_is_no_such_port_without_wait_for_sensor() {
    let emulator = truthful().build();
    emulator.unplug();
    assert!(matches!(fails(&emulator).await.kind(), ErrorKind::NoSuchPort { .. }));

    let (sensor, driver) = builder().wait_for_sensor(true).build(emulator.clone());
    let state = sensor.watch_state();
    tokio::spawn(driver);
    let waiting = tokio::spawn(async move { sensor.watch_state().connected().await });
    tokio::time::sleep(Duration::from_secs(3600)).await;
    assert!(!waiting.is_finished());
    let State::Connecting { error: Some(error) } = state.get() else { panic!("{state:?}") };
    assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error:?}");
    emulator.plug_in();
    let start = Instant::now();
    waiting.await.unwrap().unwrap();
    assert!(start.elapsed() < ms(2000), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn t10_a_sensor_that_boots_slowly_is_waited_for() {
    let emulator = truthful().boot_time(Duration::from_secs(20)).build();
    emulator.power_cycle();
    assert!(matches!(fails(&emulator).await.kind(), ErrorKind::NoAnswer { .. }));
    let sensor = builder().wait_for_sensor(true).connect(emulator).await.unwrap();
    sensor.watch_state().connected().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn permanent_errors_end_a_driver_that_waits() {
    let emulator = truthful().build();
    emulator.set_mode(Mode::Scip2);
    let waiting = builder().protocol(Protocol::Scip1).wait_for_sensor(true);
    let sensor = waiting.connect(emulator).await.unwrap();
    let error = sensor.watch_state().connected().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::WrongProtocol { .. }));
}

#[tokio::test(start_paused = true)]
async fn o04_a_port_in_use_is_reported_as_such() {
    let emulator = truthful().build();
    let _first = builder().connect(emulator.clone()).await.unwrap();
    assert!(matches!(fails(&emulator).await.kind(), ErrorKind::Busy { .. }));
}

#[tokio::test(start_paused = true)]
async fn another_sensor_than_the_expected_one_is_refused() {
    let emulator = truthful().serial_number("H0000001").build();
    let other = builder().name("left").serial_number("H0000002");
    let error = other.connect(emulator.clone()).await.unwrap_err();
    assert!(error.to_string().starts_with("left has the wrong serial number"), "{error}");
    let ErrorKind::AnotherSensor { expected, found, .. } = error.kind() else {
        panic!("{error:?}")
    };
    assert_eq!((expected.to_string(), found.to_string()), ("H0000002".into(), "H0000001".into()));
    let sensor = builder().serial_number("H0000001").connect(emulator.clone()).await.unwrap();
    let serial_number = sensor.version().await.unwrap().serial_number;
    assert_eq!(serial_number, "H0000001".to_owned());
    sensor.close().await;
    builder().serial_number(serial_number).connect(emulator).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn t05_o07_remains_of_another_program_are_harmless() {
    use urg_emulator::EmptyCommand;
    for empty in [EmptyCommand::Silence, EmptyCommand::Status, EmptyCommand::LineFeeds] {
        let emulator = truthful().empty_command(empty).build();
        let mut link = emulator.link();
        link.write_all(b"G04472501\nV\nG0007").await.unwrap();
        drop(link);
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        sensor.scan(Window::FULL).await.unwrap();
        assert!(sensor.stats().bytes_skipped > 0);
    }
}

#[tokio::test(start_paused = true)]
async fn o11_a_bridge_has_one_baud_rate_and_the_sensor_keeps_it() {
    use urg_emulator::Link;
    struct Bridge(Emulator, BaudRate);
    impl tokio_scip::port::Connect for Bridge {
        type Port = Link;
        async fn connect(&mut self) -> Result<Link, Error> {
            Ok(self.0.bridge(self.1))
        }
    }
    let emulator = truthful().baud_rate(BaudRate::B57600).build();
    let bridge = |speed| Bridge(emulator.clone(), speed);
    let error = builder().connect(bridge(BaudRate::B19200)).await.unwrap_err();
    assert!(
        matches!(error.kind(), ErrorKind::NoAnswer { baud_rate: Some(BaudRate::B19200), .. }),
        "{error:?}"
    );
    let text = error.to_string();
    assert!(text.contains("the serial server (19200 in its address)"), "{text}");

    let sensor = builder().name("left").connect(bridge(BaudRate::B57600)).await.unwrap();
    sensor.scan(Window::FULL).await.unwrap();
    let error = sensor.set_baud_rate(BaudRate::B115200).await.unwrap_err();
    assert!(
        matches!(error.kind(), ErrorKind::UnsupportedBaudRate { source: None, .. }),
        "{error:?}"
    );
    assert!(error.to_string().starts_with("the port of left cannot be set to 115200 baud: its"));
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B57600));
    sensor.scan(Window::FULL).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn extreme_settings_are_replaced_by_the_nearest_valid_ones() {
    let emulator = truthful().build();
    let longest = Duration::MAX;
    let wild = builder().depth(usize::MAX).open_timeout(longest).reply_latency(longest);
    let sensor = wild.backoff(longest..=longest).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, tokio_scip::Rate::UNLIMITED).await.unwrap();
    stream.next().await.unwrap().unwrap();
    sensor.close().await;

    // Without any pause it would be a busy loop.
    let none = Duration::ZERO;
    let eager = builder().backoff(none..=none).connect(emulator.clone()).await.unwrap();
    emulator.unplug();
    let error = eager.scan(Window::FULL).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error:?}");
}

/// Nothing answers on a port whose baud rate cannot be changed.
#[tokio::test(start_paused = true)]
async fn zero_latency_makes_no_busy_loop() {
    let written = Arc::new(AtomicU64::new(0));
    let count = CountWrites(Arc::clone(&written));
    let (near, _silent) = duplex(1 << 20);
    let port = Hooked { port: StreamPort::new(near), hooks: count };
    let mut ports = Some(port).into_iter();
    let connect =
        move || Ok(ports.next().ok_or(ErrorKind::NoSuchPort { port: "it".to_owned() })?);
    let opening = builder().reply_latency(Duration::ZERO).connect(ConnectFn(connect));
    let error = opening.await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NoAnswer { .. }), "{error:?}");
    let written = written.load(Relaxed);
    assert!((10..=1000).contains(&written), "{written} fences in five seconds");
}

/// A request to a sensor that was never there says why, and what to do.
#[tokio::test(start_paused = true)]
async fn a_request_says_why_no_link_exists() {
    let port = || "it".to_owned();
    let [refused, unreachable, unknown] =
        [io::ErrorKind::ConnectionRefused, io::ErrorKind::HostUnreachable, io::ErrorKind::NotFound]
            .map(io::Error::from);
    for (error, remedy) in [
        (ErrorKind::NoSuchPort { port: port() }.into(), "no port it: plug the sensor in"),
        (ErrorKind::PermissionDenied { port: port(), group: None }.into(), "give the user read"),
        (ErrorKind::Busy { port: port() }.into(), "stop the program that has it open"),
        (Error::open(port(), refused), "cannot open it: a sensor on Ethernet may still boot"),
        (Error::open("tcp://it", unreachable), "give this computer an address in the same network"),
        (Error::open("tcp://it", unknown), "cannot open tcp://it: check the name of the host"),
        (ErrorKind::NoSuchPort { port: "ttyS9".to_owned() }.into(), "whole path, /dev/ttyS9"),
    ] {
        let failure = error.clone();
        let connect = ConnectFn(move || Err::<StreamPort<DuplexStream>, _>(failure.clone()));
        check_reason(connect, &error, remedy).await;
    }
    let silent = truthful().baud_rate(BaudRate::B19200).build();
    silent.set_faults(Faults::none().every(Fault::CommandLost));
    let error = fails(&silent).await;
    assert!(matches!(error.kind(), ErrorKind::NoAnswer { searched: true, .. }), "{error:?}");
    check_reason(silent, &error, "check its power and the wiring").await;
    // While the first attempt lasts, there is no other reason than silence.
    let (sensor, driver) = builder().request_timeout(ms(1)).build(ConnectNever);
    let _driver = tokio::spawn(driver);
    let error = sensor.version().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NoAnswer { .. }), "{error:?}");
}

/// Checks the error of each request while the driver waits for a sensor that is not there.
async fn check_reason(connect: impl Connect, expected: &Error, remedy: &str) {
    let (sensor, driver) = builder().name("it").wait_for_sensor(true).build(connect);
    let _driver = tokio::spawn(driver);
    let errors = tokio::join!(
        sensor.version(),
        sensor.laser_off(),
        sensor.set_baud_rate(BaudRate::B115200),
        sensor.scan(Window::FULL),
    );
    let errors = [errors.0.err(), errors.1.err(), errors.2.err(), errors.3.err()];
    for error in errors.map(Option::unwrap) {
        assert_eq!(discriminant(error.kind()), discriminant(expected.kind()), "{error:?}");
        assert!(error.to_string().contains(remedy), "{error}");
        assert_eq!(error.sensor(), Some("it"));
    }
}

/// Connects for ever.
struct ConnectNever;

impl Connect for ConnectNever {
    type Port = StreamPort<DuplexStream>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        pending().await
    }
}

/// Counts writes, and fails the test instead of blocking it for ever.
struct CountWrites(Arc<AtomicU64>);

impl Hooks for CountWrites {
    fn before_write(&mut self, _bytes: &[u8]) {
        assert!(self.0.fetch_add(1, Relaxed) < 100_000, "a busy loop");
    }
}

/// Ports that are tried one after another: the first `useless` of them stay silent, or fail
/// to open.
struct Several {
    emulator: Emulator,
    left: usize,
    opens: bool,
    /// Number of times that the right sensor was found.
    found: Arc<AtomicU64>,
}

impl tokio_scip::port::Connect for Several {
    type Port = Box<dyn tokio_scip::port::Port>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        if self.left == 0 {
            return Ok(Box::new(self.emulator.link()));
        }
        self.left -= 1;
        if !self.opens {
            std::future::pending::<()>().await;
        }
        // It answers fences, and never `V`.
        let mut faults = Faults::none();
        for reply in 0..100 {
            faults = faults.at(reply, if reply == 0 { Fault::Late(ms(0)) } else { Fault::Lost });
        }
        Ok(Box::new(Emulator::builder().faults(faults).build().link()))
    }

    fn hints(&mut self) -> Option<&mut dyn tokio_scip::port::ConnectHints> {
        Some(self)
    }
}

impl tokio_scip::port::ConnectHints for Several {
    fn has_more(&mut self) -> bool {
        true
    }

    fn found(&mut self) {
        self.found.fetch_add(1, Relaxed);
    }
}

#[tokio::test(start_paused = true)]
async fn several_ports_are_tried_in_turn_until_one_is_accepted() {
    for opens in [true, false] {
        let emulator = truthful().build();
        let found = Arc::new(AtomicU64::new(0));
        let connect =
            Several { emulator: emulator.clone(), left: 2, opens, found: Arc::clone(&found) };
        let sensor = builder().connect(connect).await.unwrap();
        sensor.scan(Window::FULL).await.unwrap();
        assert!(emulator.is_connected());
        assert_eq!(found.load(Relaxed), 1);
    }
}

#[tokio::test(start_paused = true)]
async fn a_new_port_that_denies_permission_for_a_moment_is_opened() {
    struct Plugged(Emulator, usize);
    impl tokio_scip::port::Connect for Plugged {
        type Port = urg_emulator::Link;
        async fn connect(&mut self) -> Result<Self::Port, Error> {
            let port = || "/dev/ttyACM0".to_owned();
            self.1 += 1;
            match self.1 {
                1..=3 => Err(ErrorKind::NoSuchPort { port: port() }.into()),
                4 => Err(ErrorKind::PermissionDenied { port: port(), group: None }.into()),
                _ => Ok(self.0.link()),
            }
        }
    }
    let emulator = truthful().build();
    let plugged = |tries| Plugged(emulator.clone(), tries);
    let sensor = builder().wait_for_sensor(true).connect(plugged(0)).await.unwrap();
    sensor.watch_state().connected().await.unwrap();
    // Without `wait_for_sensor` the error is returned at once.
    let error = builder().connect(plugged(3)).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::PermissionDenied { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn o07_bytes_buffered_while_the_port_was_closed_are_not_a_flood() {
    let emulator = truthful().build();
    let link = emulator.link();
    emulator.inject(b"xyz\n\n".repeat(2000));
    tokio::time::sleep(ms(1000)).await;
    let sensor = builder().attach(FaultyLink::new(link).short_reads(64)).await.unwrap();
    sensor.scan(Window::FULL).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn half_a_command_of_another_program_delays_no_opening() {
    for command in [&b"G04472501"[..], b"V", b"L0", b"S1152000000000", b"\0\xff"] {
        for length in 1..=command.len() {
            let emulator = truthful().pace(Pace::AtOnce).build();
            emulator.link().write_all(&command[..length]).await.unwrap();
            let begin = Instant::now();
            let sensor = builder().connect(emulator.clone()).await.unwrap();
            sensor.scan(Window::DETECTION).await.unwrap();
            assert!(begin.elapsed() < ms(100), "{:?}", command[..length].escape_ascii());
            assert!(emulator.is_laser_on());
        }
    }
}

/// A booting sensor refuses `V` in the form of SCIP 1.1, as Hokuyo's UrgBenri tells its users.
#[tokio::test(start_paused = true)]
async fn t10_a_sensor_that_refuses_to_tell_what_it_is_while_it_boots_is_found() {
    let booted = Instant::now() + ms(2000);
    let (near, far) = duplex(4096);
    tokio::spawn(async move {
        let (read, mut write) = tokio::io::split(far);
        let mut commands = tokio::io::BufReader::new(read).lines();
        while let Ok(Some(command)) = commands.next_line().await {
            let reply = match &command[..] {
                "" => continue,
                "V" if Instant::now() >= booted => "0\nSERI:H0713090",
                _ => "E",
            };
            write.write_all(format!("{command}\n{reply}\n\n").as_bytes()).await.unwrap();
        }
    });
    let sensor = builder().attach(near).await.unwrap();
    assert!(Instant::now() >= booted && Instant::now() < booted + ms(500));
    assert_eq!(sensor.version().await.unwrap().serial_number.as_bytes(), b"H0713090");
}
