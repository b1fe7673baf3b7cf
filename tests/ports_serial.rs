//! Serial ports on pseudo-terminals, and on files that are not serial ports. In real time,
//! without sleeping: each wait is for bytes.

use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::task::{Context, Wake, Waker};
use std::time::Duration;

use crate::common::limit::limit;
use futures::FutureExt;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt, ReadBuf};
use tokio_scip::port::{EndpointConnector, SerialPort};
use tokio_scip::{BaudRate, Connect, Endpoint, Error, Port};
use tokio_serial::SerialPort as _;
use tokio_serial::SerialStream;

/// A serial line with two ends, and the path of one of them.
struct Line {
    far: SerialStream,
    /// Held open, so that the line does not hang up between two openings, and to read the
    /// line's settings.
    near: SerialStream,
    path: String,
}

fn line() -> Line {
    limit();
    // Copies, which the programs that other tests start do not inherit.
    let (far, near) = serialport::TTYPort::pair().unwrap();
    let [far, near] = [far, near].map(|end| {
        let copy = end.try_clone_native().unwrap();
        SerialStream::try_from(copy).unwrap()
    });
    let path = near.name().unwrap();
    Line { far, near, path }
}

/// Makes a line whose far end is a blocking file, and returns the path of its near end.
fn blocking_line() -> (std::fs::File, String) {
    limit();
    let far = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&far).unwrap();
    unlockpt(&far).unwrap();
    let path = ptsname(&far, Vec::new()).unwrap().into_string().unwrap();
    (far.into(), path)
}

/// A directory that is removed with its content.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("tokio-scip-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[tokio::test]
async fn all_six_baud_rates_are_set_and_in_force() {
    let line = line();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    assert_eq!(port.baud_rate(), Some(BaudRate::B19200), "as a sensor after power-up");
    assert_eq!(line.near.baud_rate().unwrap(), 19_200);
    for baud_rate in BaudRate::ALL.into_iter().rev() {
        port.set_baud_rate(baud_rate).unwrap();
        assert_eq!(port.baud_rate(), Some(baud_rate));
        assert_eq!(line.near.baud_rate().unwrap(), baud_rate.bits_per_second());
    }
}

#[tokio::test]
async fn the_line_is_8n1_without_flow_control() {
    let mut line = line();
    line.near.set_parity(tokio_serial::Parity::Even).unwrap();
    line.near.set_stop_bits(tokio_serial::StopBits::Two).unwrap();
    line.near.set_flow_control(tokio_serial::FlowControl::Software).unwrap();
    let _port = SerialPort::open(&line.path).await.unwrap();
    assert_eq!(line.near.data_bits().unwrap(), tokio_serial::DataBits::Eight);
    assert_eq!(line.near.parity().unwrap(), tokio_serial::Parity::None);
    assert_eq!(line.near.stop_bits().unwrap(), tokio_serial::StopBits::One);
    assert_eq!(line.near.flow_control().unwrap(), tokio_serial::FlowControl::None);
}

#[tokio::test]
async fn every_byte_passes_unchanged_both_ways() {
    let mut line = line();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    let every_byte: Vec<u8> = (0..=255).collect();
    let mut there = [0; 256];
    port.write_all(&every_byte).await.unwrap();
    line.far.read_exact(&mut there).await.unwrap();
    assert_eq!(there.as_slice(), every_byte);
    let mut back = [0; 256];
    line.far.write_all(&every_byte).await.unwrap();
    port.read_exact(&mut back).await.unwrap();
    assert_eq!(back.as_slice(), every_byte);
}

#[tokio::test]
async fn a_long_stream_in_pieces_of_all_sizes_is_read_to_its_end() {
    let mut line = line();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    let bytes: Vec<u8> =
        (0..500_000_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let write = async {
        let mut rest = bytes.as_slice();
        for size in (1..6000).step_by(7).cycle() {
            let Some((piece, after)) = rest.split_at_checked(size) else { break };
            line.far.write_all(piece).await.unwrap();
            rest = after;
        }
        line.far.write_all(rest).await.unwrap();
    };
    let mut came = vec![0; bytes.len()];
    let read = port.read_exact(&mut came);
    let both = tokio::time::timeout(Duration::from_secs(60), async { tokio::join!(write, read) });
    both.await.expect("the reader is not woken").1.unwrap();
    assert!(came == bytes);
}

#[tokio::test]
async fn received_bytes_are_read_before_the_runtime_reports_readiness() {
    let (mut far, path) = blocking_line();
    let mut port = SerialPort::open(&path).await.unwrap();
    let mut bytes = [0; 16];
    let quiet = port.try_read(&mut bytes).unwrap().unwrap_err();
    assert_eq!(quiet.kind(), std::io::ErrorKind::WouldBlock);
    std::io::Write::write_all(&mut far, b"V\n0\n\n").unwrap();
    assert_eq!(port.read(&mut bytes).await.unwrap(), 5);
    std::io::Write::write_all(&mut far, b"late").unwrap();
    assert_eq!(port.try_read(&mut bytes).unwrap().unwrap(), 4);
    std::io::Write::write_all(&mut far, b"later").unwrap();
    assert_eq!(port.read(&mut bytes).await.unwrap(), 5);
}

/// A reply arrives in pieces, and behind each of them the queue is empty.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_read_does_not_try_again_before_the_system_reports_readiness() {
    let (mut far, path) = blocking_line();
    let mut port = SerialPort::open(&path).await.unwrap();
    let mut bytes = [0; 16];
    for piece in [b"first".as_slice(), b"next", b"last"] {
        std::io::Write::write_all(&mut far, piece).unwrap();
        // The runtime has not polled for readiness since.
        assert!(port.read(&mut bytes).now_or_never().is_none());
        assert_eq!(port.read(&mut bytes).await.unwrap(), piece.len());
    }
}

