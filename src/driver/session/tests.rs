use super::super::config::Wanted;
use super::super::transport::scripted_port::ScriptedPort;
use super::scip1::{EchoKind, LIMITS};
use super::*;

/// Creates a port with a reply to `L0` to read.
fn replying() -> ScriptedPort {
    ScriptedPort { reads: [Ok(b"L0\n0\n\n".to_vec())].into(), ..ScriptedPort::default() }
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

#[tokio::test(start_paused = true)]
async fn a_copy_that_waits_in_the_port_answers_no_command() {
    let mut session = session_on(replying());
    session.scip1.exchange(Command::LaserOff, EchoKind::Common).await.unwrap();
    session.scip1.line.transport = Transport::new(Box::new(replying()), &LIMITS, false);
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
