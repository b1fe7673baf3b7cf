//! Tests of a transport on a line in memory, to the byte and to the nanosecond: the time
//! limit of a command, and the replies that disprove a baud rate.

use std::time::SystemTime;

use tokio::time::advance;

use super::scripted_port::ScriptedPort;
use super::*;
use crate::Window;

const LATENCY: Duration = Duration::from_millis(100);
const NANOSECOND: Duration = Duration::from_nanos(1);

/// Returns a transport at 19,200 baud, to which these bytes come in one piece.
fn transport(input: &[u8]) -> Transport {
    let reads = (!input.is_empty()).then(|| Ok(input.to_vec())).into_iter().collect();
    let baud_rate = Some(BaudRate::B19200);
    let port = ScriptedPort { reads, baud_rate, ..ScriptedPort::default() };
    Transport::new(Box::new(port), None, Arc::new(Telemetry::new(None)))
}

#[tokio::test(start_paused = true)]
async fn a_reply_that_does_not_come_is_an_error_after_the_time_of_its_bytes_and_the_latency() {
    // 3 bytes and 6 bytes of 520.8 us, and 10 and 1,576.
    for (command, wire) in
        [(Command::LaserOff, 4_687_500), (Command::Distances(Window::FULL), 826_041_666)]
    {
        let limit = Duration::from_nanos(wire) + LATENCY;
        let (mut transport, start) = (transport(b""), Instant::now());
        let outcome = transport.exchange(&command, LATENCY, &mut |_, _| None).await;
        let Err(ExchangeError::Command(Error::Timeout { after, .. })) = outcome else {
            panic!("{outcome:?}")
        };
        assert_eq!(after, limit);
        let waited = start.elapsed();
        // tokio's timers count whole milliseconds.
        assert!(waited >= limit && waited < limit + Duration::from_millis(2), "{waited:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn of_two_replies_in_one_read_the_second_one_counts_if_the_first_is_stale() {
    let mut transport = transport(b"L1\n0\n\nL0\n0\n\n");
    let mut stale = Vec::new();
    let mut judge = |frame: Frame<&[u8]>, _: Timing| match frame {
        Frame::Reply(b"L0\n0") => Some(Ok(Status::OK)),
        Frame::Reply(other) => {
            stale.push(other.to_vec());
            None
        }
        Frame::Overlong { .. } => None,
    };
    transport.exchange(&Command::LaserOff, LATENCY, &mut judge).await.unwrap();
    assert_eq!(stale, [b"L1\n0"]);
}

#[tokio::test(start_paused = true)]
async fn a_reply_disproves_the_baud_rate_if_it_comes_a_nanosecond_before_its_bytes_can() {
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
            let mut transport = transport(b"");
            let requested = Instant::now();
            let received = requested + Duration::from_nanos(wire) - early;
            let stamp = SystemTime::UNIX_EPOCH;
            let timing = Timing { requested, began: received, received, stamp };
            transport.note_unique_reply(&command, status, timing);
            assert_eq!(transport.telemetry.stats().baud_rate_outrun, is_outrun, "{command}");
            assert_eq!(transport.least_wire_time(1).is_zero(), is_outrun, "{command}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_copy_of_a_reply_may_come_for_less_than_20_ms() {
    let mut transport = transport(b"L0\n0\n\n");
    assert!(!transport.may_echo(), "there is nothing to copy");
    let mut judge = |_: Frame<&[u8]>, _: Timing| Some(Ok(Status::OK));
    transport.exchange(&Command::LaserOff, LATENCY, &mut judge).await.unwrap();
    advance(QUIET_TIME - NANOSECOND).await;
    assert!(transport.may_echo());
    advance(NANOSECOND).await;
    assert!(!transport.may_echo());
}
