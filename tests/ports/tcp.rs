//! TCP ports, on real sockets.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio_scip::port::{Connect, Port};
use tokio_scip::{BaudRate, Endpoint, ErrorChain, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::Emulator;

use crate::common::set_baud_rate;

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
        let refused = set_baud_rate(&mut port, BaudRate::B115200).await.unwrap_err();
        assert_eq!(refused.kind(), std::io::ErrorKind::Unsupported);
        assert_eq!(port.baud_rate(), Some(BaudRate::B57600));
        assert!(port.hints().unwrap().can_die_silently());
        assert!(connector.hints().is_none());

        drop(peer);
        assert_eq!(port.read(&mut reply).await.unwrap(), 0, "the end comes as it is");
    }
}

fn connector(host: &str, port: u16) -> impl Connect<Port = Box<dyn Port>> {
    let baud_rate = BaudRate::B19200;
    Endpoint::Tcp { host: host.to_owned(), port, baud_rate }.into_connector()
}

#[tokio::test]
async fn a_tcp_port_is_an_ordinary_stream() {
    // IPv6 where the machine has it.
    let (host, server) = match TcpListener::bind(("::1", 0)).await {
        Ok(server) => ("::1", server),
        Err(_) => ("127.0.0.1", TcpListener::bind(("127.0.0.1", 0)).await.unwrap()),
    };
    let port = server.local_addr().unwrap().port();
    let mut port = connector(host, port).connect().await.unwrap();
    let (mut peer, _) = server.accept().await.unwrap();
    assert_eq!(port.baud_rate(), Some(BaudRate::B19200));
    port.write_all(b"V\n").await.unwrap();
    port.flush().await.unwrap();
    port.shutdown().await.unwrap();
    let mut all = Vec::new();
    peer.read_to_end(&mut all).await.unwrap();
    assert_eq!(all, b"V\n");
}

/// At the TCP port of sensors, on an address that no other process has.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_sensor_on_ethernet_has_no_baud_rate() {
    let [_, a, b, c] = std::process::id().to_be_bytes();
    let host = format!("127.{a}.{b}.{c}");
    let _server = TcpListener::bind((host.as_str(), 10_940)).await.unwrap();
    for (rest, expected) in
        [("", None), (":10940", None), ("?baud=115200", Some(BaudRate::B115200))]
    {
        let endpoint = Endpoint::try_from(format!("tcp://{host}{rest}")).unwrap();
        let port = endpoint.into_connector().connect().await.unwrap();
        assert_eq!(port.baud_rate(), expected, "{rest}");
    }
}

#[tokio::test]
async fn a_server_that_is_not_there_yet_is_a_transient_error() {
    let server = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
    let port = server.local_addr().unwrap().port();
    drop(server);
    let error = connector("127.0.0.1", port).connect().await.map(drop).unwrap_err();
    assert!(error.is_transient());
    let text = error.to_string();
    assert!(text.starts_with(&format!("cannot open tcp://127.0.0.1:{port}: ")), "{text}");
    for advice in ["may still boot", "another client", "start its server", "correct the address"] {
        assert!(text.contains(advice), "{text}");
    }
    let ErrorKind::Open { source, .. } = error.kind() else { panic!("{error:?}") };
    assert_eq!(source.kind(), std::io::ErrorKind::ConnectionRefused);
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
    let text = ErrorChain(&error).to_string();
    assert!(text.starts_with(&format!("cannot open {endpoint}: check its power")), "{text}");
    assert!(text.ends_with(", power-cycle it: timed out"), "{text}");
}

