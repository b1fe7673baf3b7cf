//! Endpoints as text, connectors, hints and listing: what needs neither a socket nor a
//! pseudo-terminal.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::SystemTime;

use futures::FutureExt;
use tokio::io::{AsyncReadExt, AsyncWriteExt, ReadBuf};
use tokio_scip::port::{Connect, ConnectHints, Port, PortHints, StreamPort};
use tokio_scip::{BaudRate, Endpoint, ErrorKind, Sensor, Window};
use urg_emulator::Emulator;

use crate::common::set_baud_rate;
use crate::common::test_port::{FarEnd, TestPort};

fn tcp(host: &str, port: u16, baud_rate: BaudRate) -> Endpoint {
    Endpoint::Tcp { host: host.to_owned(), port, baud_rate }
}

#[test]
fn tcp_addresses_are_read_and_written() {
    let table = [
        ("tcp://bridge:4001", tcp("bridge", 4001, BaudRate::B19200)),
        ("tcp://10.0.0.7:1?baud=750000", tcp("10.0.0.7", 1, BaudRate::B750000)),
        ("tcp://my-host.lan:65535?baud=57600", tcp("my-host.lan", 65_535, BaudRate::B57600)),
        ("tcp://[::1]:4001", tcp("::1", 4001, BaudRate::B19200)),
        ("tcp://[fe80::1%eth0]:4001?baud=115200", tcp("fe80::1%eth0", 4001, BaudRate::B115200)),
    ];
    for (text, endpoint) in table {
        assert_eq!(text.parse::<Endpoint>().unwrap(), endpoint);
        assert_eq!(endpoint.to_string(), text);
        assert_eq!(Endpoint::try_from(text.to_owned()).unwrap(), endpoint);
    }
    let explicit: Endpoint = "tcp://bridge:4001?baud=19200".parse().unwrap();
    assert_eq!(explicit.to_string(), "tcp://bridge:4001", "the default goes without saying");
    for (text, host) in [("tcp://192.168.0.10", "192.168.0.10"), ("tcp://[::1]", "::1")] {
        assert_eq!(text.parse::<Endpoint>().unwrap(), tcp(host, 10_940, BaudRate::B19200));
    }
}

#[test]
fn an_invalid_port_is_refused_with_the_reason() {
    let table = [
        ("", "empty"),
        (" /dev/ttyACM0", "white space"),
        ("/dev/ttyACM0\n", "white space"),
        ("/dev/tty\0ACM0", "control"),
        ("tcp://", "host is missing"),
        ("tcp://bridge:", "expected a TCP port"),
        ("tcp://[::1]4001", "brackets"),
        ("tcp://:4001", "host is missing"),
        ("tcp://bridge:0", "1 to 65535"),
        ("tcp://bridge:65536", "1 to 65535"),
        ("tcp://bridge:+80", "1 to 65535"),
        ("tcp://bridge:4001/", "1 to 65535"),
        ("tcp://::1:4001", "brackets"),
        ("tcp://[::1:4001", "brackets"),
        ("tcp://[bridge]:4001", "IPv6"),
        ("tcp://[fe80::1%]:4001", "IPv6"),
        ("tcp://ada@bridge:4001", "expected a host name or an address"),
        ("tcp://bridge:4001?", "baud=N"),
        ("tcp://bridge:4001?speed=19200", "baud=N"),
        ("tcp://bridge:4001?baud=", "19200"),
        ("tcp://bridge:4001?baud=9600", "19200"),
        ("tcp://bridge:4001?baud=+19200", "19200"),
        ("tcp://bridge:4001?baud=19200&x=1", "19200"),
        ("http://bridge:80", "tcp://HOST:PORT"),
        ("bridge:4001", "tcp://HOST:PORT"),
        ("192.168.0.10", "tcp://HOST"),
        ("tcp:bridge:4001", "tcp://HOST:PORT"),
        ("tcp:bridge", "tcp://HOST"),
    ];
    for (text, expected) in table {
        let error = text.parse::<Endpoint>().unwrap_err();
        let ErrorKind::InvalidEndpoint { text: quoted, reason, .. } = error.kind() else {
            panic!("{text:?}: {error:?}")
        };
        assert_eq!(quoted, text);
        assert!(reason.contains(expected), "{text:?}: {reason}");
    }
}

