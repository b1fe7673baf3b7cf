//! Tests of a transport on a line in memory, to the byte and to the nanosecond.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use tokio::io::AsyncWriteExt;
use tokio::task::coop::has_budget_remaining;
use tokio::time::{advance, timeout};

use super::super::failure::LinkError;
use super::arrivals::FLOOD_BYTES;
use super::link::QUIET_TIME;
use super::scripted_port::ScriptedPort;
use super::*;
use crate::port::StreamPort;
use crate::protocol::Status;
use crate::{BaudRate, ErrorKind, Window};

const LATENCY: Duration = Duration::from_millis(100);
const NANOSECOND: Duration = Duration::from_nanos(1);

fn on(port: impl Port) -> Transport {
    Transport::new(Box::new(port), None, Arc::new(Telemetry::new(None)))
}

/// Creates a transport at 19,200 baud that receives these bytes in one piece.
fn transport(input: &[u8]) -> Transport {
    let reads = (!input.is_empty()).then(|| Ok(input.to_vec())).into_iter().collect();
    let baud_rate = Some(BaudRate::B19200);
    on(ScriptedPort { reads, baud_rate, ..ScriptedPort::default() })
}

/// Creates two transports with reads of these lengths: the port of one can be read
/// without waiting, the port of the other cannot.
fn transports(reads: &[Result<usize, io::ErrorKind>]) -> [Transport; 2] {
    [true, false].map(|has_try_read| {
        let reads = reads.iter().map(|read| read.map(|length| vec![0; length])).collect();
        on(ScriptedPort { reads, has_try_read, ..ScriptedPort::default() })
    })
}

/// Drops pending bytes, and returns their number.
async fn discard(transport: &mut Transport) -> Result<u64, ErrorKind> {
    let before = transport.received();
    transport.discard_pending().await.map_err(|failure| LinkError::from(failure).into_kind())?;
    Ok(transport.received() - before)
}

#[tokio::test]
async fn o15_bytes_behind_an_interrupted_read_are_dropped_and_each_time_counted_anew() {
    let quiet = Err(io::ErrorKind::WouldBlock);
    let interrupted = Err(io::ErrorKind::Interrupted);
    let reads = [Ok(100), interrupted, Ok(20), quiet, Ok(7), quiet, interrupted, Ok(0)];
    for mut transport in transports(&reads) {
        assert_eq!(discard(&mut transport).await.unwrap(), 120);
        assert_eq!(discard(&mut transport).await.unwrap(), 7);
        assert!(matches!(
            discard(&mut transport).await,
            Err(ErrorKind::Disconnected { source: None, .. })
        ));
        assert_eq!(transport.received(), 127);
    }
}

/// Creates a transport whose port fails each read with this error, and counts the reads.
fn refusing(kind: io::ErrorKind, has_try_read: bool) -> (Transport, Arc<AtomicU64>) {
    let (port, reads) = (ScriptedPort { has_try_read, ..ScriptedPort::default() }, Arc::default());
    (on(ScriptedPort { refusal: Some((kind, Arc::clone(&reads))), ..port }), reads)
}

#[tokio::test(start_paused = true)]
async fn o15_a_port_that_is_interrupted_for_ever_blocks_nobody() {
    for has_try_read in [true, false] {
        let (mut transport, reads) = refusing(io::ErrorKind::Interrupted, has_try_read);
        assert_eq!(discard(&mut transport).await.unwrap(), 0);
        assert_eq!(reads.load(Ordering::Relaxed), 16);
    }
    let (mut transport, _) = refusing(io::ErrorKind::Interrupted, false);
    let outcome = transport.ask(&Command::LaserOff, LATENCY).await;
    assert!(
        matches!(outcome, Err(ExchangeError::Command(ErrorKind::Timeout { .. }))),
        "{outcome:?}"
    );
}

#[tokio::test(start_paused = true)]
async fn o15_a_port_that_refuses_to_read_while_idle_is_asked_200_times_a_second() {
    let (mut transport, reads) = refusing(io::ErrorKind::WouldBlock, false);
    let second = Duration::from_secs(1);
    assert!(timeout(second, transport.idle()).await.is_err());
    assert!((195..=201).contains(&reads.load(Ordering::Relaxed)), "{reads:?}");
}

#[tokio::test]
async fn a_read_that_fails_ends_the_dropping_of_bytes_with_its_error() {
    for mut transport in transports(&[Ok(100), Err(io::ErrorKind::BrokenPipe), Ok(20)]) {
        assert_eq!(kind(discard(&mut transport).await), io::ErrorKind::BrokenPipe);
    }
}

#[tokio::test]
async fn one_byte_more_than_64_kib_after_a_command_is_a_flood() {
    let all_but_one: Vec<_> = (0..127).map(|_| Ok(512)).chain([Ok(511)]).collect();
    let quiet = Err(io::ErrorKind::WouldBlock);
    let reads = [all_but_one.as_slice(), &[Ok(1), quiet]].concat();
    for mut transport in transports(&reads) {
        assert_eq!(discard(&mut transport).await.unwrap(), FLOOD_BYTES);
    }
    let reads = [all_but_one.as_slice(), &[Ok(2), quiet]].concat();
    for mut transport in transports(&reads) {
        assert_eq!(kind(discard(&mut transport).await), io::ErrorKind::InvalidData);
    }
}

