use tokio::time::advance;

use super::super::config::Wanted;
use super::super::transport::scripted_port::ScriptedPort;
use super::scip1::{COPY_TIME, EchoKind, LIMITS};
use super::*;
use crate::protocol::Status;

const NANOSECOND: Duration = Duration::from_nanos(1);

/// Creates a session at 19,200 baud that receives these bytes in one piece.
fn session(input: &[u8]) -> Session {
    let (reads, baud_rate) = ([Ok(input.to_vec())].into(), Some(BaudRate::B19200));
    session_on(ScriptedPort { reads, baud_rate, ..ScriptedPort::default() })
}

fn session_on(port: ScriptedPort) -> Session {
    let shared = Arc::new(Shared::new(None));
    Session::new(
        Box::new(port),
        None,
        Wanted::default(),
        Leftovers::unknown(),
        Arc::default(),
        shared,
    )
}

#[tokio::test]
async fn an_early_reply_disproves_the_baud_rate() {
    let refused = Status::new(b'6');
    let full = Command::Distances(Window::FULL);
    // The bytes of the command and its reply, and their time.
    for (command, status, wire) in [
        (Command::LaserOff, Status::OK, 4_687_500),
        (full, Status::OK, 826_041_666),
        // A refusal has its echo, a status and two LFs: 10 and 13 bytes.
        (full, refused, 11_979_166),
    ] {
        for (early, is_disproved) in [(Duration::ZERO, false), (NANOSECOND, true)] {
            let mut session = session(b"");
            let began = Instant::now();
            let times = ReplyTimes {
                requested: began,
                began,
                received: began + Duration::from_nanos(wire) - early,
                stamp: std::time::SystemTime::now(),
                is_replayed: false,
            };
            session.scip1.check_speed(&command, BaudRate::B19200, status, &times);
            assert_eq!(session.scip1.line.is_baud_rate_disproved, is_disproved, "{command}");
            assert_eq!(
                session.scip1.line.shared.counters.stats().baud_rate_disproved,
                is_disproved
            );
            assert_eq!(session.believed_baud_rate().is_none(), is_disproved);
        }
    }
}

#[tokio::test]
async fn a_time_limit_includes_the_wire() {
    let session = session(b"");
    // 3 bytes and 6 bytes of 520.8 us, and 10 and 1,576.
    for (command, wire) in
        [(Command::LaserOff, 4_687_500), (Command::Distances(Window::FULL), 826_041_666)]
    {
        assert_eq!(session.scip1.wire_time(&command), Duration::from_nanos(wire));
    }
}

#[tokio::test(start_paused = true)]
async fn a_copy_may_come_soon_after_a_reply() {
    let mut session = session(b"L0\n0\n\n");
    assert!(!session.scip1.may_be_copied(), "there is nothing to copy");
    session.scip1.exchange(Command::LaserOff, EchoKind::Common).await.unwrap();
    advance(COPY_TIME - NANOSECOND).await;
    assert!(session.scip1.may_be_copied());
    advance(NANOSECOND).await;
    assert!(!session.scip1.may_be_copied());
}

#[tokio::test(start_paused = true)]
async fn a_copy_that_waits_in_the_port_answers_no_command() {
    let mut session = session(b"L0\n0\n\n");
    session.scip1.exchange(Command::LaserOff, EchoKind::Common).await.unwrap();
    let copy =
        ScriptedPort { reads: [Ok(b"L0\n0\n\n".to_vec())].into(), ..ScriptedPort::default() };
    session.scip1.line.transport = Transport::new(Box::new(copy), &LIMITS, false);
    assert!(!session.needs_probe());
    assert!(session.scip1.command(Command::LaserOff).await.is_err());
}

#[tokio::test(start_paused = true)]
async fn a_device_that_takes_no_bytes_gets_one_fence() {
    for (holds_output, sent) in [(true, 1), (false, 6)] {
        let mut session = session_on(ScriptedPort { holds_output, ..ScriptedPort::default() });
        let began = Instant::now();
        assert!(session.scip1.fence().await.is_err());
        assert_eq!(session.scip1.line.shared.counters.stats().fences, sent);
        assert_eq!(began.elapsed().as_millis() / 100, 30, "it is given up as soon");
    }
}