#[test]
fn device_paths_and_serial_numbers_are_read_and_written() {
    let by_path = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0";
    for path in ["/dev/ttyACM0", "COM3", r"\\.\COM10", "./ttyACM0", "emulated", by_path] {
        let endpoint: Endpoint = path.parse().unwrap();
        assert_eq!(endpoint, Endpoint::Serial(path.to_owned()));
        assert_eq!(endpoint.to_string(), path);
    }
    for number in ["H0713090", "0713090"] {
        let text = format!("serial:{number}");
        let endpoint: Endpoint = text.parse().unwrap();
        assert_eq!(endpoint, Endpoint::SerialNumber(number.to_owned()));
        assert_eq!(endpoint.to_string(), text);
    }
    for text in ["serial:", "serial:H0713090 ", "serial:H 0713090", "serial:Ü1"] {
        assert!(
            matches!(
                text.parse::<Endpoint>().unwrap_err().kind(),
                ErrorKind::InvalidEndpoint { .. }
            ),
            "{text}"
        );
    }
}

#[cfg(not(feature = "serial"))]
#[tokio::test]
async fn opening_a_serial_port_names_the_missing_feature() {
    for text in ["/dev/ttyACM0", "COM3", "serial:H0713090"] {
        let error = tokio_scip::Sensor::open(text).await.unwrap_err();
        assert!(error.to_string().contains("feature `serial`"), "{error}");
    }
}

/// A port that has another answer to each question than the default.
struct Unusual {
    is_discarded: Arc<AtomicBool>,
}

impl FarEnd for Unusual {
    fn read(&mut self, _: &mut Context<'_>, _: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn baud_rate(&self) -> Option<BaudRate> {
        Some(BaudRate::B57600)
    }