/// Kind of the I/O error of a lost link.
fn kind(outcome: Result<u64, ErrorKind>) -> io::ErrorKind {
    let Err(ErrorKind::Disconnected { source: Some(source), .. }) = outcome else {
        panic!("{outcome:?}")
    };
    source.kind()
}

async fn use_up_budget() {
    while has_budget_remaining() {
        consume_budget().await;
    }
}

#[tokio::test]
async fn an_empty_budget_is_no_quiet_line() {
    for has_try_read in [true, false] {
        let reads = [Ok(vec![0; 100]), Ok(vec![0; 20])].into();
        let port = ScriptedPort { reads, has_try_read, takes_budget: true, ..Default::default() };
        let mut transport = on(port);
        use_up_budget().await;
        assert_eq!(discard(&mut transport).await.unwrap(), 120, "{has_try_read}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_reply_that_is_there_is_seen_by_a_task_without_budget_though_it_is_late() {
    let (near, mut far) = tokio::io::duplex(64);
    let mut transport = on(StreamPort::new(near));
    let deadline = transport.send(&Command::LaserOff, Duration::ZERO).await.unwrap();
    far.write_all(b"L0\n0\n\n").await.unwrap();
    use_up_budget().await;
    let received = transport.next_frame(deadline).await.unwrap();
    assert_eq!(received.frame, Frame::Reply(&b"L0\n0"[..]));
    let outcome = transport.next_frame(deadline).await;
    assert!(matches!(outcome, Err(ExchangeError::Command(ErrorKind::Timeout { .. }))));
}

#[tokio::test(start_paused = true)]
async fn a_reply_that_does_not_come_is_an_error_after_the_time_of_its_bytes_and_the_latency() {
    // 3 bytes and 6 bytes of 520.8 us, and 10 and 1,576.
    for (command, wire) in
        [(Command::LaserOff, 4_687_500), (Command::Distances(Window::FULL), 826_041_666)]
    {
        let limit = Duration::from_nanos(wire) + LATENCY;
        let (mut transport, start) = (transport(b""), Instant::now());
        let outcome = transport.ask(&command, LATENCY).await;
        let Err(ExchangeError::Command(ErrorKind::Timeout { after, .. })) = outcome else {
            panic!("{outcome:?}")
        };
        assert_eq!(after, limit);
        let waited = start.elapsed();
        // tokio's timers count whole milliseconds.
        assert!(waited >= limit && waited < limit + Duration::from_millis(2), "{waited:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn of_two_replies_in_one_read_each_is_a_frame_and_the_second_makes_the_link_dirty() {
    let mut transport = transport(b"L1\n0\n\nL0\n0\n\n");
    transport.mark_clean();
    let deadline = transport.send(&Command::LaserOff, LATENCY).await.unwrap();
    let stale = transport.next_frame(deadline).await.unwrap();
    assert_eq!(stale.frame, Frame::Reply(&b"L1\n0"[..]));
    assert!(!transport.is_dirty());
    let answer = transport.next_frame(deadline).await.unwrap();
    assert_eq!(answer.frame, Frame::Reply(&b"L0\n0"[..]));
    assert!(transport.is_dirty());
    assert_eq!(transport.telemetry.stats().bytes_skipped, 6);
}

#[test]
fn a_reply_disproves_the_baud_rate_if_it_comes_a_nanosecond_before_its_bytes_can() {
    let refused = Status::new(b'6');
    let full = Command::Distances(Window::FULL);
    // The bytes of the command and its reply, and their time.
    for (command, status, wire) in [
        (Command::LaserOff, Status::OK, 4_687_500),
        (full, Status::OK, 826_041_666),
        // A refusal has its echo, a status and two LFs: 10 and 13 bytes.
        (full, refused, 11_979_166),
    ] {
        for (early, is_outrun) in [(Duration::ZERO, false), (NANOSECOND, true)] {
            let requested = Instant::now();
            let received = requested + Duration::from_nanos(wire) - early;
            let (stamp, baud_rate) = (SystemTime::UNIX_EPOCH, Some(BaudRate::B19200));
            let is_replayed = false;
            let timing =
                Timing { requested, began: received, received, stamp, is_replayed, baud_rate };
            assert_eq!(timing.disproves_baud_rate(&command, status), is_outrun, "{command}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn no_timing_has_the_baud_rate_that_a_reply_has_disproved() {
    let mut transport = transport(b"L1\n0\n\nL0\n0\n\n");
    let deadline = transport.send(&Command::LaserOff, LATENCY).await.unwrap();
    let before = transport.next_frame(deadline).await.unwrap().timing.baud_rate;
    transport.note_outrun();
    let after = transport.next_frame(deadline).await.unwrap().timing.baud_rate;
    assert_eq!((before, after), (Some(BaudRate::B19200), None));
    assert!(transport.telemetry.stats().baud_rate_outrun);
}

#[tokio::test(start_paused = true)]
async fn a_copy_of_a_reply_may_come_for_less_than_20_ms() {
    let mut transport = transport(b"L0\n0\n\n");
    assert!(!transport.may_echo(), "there is nothing to copy");
    transport.ask(&Command::LaserOff, LATENCY).await.unwrap();
    advance(QUIET_TIME - NANOSECOND).await;
    assert!(transport.may_echo());
    advance(NANOSECOND).await;
    assert!(!transport.may_echo());
}
