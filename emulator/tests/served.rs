//! The sensor on other streams: in memory, on TCP, on a pseudo-terminal. The latter
//! two run in real time, and each wait is for bytes.

use std::io::Result;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWrite, AsyncWriteExt, duplex, join};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use urg_emulator::{Emulator, Model};

use super::{ask, instant_sensor, listen_bytes};

#[tokio::test(start_paused = true)]
async fn any_stream_can_be_served() {
    let emulator = instant_sensor().build();
    let (mut client, server) = duplex(64);
    let server = tokio::spawn({
        let emulator = emulator.clone();
        async move { emulator.serve(server).await }
    });
    assert_eq!(ask(&mut client, "L0").await, "L0\n0\n\n");
    assert_eq!(ask(&mut client, "L1").await, "L1\n0\n\n");
    assert_eq!(ask(&mut client, "G00076801").await.len(), 1576);
    drop(client);
    server.await.unwrap().unwrap();
    assert!(!emulator.is_connected());
}

/// Tells the length of each piece that is written to it.
struct Pieces(UnboundedSender<usize>);

impl AsyncWrite for Pieces {
    fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, piece: &[u8]) -> Poll<Result<usize>> {
        let _ = self.0.send(piece.len());
        Poll::Ready(Ok(piece.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[tokio::test(start_paused = true)]
async fn the_longest_reply_comes_in_one_piece() {
    super::limit::limit();
    let emulator = Emulator::builder().model(Model::Ust10lx).build();
    let (mut client, server) = duplex(64);
    let (pieces, mut written) = unbounded_channel();
    tokio::spawn(async move { emulator.serve(join(server, Pieces(pieces))).await });
    client.write_all(b"ME0000108001001\n").await.unwrap();
    assert_eq!(written.recv().await, Some("ME0000108001001\n00P\n\n".len()));
    let points = 1081 * 6;
    let sums = usize::div_ceil(points, 64);
    let rest = "ME0000108001000\n99b\n0000C\n\n".len();
    assert_eq!(written.recv().await, Some(rest + points + 2 * sums));
}

#[tokio::test(start_paused = true)]
async fn unplugging_hangs_up_a_served_stream() {
    let emulator = instant_sensor().build();
    let (mut client, server) = duplex(64);
    let (served, ()) = tokio::join!(emulator.serve(server), async {
        assert_eq!(ask(&mut client, "L0").await, "L0\n0\n\n");
        emulator.unplug();
        assert_eq!(client.read(&mut [0; 8]).await.unwrap(), 0);
    });
    served.unwrap();
}

#[tokio::test(start_paused = true)]
async fn unplugging_ends_a_client_that_does_not_read() {
    let emulator = instant_sensor().build();
    let (mut client, server) = duplex(8);
    client.write_all(b"V\n").await.unwrap();
    let (served, ()) = tokio::join!(emulator.serve(server), async {
        tokio::time::sleep(Duration::from_secs(1)).await;
        emulator.unplug();
    });
    served.unwrap();
}

#[tokio::test]
async fn tcp_clients_are_served_one_after_the_other() {
    let emulator = instant_sensor().build();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let server = tokio::spawn({
        let emulator = emulator.clone();
        async move { emulator.serve_tcp(listener).await }
    });
    let mut first = TcpStream::connect(address).await.unwrap();
    assert_eq!(ask(&mut first, "L0").await, "L0\n0\n\n");
    let mut second = TcpStream::connect(address).await.unwrap();
    second.write_all(b"L0\n").await.unwrap();
    assert_eq!(ask(&mut first, "G38438401").await, "G38438401\n6\n\n");
    drop(first);
    assert_eq!(listen_bytes(&mut second).await, b"L0\n2\n\n");
    // Unplugged it hangs up; plugged in it is reachable again.
    emulator.unplug();
    assert_eq!(second.read(&mut [0; 8]).await.unwrap(), 0);
    emulator.plug_in();
    let mut third = TcpStream::connect(address).await.unwrap();
    assert_eq!(ask(&mut third, "L1").await, "L1\n0\n\n");
    server.abort();
    assert_eq!(third.read(&mut [0; 8]).await.unwrap(), 0);
}

#[cfg(all(unix, feature = "pty"))]
mod terminal {
    use std::path::{Path, PathBuf};
    use std::time::Instant;

    use tokio::task::JoinHandle;
    use tokio_scip::BaudRate;
    use tokio_serial::{ErrorKind, SerialPort, SerialStream};
    use urg_emulator::{Pty, Received};

    use super::*;

    struct Served {
        path: PathBuf,
        task: JoinHandle<std::io::Result<()>>,
    }

    fn serve(emulator: &Emulator, symlink: Option<&Path>) -> Served {
        let pty = Pty::open(emulator, symlink).unwrap();
        Served { path: pty.path().to_owned(), task: tokio::spawn(pty.serve()) }
    }

    fn open(path: &Path, baud_rate: u32) -> SerialStream {
        // With an exclusive lock, as the crate's own ports have. A program that another test starts
        // has a copy of each open port until it begins, also of one that was closed meanwhile.
        let deadline = Instant::now() + Duration::from_secs(10);
        loop {
            match SerialStream::open(&tokio_serial::new(path.to_str().unwrap(), baud_rate)) {
                Err(error) if error.kind() == ErrorKind::NoDevice && Instant::now() < deadline => {
                    std::thread::yield_now();
                }
                outcome => return outcome.unwrap(),
            }
        }
    }

    /// Returns a path that is used by one test only, with nothing there.
    fn scratch(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("emulator-{}-{name}", std::process::id()));
        let _ = std::fs::remove_file(&path);
        path
    }

    #[tokio::test]
    async fn clients_come_and_go_and_the_sensor_stays() {
        let served = serve(&instant_sensor().build(), None);
        for reply in ["L0\n0\n\n", "L0\n2\n\n", "L0\n2\n\n"] {
            let mut client = open(&served.path, 19_200);
            assert_eq!(ask(&mut client, "L0").await, reply);
        }
        served.task.abort();
    }

    #[tokio::test]
    async fn the_port_is_locked_while_a_client_is_there() {
        let served = serve(&instant_sensor().build(), None);
        let mut client = open(&served.path, 19_200);
        let builder = tokio_serial::new(served.path.to_str().unwrap(), 19_200);
        assert!(SerialStream::open(&builder).is_err());
        assert_eq!(ask(&mut client, "L0").await, "L0\n0\n\n");
    }

    #[tokio::test]
    async fn unread_bytes_go_to_the_next_client() {
        let emulator = instant_sensor().build();
        let served = serve(&emulator, None);
        let mut client = open(&served.path, 19_200);
        client.write_all(b"L0\nL1\n").await.unwrap();
        assert_eq!(listen_bytes(&mut client).await, b"L0\n0\n\n");
        drop(client);
        assert_eq!(listen_bytes(&mut open(&served.path, 19_200)).await, b"L1\n0\n\n");
    }

    #[tokio::test]
    async fn a_full_scan_comes_through_whole() {
        let served = serve(&Emulator::default(), None);
        let mut client = open(&served.path, 115_200);
        for _ in 0..5 {
            assert_eq!(ask(&mut client, "G00076801").await.len(), 1576);
        }
    }

    #[tokio::test]
    async fn a_wrong_baud_rate_garbles_both_ways() {
        let latency = Duration::from_millis(200);
        let emulator = instant_sensor().baud_rate(BaudRate::B19200).latency(latency).build();
        let served = serve(&emulator, None);
        let mut client = open(&served.path, 57_600);
        client.write_all(b"L0\n").await.unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
        // On a busy host this task may wake first.
        for _ in 0..10 {
            tokio::task::yield_now().await;
        }
        client.set_baud_rate(19_200).unwrap();
        client.write_all(b"\n").await.unwrap();
        let line = received(&emulator).await;
        assert!(line.garbled && line.line != b"L0" && emulator.is_laser_on());
        while listen_bytes(&mut client).await.is_empty() {}

        // A command arrives intact, and the reply comes at another baud rate.
        client.write_all(b"V\n").await.unwrap();
        while emulator.counts().commands < 2 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        client.set_baud_rate(57_600).unwrap();
        let mut reply = [0; 64];
        client.read_exact(&mut reply).await.unwrap();
        // On a busy host the baud rate may change when it has begun.
        assert!(!reply.is_ascii(), "{}", reply.escape_ascii());
    }

    #[tokio::test]
    async fn a_change_during_a_reply_garbles_the_rest() {
        let served = serve(&instant_sensor().baud_rate(BaudRate::B19200).build(), None);
        let mut client = open(&served.path, 19_200);
        client.write_all(b"G00076801\n").await.unwrap();
        let (mut begin, mut rest) = ([0; 64], [0; 400]);
        client.read_exact(&mut begin).await.unwrap();
        client.set_baud_rate(57_600).unwrap();
        client.read_exact(&mut rest).await.unwrap();
        let is_clear = |bytes: &[u8]| bytes.iter().all(|byte| matches!(byte, b'\n' | b'0'..=b'o'));
        assert!(begin.starts_with(b"G00076801\n0\n") && !is_clear(&rest));
    }

    /// Waits for the first command that reaches the sensor.
    async fn received(emulator: &Emulator) -> Received {
        loop {
            if let Some(received) = emulator.log().into_iter().next() {
                return received;
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    #[tokio::test]
    async fn all_six_baud_rates_can_be_set_on_both_sides() {
        let emulator = instant_sensor().baud_rate(BaudRate::B19200).stray_byte(false).build();
        let served = serve(&emulator, None);
        let mut client = open(&served.path, 19_200);
        for baud_rate in BaudRate::ALL.into_iter().skip(1) {
            let command = format!("S{:06}0000000", u32::from(baud_rate));
            assert_eq!(ask(&mut client, &command).await, format!("{command}\n0\n\n"));
            while emulator.baud_rate() != Some(baud_rate) {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            client.set_baud_rate(u32::from(baud_rate)).unwrap();
            assert!(ask(&mut client, "V").await.starts_with("V\n0\nVEND:"));
        }
    }

    #[tokio::test]
    async fn ending_it_hangs_up_the_client() {
        let link = scratch("ends");
        let served = serve(&instant_sensor().build(), Some(&link));
        assert_eq!(served.path, link);
        let mut client = open(&link, 19_200);
        assert_eq!(ask(&mut client, "L0").await, "L0\n0\n\n");
        served.task.abort();
        assert!(matches!(client.read(&mut [0; 8]).await, Ok(0) | Err(_)));
        assert!(std::fs::symlink_metadata(&link).is_err());
    }

    #[tokio::test]
    async fn an_unplugged_program_is_not_kept_open() {
        let emulator = instant_sensor().build();
        let served = serve(&emulator, None);
        let mut program = tokio::process::Command::new("sleep").arg("600").spawn().unwrap();
        let mut client = open(&served.path, 19_200);
        assert_eq!(ask(&mut client, "L0").await, "L0\n0\n\n");
        emulator.unplug();
        assert!(matches!(client.read(&mut [0; 8]).await, Ok(0) | Err(_)));
        program.kill().await.unwrap();
        served.task.abort();
    }

    #[tokio::test]
    async fn unplugged_it_is_gone_until_plugged_in() {
        let link = scratch("replug");
        let emulator = instant_sensor().build();
        let served = serve(&emulator, Some(&link));
        let mut client = open(&link, 19_200);
        assert_eq!(ask(&mut client, "L0").await, "L0\n0\n\n");
        emulator.unplug();
        assert!(matches!(client.read(&mut [0; 8]).await, Ok(0) | Err(_)));
        drop(client);
        while link.symlink_metadata().is_ok() {
            tokio::task::yield_now().await;
        }
        emulator.plug_in();
        while link.symlink_metadata().is_err() {
            tokio::task::yield_now().await;
        }
        assert_eq!(ask(&mut open(&link, 19_200), "L0").await, "L0\n2\n\n");
        served.task.abort();
    }

    #[tokio::test]
    async fn only_a_symbolic_link_is_ever_replaced() {
        let path = scratch("file");
        let emulator = instant_sensor().build();
        std::fs::write(&path, "precious").unwrap();
        let error = Pty::open(&emulator, Some(&path)).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::AlreadyExists);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
        std::fs::remove_file(&path).unwrap();
        // A symbolic link that an earlier run left is replaced.
        std::os::unix::fs::symlink("/nowhere", &path).unwrap();
        drop(Pty::open(&emulator, Some(&path)).unwrap());
        assert!(path.symlink_metadata().is_err());
    }
}