#[tokio::test]
async fn a_command_wakes_the_thread_for_its_reply_alone() {
    const COMMANDS: u64 = 100;
    let (mut far, path) = blocking_line();
    let mut port = SerialPort::open(&path).await.unwrap();
    let metrics = tokio::runtime::Handle::current().metrics();
    let before = metrics.worker_park_count(0);
    let sensor = std::thread::spawn(move || {
        let mut asleep = before;
        for _ in 0..COMMANDS {
            std::io::Read::read_exact(&mut far, &mut [0; 2]).unwrap();
            // Answers only while the runtime's thread sleeps.
            while metrics.worker_park_count(0) == asleep {
                std::thread::yield_now();
            }
            asleep = metrics.worker_park_count(0);
            std::io::Write::write_all(&mut far, b"V\n0\n\n").unwrap();
        }
        far
    });
    let exchanges = async {
        for _ in 0..COMMANDS {
            port.write_all(b"V\n").await.unwrap();
            assert_eq!(port.read(&mut [0; 16]).await.unwrap(), 5);
        }
    };
    let exchanges = tokio::time::timeout(Duration::from_secs(60), exchanges);
    exchanges.await.expect("the reader is not woken");
    let sleeps = tokio::runtime::Handle::current().metrics().worker_park_count(0) - before;
    assert!(sleeps < COMMANDS * 3 / 2, "{sleeps} wake-ups for {COMMANDS} commands");
    sensor.join().unwrap();
}

/// Writes until the line accepts no more, as when a sensor does not read. Returns the
/// number of bytes accepted.
fn stall(port: &mut SerialPort) -> usize {
    let mut taken = 0;
    while let Some(written) = port.write(&[b'x'; 1024]).now_or_never() {
        taken += written.unwrap();
    }
    taken
}

#[tokio::test]
async fn o16_flush_and_shutdown_do_not_wait_for_a_stalled_line() {
    let line = line();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    stall(&mut port);
    port.flush().now_or_never().unwrap().unwrap();
    port.shutdown().now_or_never().unwrap().unwrap();
}

#[tokio::test]
async fn a_stalled_write_goes_on_when_the_line_moves_again() {
    let mut line = line();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    let taken = stall(&mut port);
    let mut came = vec![0; taken + 1];
    let both = async { tokio::join!(port.write_all(b"V"), line.far.read_exact(&mut came)) };
    let both = tokio::time::timeout(Duration::from_secs(60), both);
    let (written, read) = both.await.expect("the writer waits on");
    written.unwrap();
    read.unwrap();
    assert_eq!(came.pop(), Some(b'V'));
}

#[tokio::test]
async fn o17_dropping_a_port_discards_its_unsent_output() {
    let mut line = line();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    let taken = stall(&mut port);
    drop(port);
    let mut port = SerialPort::open(&line.path).await.unwrap();
    let write = tokio::time::timeout(Duration::from_secs(5), port.write_all(b"V"));
    write.await.expect("the line still does not move").unwrap();
    // A pseudo-terminal passes on a few KiB at once: those were sent.
    let mut came = 0;
    while line.far.read_u8().await.unwrap() != b'V' {
        came += 1;
    }
    assert!(came <= 4096 && came < taken, "{came} of {taken} bytes came");
}

#[tokio::test]
async fn o04_an_open_port_is_busy_until_it_is_dropped() {
    let line = line();
    let scratch = Scratch::new("busy");
    let link = scratch.path("sensor");
    std::os::unix::fs::symlink(&line.path, &link).unwrap();

    let port = SerialPort::open(&link).await.unwrap();
    for path in [&line.path, &link] {
        match SerialPort::open(path).await {
            Err(error @ Error::Busy { .. }) => assert!(error.to_string().contains(path)),
            other => panic!("{other:?}"),
        }
    }
    drop(port);
    SerialPort::open(&line.path).await.unwrap();
}

#[tokio::test]
async fn a_dropped_opening_leaves_no_port_open() {
    let line = line();
    let mut connector = Endpoint::Serial(line.path.clone()).into_connector();
    let mut given_up = 0;
    // A program that another test starts has this one's open ports, too, for a moment:
    // from its fork until its exec. A port that stays open is busy for ever.
    let open = async |connector: &mut EndpointConnector| {
        loop {
            match connector.connect().await {
                Err(Error::Busy { .. }) => {}
                outcome => return outcome.unwrap(),
            }
        }
    };
    for _ in 0..100 {
        given_up += usize::from(connector.connect().now_or_never().is_none());
        drop(tokio::time::timeout(Duration::from_secs(10), open(&mut connector)).await.unwrap());
    }
    assert!(given_up > 0, "opening takes a thread, which is seldom done at the first poll");
}

