//! Reading without waiting: how often a serial port wakes its reader, and asks the system for
//! bytes.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::task::{Context, Wake, Waker};
use std::time::Duration;

use futures::FutureExt;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt, ReadBuf};
use tokio_scip::port::Port;
use tokio_serial::SerialPort as _;

use super::{SerialLine, line};
use crate::common::limit::limit;
use crate::common::open_serial;

/// Makes a line whose far end is a blocking file, and returns the path of its near end.
fn blocking_line() -> (std::fs::File, String) {
    limit();
    let far = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&far).unwrap();
    unlockpt(&far).unwrap();
    let path = ptsname(&far, Vec::new()).unwrap().into_string().unwrap();
    (far.into(), path)
}

#[tokio::test]
async fn received_bytes_are_read_before_the_runtime_reports_readiness() {
    let (mut far, path) = blocking_line();
    let mut port = open_serial(&path).await.unwrap();
    let mut bytes = [0; 16];
    let quiet = port.hints().unwrap().try_read(&mut bytes).unwrap().unwrap_err();
    assert_eq!(quiet.kind(), std::io::ErrorKind::WouldBlock);
    std::io::Write::write_all(&mut far, b"V\n0\n\n").unwrap();
    assert_eq!(port.read(&mut bytes).await.unwrap(), 5);
    std::io::Write::write_all(&mut far, b"late").unwrap();
    assert_eq!(port.hints().unwrap().try_read(&mut bytes).unwrap().unwrap(), 4);
    std::io::Write::write_all(&mut far, b"later").unwrap();
    assert_eq!(port.read(&mut bytes).await.unwrap(), 5);
}

/// A reply arrives in pieces, and after each of them the queue is empty.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_read_does_not_try_again_before_the_system_reports_readiness() {
    let (mut far, path) = blocking_line();
    let mut port = open_serial(&path).await.unwrap();
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
    let mut port = open_serial(&path).await.unwrap();
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

/// Counts how often it is woken.
#[derive(Default)]
struct WokenPort(AtomicU64);

impl Wake for WokenPort {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Relaxed);
    }
}

#[tokio::test]
async fn suspended_wake_ups_wake_nobody() {
    let SerialLine { mut far, near, path } = line();
    let mut port = open_serial(&path).await.unwrap();
    let woken = Arc::new(WokenPort::default());
    let waker = Waker::from(Arc::clone(&woken));
    let mut bytes = [0; 8];
    for wakes in [false, true] {
        woken.0.store(0, Relaxed);
        let mut buffer = ReadBuf::new(&mut bytes);
        let mut cx = Context::from_waker(&waker);
        assert!(Pin::new(&mut port).poll_read(&mut cx, &mut buffer).is_pending());
        assert!(wakes || port.hints().unwrap().suspend_wakeups());
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
async fn a_hang_up_without_wake_ups_is_noticed() {
    let SerialLine { far, near: _near, path } = line();
    let mut port = open_serial(&path).await.unwrap();
    assert!(port.read(&mut [0; 8]).now_or_never().is_none());
    assert!(port.hints().unwrap().suspend_wakeups());
    drop(far);
    let read = port.read(&mut [0; 8]).await;
    assert!(matches!(read, Ok(0) | Err(_)), "{read:?}");
}

#[tokio::test]
async fn a_read_that_finds_nothing_wakes_its_reader_again() {
    let SerialLine { mut far, near: _near, path } = line();
    let mut port = open_serial(&path).await.unwrap();
    let mut bytes = [0; 8];
    assert!(port.hints().unwrap().suspend_wakeups());
    assert!(port.read(&mut bytes).now_or_never().is_none());
    let (written, read) = tokio::join!(far.write_all(b"abc"), port.read(&mut bytes));
    assert!(written.is_ok());
    assert_eq!(read.unwrap(), 3);
}

/// A reply that is longer than the reader's buffer: what is left is there already, and
/// nothing reports it.
#[tokio::test]
async fn a_read_that_fills_its_buffer_leaves_wake_ups_suspended() {
    let SerialLine { mut far, near, path } = line();
    let mut port = open_serial(&path).await.unwrap();
    let mut bytes = [0; 3];
    assert!(port.hints().unwrap().suspend_wakeups());
    far.write_all(b"abcdefgh").await.unwrap();
    while near.bytes_to_read().unwrap() < 8 {
        tokio::task::yield_now().await;
    }
    for expected in [b"abc".as_slice(), b"def", b"gh"] {
        // Without the runtime's report, for which this task would have to wait.
        let read = port.read(&mut bytes).now_or_never().expect("the read waits for a report");
        assert_eq!(&bytes[..read.unwrap()], expected);
    }
}
