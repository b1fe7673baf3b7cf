//! Endpoints as text, TCP ports, and listing: what needs no pseudo-terminal.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio_scip::port::{EndpointConnector, TcpPort};
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

#[cfg(feature = "serial")]
#[test]
fn a_path_is_a_serial_port_whatever_it_looks_like() {
    use std::path::{Path, PathBuf};

    for path in ["/dev/serial/by-path/pci-0:1.0", "tcp://bridge:1", "serial:H0713090"] {
        let serial = Endpoint::Serial(path.to_owned());
        assert_eq!(Endpoint::try_from(Path::new(path)).unwrap(), serial);
        assert_eq!(Endpoint::try_from(PathBuf::from(path)).unwrap(), serial);
    }
    let error = Endpoint::try_from(Path::new("")).unwrap_err();
    assert_eq!(error.to_string(), "invalid port \"\": it is empty");
}

#[test]
fn a_text_that_names_no_port_is_refused_with_the_reason() {
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
        ("tcp://[::1:4001", "never closed"),
        ("tcp://[bridge]:4001", "IPv6"),
        ("tcp://[fe80::1%]:4001", "IPv6"),
        ("tcp://ada@bridge:4001", "neither a name nor an address"),
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
            Err(Error::InvalidEndpoint { text: told, reason }) => {
                assert_eq!(told, text);
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
fn without_the_feature_a_device_path_is_refused_and_the_feature_named() {
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
        assert!(!connector.has_more());
        assert_eq!(connector.expected_serial_number(), None);

        drop(peer);
        assert_eq!(port.read(&mut reply).await.unwrap(), 0, "the end comes as it is");
    }
}

#[tokio::test]
async fn a_tcp_port_is_a_stream_like_any_other_and_can_be_shut_down() {
    // Not every machine has IPv6.
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
async fn a_server_that_is_not_there_yet_is_worth_waiting_for() {
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
async fn listing_the_ports_says_what_there_is() {
    let ports = tokio_scip::port::list().await.unwrap();
    let sensors = ports.iter().take_while(|port| port.is_likely_sensor()).count();
    assert!(ports.iter().skip(sensors).all(|port| !port.is_likely_sensor()), "sensors first");
}
