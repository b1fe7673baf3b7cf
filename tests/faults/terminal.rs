//! Row O19: opening a serial port must not make it the process's controlling terminal,
//! or its hang-up would end the process.

use tokio_serial::{SerialPort as _, SerialStream};

use crate::common::open_serial;

/// Set for the copy of this test that leads a session without a terminal: only such a
/// process gets a controlling terminal by opening one.
const LEADER: &str = "TOKIO_SCIP_SESSION_LEADER";

/// Returns the number of this process's controlling terminal, 0 for none.
fn controlling_terminal() -> i32 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    // The fields after the name, which is in parentheses: state, parent, process group,
    // session, terminal.
    let fields = stat.rsplit_once(')').unwrap().1;
    fields.split_whitespace().nth(4).unwrap().parse().unwrap()
}

#[tokio::test]
async fn o19_an_opened_port_does_not_become_the_controlling_terminal() {
    if std::env::var_os(LEADER).is_some() {
        assert_eq!(controlling_terminal(), 0);
        let (_far, near) = SerialStream::pair().unwrap();
        let path = near.name().unwrap();
        let _port = open_serial(&path).await.unwrap();
        assert_eq!(controlling_terminal(), 0, "the port became the controlling terminal");
        // The check can fail: a terminal opened without O_NOCTTY becomes the process's.
        let (far, careless) = SerialStream::pair().unwrap();
        let opened = std::fs::File::open(careless.name().unwrap()).unwrap();
        assert_ne!(
            controlling_terminal(),
            0,
            "opening a terminal had no effect, so the test proves nothing"
        );
        // Its hang-up would end this process.
        std::mem::forget((far, opened));
        return;
    }
    let test = std::env::current_exe().unwrap();
    let name = "faults::terminal::o19_an_opened_port_does_not_become_the_controlling_terminal";
    let child = std::process::Command::new("setsid")
        .arg("--wait")
        .arg(test)
        .args(["--exact", name, "--test-threads", "1"])
        .env(LEADER, "1")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&child.stdout);
    assert!(child.status.success() && said.contains("1 passed"), "{said}");
}