#[tokio::test]
async fn o07_bytes_received_before_the_port_was_opened_are_read() {
    let mut line = line();
    line.far.write_all(b"left").await.unwrap();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    let mut bytes = [0; 4];
    port.read_exact(&mut bytes).await.unwrap();
    assert_eq!(&bytes, b"left");
}

#[tokio::test]
async fn o01_a_hung_up_line_ends_reads_and_fails_writes() {
    let line = line();
    let mut port = SerialPort::open(&line.path).await.unwrap();
    let Line { far, near, .. } = line;
    drop((far, near));
    for _ in 0..3 {
        match port.read(&mut [0; 16]).await {
            Ok(read) => assert_eq!(read, 0),
            Err(error) => assert!(error.raw_os_error().is_some(), "{error:?}"),
        }
    }
    assert!(port.write(b"V\n").await.unwrap_err().raw_os_error().is_some());
    assert!(port.set_baud_rate(BaudRate::B57600).is_err());
    assert_eq!(port.baud_rate(), Some(BaudRate::B19200));
    port.discard_output();
}

#[tokio::test]
async fn o06_a_file_that_is_not_a_serial_port_and_a_missing_path_have_different_errors() {
    let scratch = Scratch::new("files");
    let file = scratch.path("file");
    std::fs::write(&file, "no port").unwrap();
    let dangling = scratch.path("dangling");
    std::os::unix::fs::symlink(scratch.path("gone"), &dangling).unwrap();

    for path in [&scratch.path("missing"), &dangling, &format!("{file}/below")] {
        match SerialPort::open(path).await {
            Err(Error::NoSuchPort { port }) => assert_eq!(port, *path),
            other => panic!("{path}: {other:?}"),
        }
    }
    for path in [&file, &scratch.path(""), "/dev/null"] {
        match SerialPort::open(path).await {
            Err(Error::NotASerialPort { port }) => assert_eq!(port, *path),
            other => panic!("{path}: {other:?}"),
        }
    }
    assert_eq!(std::fs::read(&file).unwrap(), b"no port");
}

#[tokio::test]
async fn a_serial_number_that_no_port_has_is_an_error() {
    let mut connector = Endpoint::SerialNumber("H0000000".to_owned()).into_connector();
    assert_eq!(connector.expected_serial_number(), Some("H0000000"));
    loop {
        match connector.connect().await {
            // A machine with sensors: this one is not theirs.
            Ok(port) => drop(port),
            Err(error) => {
                assert!(matches!(error, Error::NoSuchSensor { .. }), "{error}");
                break;
            }
        }
    }
    assert!(!connector.has_more());
}

/// Counts how often it is woken.
#[derive(Default)]
struct Woken(AtomicU64);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Relaxed);
    }
}

#[tokio::test]
async fn a_port_with_suspended_wake_ups_wakes_nobody_and_reads_what_came_meanwhile() {
    let Line { mut far, near, path } = line();
    let mut port = SerialPort::open(&path).await.unwrap();
    let woken = Arc::new(Woken::default());
    let waker = Waker::from(Arc::clone(&woken));
    let mut bytes = [0; 8];
    for wakes in [false, true] {
        woken.0.store(0, Relaxed);
        let mut buffer = ReadBuf::new(&mut bytes);
        let mut cx = Context::from_waker(&waker);
        assert!(Pin::new(&mut port).poll_read(&mut cx, &mut buffer).is_pending());
        assert!(wakes || port.suspend_wakeups());
        far.write_all(b"abc").await.unwrap();
        while near.bytes_to_read().unwrap() < 3 {
            tokio::task::yield_now().await;
        }
        // The runtime asks the system for events each time.
        for _ in 0..3 {
            tokio::task::yield_now().await;
        }
        assert_eq!(woken.0.load(Relaxed) > 0, wakes);
        let mut cx = Context::from_waker(&waker);
        assert!(Pin::new(&mut port).poll_read(&mut cx, &mut buffer).is_ready());
        assert_eq!(buffer.filled(), b"abc");
    }
    // After a read the port wakes its reader again.
    let (written, read) = tokio::join!(far.write_all(b"d"), port.read(&mut bytes));
    assert!(written.is_ok() && read.unwrap() == 1 && bytes[0] == b'd');
}

#[tokio::test]
async fn a_line_that_hangs_up_while_wake_ups_are_suspended_is_noticed_by_the_next_read() {
    let Line { far, near: _near, path } = line();
    let mut port = SerialPort::open(&path).await.unwrap();
    assert!(port.read(&mut [0; 8]).now_or_never().is_none());
    assert!(port.suspend_wakeups());
    drop(far);
    let read = port.read(&mut [0; 8]).await;
    assert!(matches!(read, Ok(0) | Err(_)), "{read:?}");
}