#[tokio::test]
async fn a_sensor_opened_in_the_background_may_come_later() {
    let emulator = Emulator::default();
    emulator.unplug();
    let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
    let address = format!("tcp://{}", listener.local_addr().unwrap());
    let server = emulator.clone();
    tokio::spawn(async move { server.serve_tcp(listener).await });

    let sensor = Sensor::builder().wait_for_sensor(true).open(&address).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let waits = |state: &State| matches!(state, State::Connecting { error: Some(_) });
    sensor.watch_state().wait_for(waits).await.unwrap();
    assert!(sensor.freshness().check(Duration::MAX).unwrap_err().source.is_some());
    emulator.plug_in();
    scans.next().await.unwrap().unwrap();

    let invalid = Sensor::builder().wait_for_sensor(true).open("tcp://nowhere:").await.unwrap_err();
    assert!(matches!(invalid.kind(), ErrorKind::InvalidEndpoint { .. }), "{invalid}");
}

/// Accepts connections, writes `words` to each and closes it with unread input, so that the client
/// gets a reset.
async fn reject(server: TcpListener, words: Vec<u8>) {
    while let Ok((mut peer, _)) = server.accept().await {
        peer.write_all(&words).await.unwrap();
        peer.readable().await.unwrap();
    }
}

#[tokio::test]
async fn an_error_quotes_the_servers_words() {
    let busy = &b"Port already in use\r\n"[..];
    let telnet = b"\xff\xfb\x03\xff\xfd,Device open failure: Value or file not found\r\n";
    let negotiated = [&b"\xff\xfa\x2c\x01text\xff\xf0"[..], busy].concat();
    let longest = "s".repeat(160);
    let page = [b"HTTP/1.1 400 Bad Request\r\n\r\n", longest.as_bytes()].concat();
    for (text, quoted) in [
        (busy, Some("Port already in use")),
        (telnet, Some("Device open failure: Value or file not found")),
        (&negotiated, Some("Port already in use")),
        (b"\r\nport 2000\r\n\r\nbusy\r\n", Some("port 2000 busy")),
        (longest.as_bytes(), Some(longest.as_str())),
        (b"SSH-2.0-Go\r\n", Some("SSH-2.0-Go")),
        (b"\r\nSSH-2.0-OpenSSH_9.2\r\n\0\0\x05\x1c\x06\x14\x80", Some("SSH-2.0-OpenSSH_9.2")),
        (&page, Some("HTTP/1.1 400 Bad Request")),
        (&[b's'; 161], None),
        (b"\xff\xfb\x03\xff\xfd,", None),
        (b"0C0D0o0a\n0C0D", None),
        (b"\xff", None),
        (b"p\x80", None),
        (b"0C0D\x80\r\n", None),
    ] {
        let server = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let address = format!("tcp://{}", server.local_addr().unwrap());
        let task = tokio::spawn(reject(server, text.to_vec()));
        let error = Sensor::builder().name("left").open(&address).await.unwrap_err();
        assert_eq!(
            matches!(error.kind(), ErrorKind::Rejected { .. }),
            quoted.is_some(),
            "{error:?}"
        );
        if let Some(quoted) = quoted {
            let says = format!("left cannot be reached: its serial server says {quoted:?}");
            assert!(error.to_string().starts_with(&says), "{error}");
            assert!(error.is_transient());
        }
        task.abort();
    }
}

#[tokio::test]
async fn a_silent_server_is_told_its_baud_rate() {
    let server = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
    let address = format!("tcp://{}?baud=57600", server.local_addr().unwrap());
    let banner = tokio::spawn(async move {
        let (mut peer, _) = server.accept().await.unwrap();
        peer.write_all(b"\r\nser2net port 2000 device /dev/ttyS0\r\n\r\n").await.unwrap();
        peer.read_to_end(&mut Vec::new()).await
    });
    let builder = Sensor::builder().open_timeout(Duration::from_millis(200));
    let text = builder.open(&address).await.unwrap_err().to_string();
    assert!(text.contains("serial server (57600 in its address)"), "{text}");
    assert!(text.contains("\"ser2net port 2000 device /dev/ttyS0\""), "{text}");
    banner.await.unwrap().unwrap();
}
