//! Tests of a transport on a line in memory, to the byte and to the nanosecond.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::io::AsyncWriteExt;
use tokio::task::coop::has_budget_remaining;
use tokio::time::{advance, sleep, timeout};

use super::super::failure::LinkError;
use super::scripted_port::ScriptedPort;
use super::*;
use crate::port::StreamPort;
use crate::{BaudRate, ErrorKind};

const LIMIT: Duration = Duration::from_millis(100);
const LIMITS: Limits = Limits { frame: 4096, frames: 64, bytes: 64 * 1024 };
const ANY: Expected = Expected { reply: None, limits: &LIMITS };

fn on(port: impl Port) -> Transport {
    Transport::new(Box::new(port), &LIMITS, true)
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
    transport.discard_pending().await.map_err(LinkError::into_kind)
}

#[tokio::test]
async fn o15_bytes_after_an_interrupted_read_are_dropped() {
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
    let outcome = transport.ask(b"L0", &ANY, LIMIT).await;
    assert!(matches!(outcome, Err(NoFrame::Late { .. })), "{outcome:?}");
}

#[tokio::test(start_paused = true)]
async fn o15_a_busy_idle_port_is_asked_rarely() {
    let (mut transport, reads) = refusing(io::ErrorKind::WouldBlock, false);
    let second = Duration::from_secs(1);
    assert!(timeout(second, poll_fn(|cx| transport.poll_idle(cx))).await.is_err());
    assert!((195..=201).contains(&reads.load(Ordering::Relaxed)), "{reads:?}");
}

#[tokio::test]
async fn a_failed_read_ends_dropping() {
    for mut transport in transports(&[Ok(100), Err(io::ErrorKind::BrokenPipe), Ok(20)]) {
        assert_eq!(kind(discard(&mut transport).await), io::ErrorKind::BrokenPipe);
    }
}

#[tokio::test]
async fn too_many_bytes_are_a_flood() {
    let all_but_one: Vec<_> = (0..127).map(|_| Ok(512)).chain([Ok(511)]).collect();
    let quiet = Err(io::ErrorKind::WouldBlock);
    let reads = [all_but_one.as_slice(), &[Ok(1), quiet]].concat();
    for mut transport in transports(&reads) {
        assert_eq!(discard(&mut transport).await.unwrap(), LIMITS.bytes);
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
        // A budget that ends while bytes are dropped: it is of 128 calls.
        let reads = (0..300).map(|_| Ok(vec![0])).collect();
        let port = ScriptedPort { reads, has_try_read, takes_budget: true, ..Default::default() };
        assert_eq!(discard(&mut on(port)).await.unwrap(), 300, "{has_try_read}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_late_reply_is_seen_without_budget() {
    let (near, mut far) = tokio::io::duplex(64);
    let mut transport = on(StreamPort::new(near));
    transport.send(b"L0", &ANY, Duration::ZERO).await.unwrap();
    far.write_all(b"L0\n0\n\n").await.unwrap();
    use_up_budget().await;
    let received = transport.next_frame().await;
    assert_eq!(received.unwrap().frame(), Frame::Reply(&b"L0\n0"[..]));
    let outcome = transport.next_frame().await;
    assert!(matches!(outcome, Err(NoFrame::Late { .. })));
}

#[tokio::test(start_paused = true)]
async fn a_reply_that_came_while_the_program_was_stopped_is_seen() {
    let quiet = Err(io::ErrorKind::WouldBlock);
    // tokio has not yet asked the system again when the deadline fires.
    let reads = [quiet.clone(), quiet, Ok(b"V\n0\n\n".to_vec())].into();
    let mut transport = on(ScriptedPort { reads, ..ScriptedPort::default() });
    let (outcome, ()) = tokio::join!(transport.ask(b"V", &ANY, LIMIT), advance(50 * LIMIT));
    assert!(outcome.is_ok());
}

#[tokio::test(start_paused = true)]
async fn a_missing_reply_times_out() {
    for limit in [LIMIT, Duration::from_nanos(826_041_666)] {
        let (mut transport, start) = (transport(b""), Instant::now());
        let outcome = transport.ask(b"L0", &ANY, limit).await;
        let Err(NoFrame::Late { after }) = outcome else { panic!("{outcome:?}") };
        assert_eq!(after, limit);
        let waited = start.elapsed();
        // tokio's timers count whole milliseconds.
        assert!(waited >= limit && waited < limit + Duration::from_millis(2), "{waited:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_nul_in_front_begins_no_reply() {
    let (near, mut far) = tokio::io::duplex(64);
    let mut transport = on(StreamPort::new(near));
    let begin = Instant::now();
    let send = async {
        for piece in [&b"\0\0"[..], b"\0L0\n", b"0\n\n"] {
            sleep(Duration::from_millis(80)).await;
            far.write_all(piece).await.unwrap();
        }
    };
    let ask = transport.ask(b"L0", &ANY, Duration::from_secs(1));
    let (received, ()) = tokio::join!(ask, send);
    let times = received.unwrap().times;
    assert_eq!(times.began - begin, Duration::from_millis(160));
    assert_eq!(times.received - begin, Duration::from_millis(240));
}

#[tokio::test(start_paused = true)]
async fn a_nul_behind_a_reply_begins_no_other() {
    let (near, mut far) = tokio::io::duplex(64);
    let mut transport = on(StreamPort::new(near));
    let begin = Instant::now();
    let send = async {
        for piece in [&b"MD\n00P\n\n\0"[..], b"MD\n99b\n\n"] {
            sleep(Duration::from_millis(80)).await;
            far.write_all(piece).await.unwrap();
        }
    };
    let receive = async {
        transport.send(b"MD", &ANY, Duration::from_secs(1)).await.unwrap();
        drop(transport.next_frame().await.unwrap());
        transport.expect_unasked(&ANY, Duration::from_secs(1));
        let times = std::future::poll_fn(|cx| {
            transport.poll_unasked_frame(cx).map(|received| received.unwrap().times)
        });
        assert_eq!(times.await.began - begin, Duration::from_millis(160));
    };
    tokio::join!(send, receive);
}
