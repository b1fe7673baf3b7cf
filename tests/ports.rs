//! Endpoints as text, TCP ports, and listing: everything that needs no pseudo-terminal.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::SystemTime;

use crate::common::ConnectFn;
use futures::FutureExt;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::TcpListener;
use tokio_scip::port::{EndpointConnector, StreamPort, TcpPort};
use tokio_scip::{BaudRate, Connect, Endpoint, Error, Port};

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
}

#[test]
fn an_invalid_port_is_refused_with_the_reason() {
    let table = [
        ("", "empty"),
        (" /dev/ttyACM0", "white space"),
        ("/dev/ttyACM0\n", "white space"),
        ("/dev/tty\0ACM0", "control"),
        ("tcp://", "TCP port is missing"),
        ("tcp://bridge", "TCP port is missing"),
        ("tcp://bridge:", "TCP port is missing"),
        ("tcp://[::1]", "TCP port is missing"),
        ("tcp://:4001", "host is missing"),
        ("tcp://bridge:0", "1 to 65535"),
        ("tcp://bridge:65536", "1 to 65535"),
        ("tcp://bridge:+80", "1 to 65535"),
        ("tcp://bridge:4001/", "1 to 65535"),
        ("tcp://::1:4001", "brackets"),
        ("tcp://[::1:4001", "closing bracket"),
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
        ("tcp:bridge:4001", "tcp://HOST:PORT"),
    ];
    for (text, expected) in table {
        match text.parse::<Endpoint>() {
            Err(Error::InvalidEndpoint { text: quoted, reason }) => {
                assert_eq!(quoted, text);
                assert!(reason.contains(expected), "{text:?}: {reason}");
            }
            other => panic!("{text:?}: {other:?}"),
        }
    }
}

#[cfg(feature = "serial")]
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
        assert!(matches!(text.parse::<Endpoint>(), Err(Error::InvalidEndpoint { .. })), "{text}");
    }
}

#[cfg(not(feature = "serial"))]
#[test]
fn without_the_feature_a_device_path_is_refused_naming_the_feature() {
    for text in ["/dev/ttyACM0", "COM3", "serial:H0713090"] {
        let error = text.parse::<Endpoint>().unwrap_err();
        assert!(error.to_string().contains("feature `serial`"), "{error}");
    }
}

#[test]
fn a_connector_can_be_moved_to_the_drivers_task() {
    fn is_fit<C: Connect + Send + 'static>() {}
    is_fit::<EndpointConnector>();
    fn is_port<P: Port>() {}
    is_port::<Box<dyn Port>>();
}

#[tokio::test]
async fn bytes_go_both_ways_over_tcp() {
    for host in ["127.0.0.1", "localhost"] {
        let server = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let address = format!("tcp://{host}:{}?baud=57600", server.local_addr().unwrap().port());
        let mut connector = Endpoint::try_from(&address).unwrap().into_connector();
        let mut port = connector.connect().await.unwrap();
        let (mut peer, _) = server.accept().await.unwrap();

        port.write_all(b"V\n").await.unwrap();
        let mut command = [0; 2];
        peer.read_exact(&mut command).await.unwrap();
        assert_eq!(&command, b"V\n");
        let every_byte: Vec<u8> = (0..=255).collect();
        peer.write_all(&every_byte).await.unwrap();
        let mut reply = [0; 256];
        port.read_exact(&mut reply).await.unwrap();
        assert_eq!(reply.as_slice(), every_byte);

        assert_eq!(port.baud_rate(), Some(BaudRate::B57600));
        let refused = port.set_baud_rate(BaudRate::B115200).unwrap_err();
        assert_eq!(refused.kind(), std::io::ErrorKind::Unsupported);
        assert_eq!(port.baud_rate(), Some(BaudRate::B57600));
        assert!(port.can_die_silently());
        assert!(!connector.has_more());
        assert_eq!(connector.expected_serial_number(), None);

        drop(peer);
        assert_eq!(port.read(&mut reply).await.unwrap(), 0, "the end comes as it is");
    }
}

/// A port that has another answer to each question than the default.
struct Unusual {
    bytes: tokio::io::Empty,
    is_discarded: Arc<AtomicBool>,
}

impl AsyncRead for Unusual {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.bytes).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Unusual {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.bytes).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.bytes).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.bytes).poll_shutdown(cx)
    }
}

impl Port for Unusual {
    fn baud_rate(&self) -> Option<BaudRate> {
        Some(BaudRate::B57600)
    }

    fn set_baud_rate(&mut self, _: BaudRate) -> io::Result<()> {
        Ok(())
    }

    fn wall_clock(&self) -> SystemTime {
        SystemTime::UNIX_EPOCH
    }

    fn try_read(&mut self, _: &mut [u8]) -> Option<io::Result<usize>> {
        Some(Ok(3))
    }

    fn suspend_wakeups(&mut self) -> bool {
        true
    }

    fn can_die_silently(&self) -> bool {
        true
    }

    fn is_over(&self) -> bool {
        true
    }

