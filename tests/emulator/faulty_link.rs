//! The stream whose calls fail according to a script.

use std::io::ErrorKind;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, SystemTime};

use tokio::io::{
    AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, DuplexStream, ReadBuf, duplex,
};
use tokio_scip::emulator::{Call, FaultyLink, LinkFailure};
use tokio_scip::{BaudRate, Port};

use super::{ask, instant_sensor};

async fn fed(bytes: &[u8]) -> (DuplexStream, DuplexStream) {
    let (near, mut far) = duplex(4096);
    far.write_all(bytes).await.unwrap();
    (near, far)
}

async fn is_stuck<T>(future: impl Future<Output = T>) -> bool {
    tokio::time::timeout(Duration::from_secs(3600), future).await.is_err()
}

#[tokio::test(start_paused = true)]
async fn an_errno_comes_once_at_its_read() {
    let (near, _far) = fed(b"abc").await;
    let mut link = FaultyLink::new(near).short_reads(1).fail(Call::Read, 1, LinkFailure::Errno(5));
    let counter = link.counter();
    assert_eq!(link.read_u8().await.unwrap(), b'a');
    assert_eq!(link.read_u8().await.unwrap_err().raw_os_error(), Some(5));
    assert_eq!(link.read_u8().await.unwrap(), b'b');
    assert_eq!((counter.reads(), counter.bytes_read()), (2, 2));
}

#[tokio::test(start_paused = true)]
async fn a_read_fails_without_waiting_for_bytes() {
    let (near, _far) = fed(b"").await;
    let mut link =
        FaultyLink::new(near).fail(Call::Read, 0, LinkFailure::Kind(ErrorKind::ConnectionReset));
    assert_eq!(link.read_u8().await.unwrap_err().kind(), ErrorKind::ConnectionReset);
}

#[tokio::test(start_paused = true)]
async fn an_end_lasts_and_so_does_a_stall() {
    let (near, _far) = fed(b"abc").await;
    let mut link = FaultyLink::new(near).fail(Call::Read, 0, LinkFailure::End);
    for _ in 0..3 {
        assert_eq!(link.read(&mut [0; 8]).await.unwrap(), 0);
    }
    let (near, _far) = fed(b"abc").await;
    let mut link = FaultyLink::new(near).fail(Call::Read, 0, LinkFailure::Stall).fail(
        Call::Write,
        1,
        LinkFailure::Stall,
    );
    assert!(is_stuck(link.read_u8()).await);
    assert_eq!(link.write(b"V").await.unwrap(), 1);
    assert!(is_stuck(link.write(b"V")).await);
}

#[tokio::test(start_paused = true)]
async fn writes_fail_or_accept_a_part() {
    let (near, mut far) = duplex(4096);
    let mut link =
        FaultyLink::new(near).partial_writes(2).fail(Call::Write, 2, LinkFailure::Errno(28));
    let counter = link.counter();
    assert_eq!(link.write(b"abcde").await.unwrap(), 2);
    assert_eq!(link.write(b"cde").await.unwrap(), 2);
    assert_eq!(link.write(b"e").await.unwrap_err().raw_os_error(), Some(28));
    link.write_all(b"e").await.unwrap();
    assert_eq!((counter.writes(), counter.bytes_written()), (3, 5));
    drop(link);
    let mut written = Vec::new();
    far.read_to_end(&mut written).await.unwrap();
    assert_eq!(written, b"abcde");
}

#[tokio::test(start_paused = true)]
async fn reads_stop_where_they_are_split() {
    for place in 0..=6 {
        let (near, far) = fed(b"abcdef").await;
        drop(far);
        let mut link = FaultyLink::new(near).split_reads_at([place]);
        let mut parts = Vec::new();
        loop {
            let mut buffer = [0; 64];
            let count = link.read(&mut buffer).await.unwrap();
            if count == 0 {
                break;
            }
            parts.push(buffer[..count].to_vec());
        }
        let (head, tail) = b"abcdef".split_at(place as usize);
        let expected: Vec<&[u8]> =
            [head, tail].into_iter().filter(|part| !part.is_empty()).collect();
        assert_eq!(parts, expected);
    }
}

#[tokio::test(start_paused = true)]
async fn a_loopback_returns_what_is_written_and_nothing_else() {
    let (near, _far) = fed(b"never read").await;
    let mut link = FaultyLink::new(near).loopback();
    assert!(is_stuck(link.read_u8()).await);
    assert_eq!(ask(&mut link, "V\n").await, "V\n\n");
    // A waiting reader is woken by a write.
    let (mut read, mut write) = tokio::io::split(link);
    let reader = tokio::spawn(async move { read.read_u8().await.unwrap() });
    tokio::task::yield_now().await;
    write.write_all(b"x").await.unwrap();
    assert_eq!(reader.await.unwrap(), b'x');
}

#[tokio::test(start_paused = true)]
async fn an_echo_comes_before_the_reply() {
    let mut link = FaultyLink::new(instant_sensor().build().link()).echo();
    assert_eq!(ask(&mut link, "L0").await, "L0\nL0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn flushes_are_counted() {
    let mut link = FaultyLink::new(instant_sensor().build().link());
    let counter = link.counter();
    ask(&mut link, "V").await;
    assert_eq!(counter.flushes(), 0);
    link.flush().await.unwrap();
    assert_eq!(counter.flushes(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_change_of_the_baud_rate_fails_on_request() {
    let emulator = instant_sensor().baud_rate(BaudRate::B57600).build();
    let mut link = FaultyLink::new(emulator.link()).fail(
        Call::SetBaudRate,
        0,
        LinkFailure::Kind(ErrorKind::Other),
    );
    let counter = link.counter();
    assert!(link.set_baud_rate(BaudRate::B57600).is_err());
    assert_eq!(link.baud_rate(), Some(BaudRate::B19200));
    link.set_baud_rate(BaudRate::B57600).unwrap();
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
    assert_eq!(counter.baud_rate_changes(), 2);
}

/// A port that replays bytes of 1970.
struct OldPort;

impl AsyncRead for OldPort {
    fn poll_read(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        _: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        Poll::Pending
    }
}

impl AsyncWrite for OldPort {
    fn poll_write(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl Port for OldPort {
    fn wall_clock(&self) -> SystemTime {
        SystemTime::UNIX_EPOCH
    }
}

#[test]
fn a_faulty_link_has_the_wall_clock_of_its_port() {
    assert_eq!(FaultyLink::new(OldPort).wall_clock(), SystemTime::UNIX_EPOCH);
}