    fn set_baud_rate(&mut self, _: BaudRate) -> io::Result<()> {
        Ok(())
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for Unusual {
    fn wall_clock(&mut self) -> Option<SystemTime> {
        Some(SystemTime::UNIX_EPOCH)
    }

    fn try_read(&mut self, _: &mut [u8]) -> Option<io::Result<usize>> {
        Some(Ok(3))
    }

    fn suspend_wakeups(&mut self) -> bool {
        true
    }

    fn can_die_silently(&mut self) -> bool {
        true
    }

    fn is_over(&mut self) -> bool {
        true
    }

    fn discard_output(&mut self) {
        self.is_discarded.store(true, Ordering::Relaxed);
    }
}

#[tokio::test]
async fn a_boxed_port_keeps_its_hints() {
    let is_discarded = Arc::new(AtomicBool::new(false));
    let mut boxed: Box<dyn Port> =
        Box::new(TestPort(Unusual { is_discarded: Arc::clone(&is_discarded) }));
    assert_eq!(boxed.baud_rate(), Some(BaudRate::B57600));
    assert!(set_baud_rate(&mut boxed, BaudRate::B19200).await.is_ok());
    let hints = Port::hints(&mut boxed).unwrap();
    assert_eq!(hints.wall_clock(), Some(SystemTime::UNIX_EPOCH));
    assert_eq!(hints.try_read(&mut [0; 8]).unwrap().unwrap(), 3);
    assert!(hints.suspend_wakeups() && hints.can_die_silently() && hints.is_over());
    hints.discard_output();
    assert!(is_discarded.load(Ordering::Relaxed));

    let mut plain = StreamPort::new(tokio::io::empty());
    assert_eq!(plain.baud_rate(), None);
    let refused = set_baud_rate(&mut plain, BaudRate::B19200).await.unwrap_err();
    assert_eq!(refused.kind(), io::ErrorKind::Unsupported);
    assert!(!plain.hints().unwrap().can_die_silently());
}

/// A stream that has only bytes.
struct NoHints;

impl PortHints for NoHints {}
impl ConnectHints for NoHints {}

#[test]
fn a_hint_that_is_not_given_is_the_safe_one() {
    let port: &mut dyn PortHints = &mut NoHints;
    assert!(port.try_read(&mut [0; 8]).is_none());
    assert!(!port.suspend_wakeups() && !port.can_die_silently() && !port.is_over());
    assert_eq!(port.wall_clock(), None);
    port.discard_output();
    let connect: &mut dyn ConnectHints = &mut NoHints;
    assert!(!connect.has_more());
    assert_eq!(connect.expected_serial_number(), None);
    connect.found();
}

#[tokio::test(start_paused = true)]
async fn a_closure_opens_ports_again_after_each_loss() {
    let emulator = Emulator::default();
    let mut port = emulator.clone();
    let closure = move || {
        let link = port.connect().now_or_never();
        async { link.unwrap_or(Err(ErrorKind::Closed.into())) }
    };
    let sensor = Sensor::builder().connect(closure).await.unwrap();
    for _ in 0..2 {
        emulator.unplug();
        emulator.plug_in();
        sensor.scan(Window::DETECTION).await.unwrap_or_else(|error| panic!("{error}"));
    }
}

#[tokio::test]
async fn a_stream_port_flushes_and_shuts_down_its_stream() {
    let (near, mut far) = tokio::io::duplex(64);
    let mut port = StreamPort::new(tokio::io::BufStream::new(near));
    let mut bytes = [0; 8];
    port.write_all(b"V\n").await.unwrap();
    assert!(far.read(&mut bytes).now_or_never().is_none(), "the stream holds it back");
    port.flush().await.unwrap();
    assert_eq!(far.read(&mut bytes).now_or_never().unwrap().unwrap(), 2);
    port.shutdown().await.unwrap();
    assert_eq!(far.read(&mut bytes).now_or_never().unwrap().unwrap(), 0);
}

#[cfg(feature = "serial")]
#[tokio::test]
async fn listing_the_ports_puts_likely_sensors_first() {
    let ports = tokio_scip::port::list().await.unwrap();
    let sensors = ports.iter().take_while(|port| port.likely_sensor).count();
    assert!(ports.iter().skip(sensors).all(|port| !port.likely_sensor), "sensors first");
}

#[test]
fn a_path_is_a_serial_port_whatever_it_looks_like() {
    use std::path::{Path, PathBuf};
    for path in ["/dev/ttyACM0", "serial:H0713090", "tcp://bridge:4001"] {
        let expected = Endpoint::Serial(path.to_owned());
        assert_eq!(Endpoint::try_from(Path::new(path)).unwrap(), expected);
        assert_eq!(Endpoint::try_from(PathBuf::from(path)).unwrap(), expected);
        assert_eq!(Endpoint::try_from(&PathBuf::from(path)).unwrap(), expected);
    }
    for path in ["", "/dev/tty\nACM0"] {
        let error = Endpoint::try_from(Path::new(path)).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::InvalidEndpoint { .. }), "{error}");
    }
}

#[cfg(unix)]
#[test]
fn a_path_that_is_not_utf_8_is_refused() {
    use std::os::unix::ffi::OsStrExt;
    let path = std::path::Path::new(std::ffi::OsStr::from_bytes(b"/dev/tty\xff"));
    let error = Endpoint::try_from(path).unwrap_err().to_string();
    assert!(error.contains("must be UTF-8"), "{error}");
}

#[cfg(feature = "serde")]
#[test]
fn an_endpoint_is_serialized_as_its_text() {
    for text in ["/dev/ttyACM0", "serial:H0713090", "tcp://[::1]:4001?baud=57600"] {
        let endpoint: Endpoint = text.parse().unwrap();
        let json = serde_json::to_string(&endpoint).unwrap();
        assert_eq!(json, format!("{text:?}"));
        assert_eq!(serde_json::from_str::<Endpoint>(&json).unwrap(), endpoint);
    }
    let error = serde_json::from_str::<Endpoint>("\"tcp://bridge:\"").unwrap_err().to_string();
    assert!(error.contains("expected a TCP port from 1 to 65535"), "{error}");
}