    fn discard_output(&mut self) {
        self.is_discarded.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_boxed_port_answers_as_the_port_in_it_and_a_plain_stream_as_documented() {
    let answers = |port: &mut dyn Port| {
        (
            port.baud_rate(),
            port.set_baud_rate(BaudRate::B19200).is_ok(),
            port.wall_clock() == SystemTime::UNIX_EPOCH,
            port.try_read(&mut [0; 8]).and_then(Result::ok),
            port.suspend_wakeups(),
            port.can_die_silently(),
            port.is_over(),
        )
    };
    let is_discarded = Arc::new(AtomicBool::new(false));
    let bytes = tokio::io::empty();
    let mut boxed: Box<dyn Port> =
        Box::new(Unusual { bytes, is_discarded: Arc::clone(&is_discarded) });
    let all = (Some(BaudRate::B57600), true, true, Some(3), true, true, true);
    assert_eq!(answers(&mut boxed), all);
    boxed.discard_output();
    assert!(is_discarded.load(Ordering::Relaxed));
    let none = (None, false, false, None, false, false, false);
    assert_eq!(answers(&mut StreamPort::new(tokio::io::empty())), none);
    assert_eq!(ConnectFn(|| Ok(StreamPort::new(tokio::io::empty()))).name(), None);
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

#[tokio::test]
async fn a_tcp_port_is_a_stream_like_any_other_and_can_be_shut_down() {
    // IPv6 where the machine has it.
    let (host, server) = match TcpListener::bind(("::1", 0)).await {
        Ok(server) => ("::1", server),
        Err(_) => ("127.0.0.1", TcpListener::bind(("127.0.0.1", 0)).await.unwrap()),
    };
    let port = server.local_addr().unwrap().port();
    let mut port = TcpPort::connect(host, port, BaudRate::B19200).await.unwrap();
    let (mut peer, _) = server.accept().await.unwrap();
    port.write_all(b"V\n").await.unwrap();
    port.flush().await.unwrap();
    port.shutdown().await.unwrap();
    let mut all = Vec::new();
    peer.read_to_end(&mut all).await.unwrap();
    assert_eq!(all, b"V\n");
}

#[tokio::test]
async fn a_server_that_is_not_there_yet_is_a_transient_error() {
    let server = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
    let port = server.local_addr().unwrap().port();
    drop(server);
    let error = TcpPort::connect("127.0.0.1", port, BaudRate::B19200).await.unwrap_err();
    assert!(error.is_transient());
    assert_eq!(error.to_string(), format!("cannot open tcp://127.0.0.1:{port}"));
    let Error::Open { source, .. } = error else { panic!("{error:?}") };
    assert_eq!(source.kind(), std::io::ErrorKind::ConnectionRefused);
}

#[cfg(feature = "serial")]
#[tokio::test]
async fn listing_the_ports_puts_likely_sensors_first() {
    let ports = tokio_scip::port::list().await.unwrap();
    let sensors = ports.iter().take_while(|port| port.is_likely_sensor()).count();
    assert!(ports.iter().skip(sensors).all(|port| !port.is_likely_sensor()), "sensors first");
}

#[cfg(feature = "serial")]
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
        assert!(matches!(error, Error::InvalidEndpoint { .. }), "{error}");
    }
}

#[cfg(all(unix, feature = "serial"))]
#[test]
fn a_path_that_is_not_utf_8_is_refused() {
    use std::os::unix::ffi::OsStrExt;
    let path = std::path::Path::new(std::ffi::OsStr::from_bytes(b"/dev/tty\xff"));
    let error = Endpoint::try_from(path).unwrap_err().to_string();
    assert!(error.contains("must be UTF-8"), "{error}");
}

#[cfg(all(feature = "serde", feature = "cli"))]
#[test]
fn an_endpoint_is_serialized_as_its_text() {
    for text in ["/dev/ttyACM0", "serial:H0713090", "tcp://[::1]:4001?baud=57600"] {
        let endpoint: Endpoint = text.parse().unwrap();
        let json = serde_json::to_string(&endpoint).unwrap();
        assert_eq!(json, format!("{text:?}"));
        assert_eq!(serde_json::from_str::<Endpoint>(&json).unwrap(), endpoint);
    }
    let error = serde_json::from_str::<Endpoint>("\"tcp://bridge\"").unwrap_err().to_string();
    assert!(error.contains("the TCP port is missing"), "{error}");
}

/// A server that does not accept connections, because its queue is full.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn an_error_of_a_server_that_never_answers_names_the_endpoint() {
    use std::time::Duration;
    use tokio::net::{TcpSocket, TcpStream};
    let full = TcpSocket::new_v4().unwrap();
    full.bind(([127, 0, 0, 1], 0).into()).unwrap();
    let full = full.listen(0).unwrap();
    let address = full.local_addr().unwrap();
    let mut queued = Vec::new();
    let limit = Duration::from_millis(200);
    while let Ok(connection) = tokio::time::timeout(limit, TcpStream::connect(address)).await {
        queued.push(connection.unwrap());
    }
    let endpoint = format!("tcp://{address}");
    let opened = tokio_scip::Sensor::builder().open_timeout(limit).open(&endpoint).await;
    let error = opened.unwrap_err();
    assert_eq!(error.chain().to_string(), format!("cannot open {endpoint}: timed out"));
}
