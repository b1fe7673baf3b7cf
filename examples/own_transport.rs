//! A transport of one's own: a program whose standard input and output lead to a sensor,
//! such as `socat` on another machine:
//!
//! ```sh
//! cargo run --example own_transport "ssh robot socat - /dev/ttyACM0,raw,echo=0"
//! cargo run --example own_transport emulated
//! ```
//!
//! The driver calls `connect` again after each loss of the link.

use std::process::Stdio;

use tokio::io::{Join, join};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio_scip::port::{Connect, StreamPort};
use tokio_scip::{Error, ErrorChain, ErrorKind, Rate, Sensor, Window};
use urg_emulator::Emulator;

/// A command of the shell, started for each link.
pub(crate) struct Program {
    command: String,
    /// Killed when it is replaced or dropped.
    child: Option<Child>,
}

impl Program {
    pub(crate) fn new(command: impl Into<String>) -> Self {
        Self { command: command.into(), child: None }
    }
}

impl Connect for Program {
    type Port = StreamPort<Join<ChildStdout, ChildStdin>>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let mut command = Command::new("sh");
        command.arg("-c").arg(&self.command).kill_on_drop(true);
        let child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        // An error that is transient is tried again, see `Error::is_transient`.
        let failed = |error| Error::open(&self.command, error);
        let child = self.child.insert(child.map_err(failed)?);
        let (Some(from), Some(to)) = (child.stdout.take(), child.stdin.take()) else {
            return Err(ErrorKind::NoSuchPort { port: self.command.clone() }.into());
        };
        Ok(StreamPort::new(join(from, to)))
    }

    fn name(&self) -> Option<&str> {
        Some(&self.command)
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Error> {
    let command = std::env::args().nth(1).unwrap_or("emulated".to_owned());
    let sensor = if command == "emulated" {
        // Any stream of bytes serves: this one is a pipe in memory, to an emulated sensor.
        let (near, far) = tokio::io::duplex(4096);
        tokio::spawn(async move { Emulator::default().serve(far).await });
        Sensor::builder().attach(near).await?
    } else {
        Sensor::builder().connect(Program::new(command)).await?
    };
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    while let Some(scan) = scans.next().await {
        match scan {
            Ok(scan) => println!("scan {}: {} points", scan.sequence(), scan.points().count()),
            Err(error) => eprintln!("no scan: {}", ErrorChain(&error)),
        }
    }
    Ok(())
}
