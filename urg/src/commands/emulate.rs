//! `urg emulate`: emulates a sensor for other programs.

#[cfg(unix)]
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::ValueEnum;
use tokio::net::TcpListener;
use tokio_scip::BaudRate;
#[cfg(unix)]
use urg_emulator::Pty;
use urg_emulator::{Emulator, Faults, Firmware, Model, Room};

use crate::args::{duration, listen_address};
use crate::failure::Failure;
use crate::output::notice::notice;
#[cfg(unix)]
use crate::recording::rewrite::perhaps_without_folder;

/// Emulate a sensor for other programs, until Ctrl-C
///
/// The sensor measures a room where people walk. By default it is a URG-04LX on USB, on a pseudo-terminal that you
/// open like a serial port. Other models speak SCIP 2. With the same seed it sends the same scans at the same times.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  urg emulate --link /tmp/urg                   then: urg stream /tmp/urg
  urg emulate --tcp 4001                        then: urg stream tcp://127.0.0.1:4001
  urg emulate --link /tmp/urg --baud 19200 --faults late=0.01:2s,lost=0.01
  urg emulate --model ust-10lx --tcp 10940      then: urg stream tcp://127.0.0.1")]
pub(crate) struct Emulate {
    /// Symbolic link to create to the pseudo-terminal; replaces a link left by an earlier emulator
    #[cfg(unix)]
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// Replace the link even if it is another program's, or its terminal exists
    #[cfg(unix)]
    #[arg(long, requires = "link")]
    force: bool,
    /// Serve on TCP instead: a port number for this machine only, or ADDRESS:PORT
    /// (0.0.0.0:4001 opens the sensor to your whole network)
    #[arg(long, value_name = "ADDR", value_parser = listen_address)]
    #[cfg_attr(unix, arg(conflicts_with = "link"))]
    tcp: Option<String>,
    /// Model of the sensor
    #[arg(long, value_enum, default_value_t = ModelName::Urg04lx)]
    model: ModelName,
    /// Emulate RS-232 at this baud rate instead of USB; a real sensor has 19200 after
    /// power-up. Only a URG-04LX has RS-232
    #[arg(long, value_name = "RATE")]
    baud: Option<BaudRate>,
    /// Firmware dialect of a URG-04LX; v3 unless set
    #[arg(long, value_enum)]
    firmware: Option<FirmwareDialect>,
    /// Serial number of the sensor
    #[arg(long, value_name = "NUMBER", default_value = "H0713090", value_parser = serial_number)]
    serial_number: String,
    /// Duration of one revolution of the motor, and so of a scan [default: URG 100ms, others 25ms]
    #[arg(long, value_name = "TIME", value_parser = duration)]
    revolution: Option<Duration>,
    /// Room around the sensor
    #[arg(long, value_enum, default_value_t = RoomKind::Easy)]
    room: RoomKind,
    /// Seed of the room and of faults
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    seed: u64,
    /// Faults to inject, each with its probability, such as late=0.01:3s,lost=0.005,damaged=0.01,hang-up=0.001
    ///
    /// The names are late and pause (with a maximum time), lost, command-lost, damaged, doubled, merged, noise (with
    /// a maximum length in bytes, such as noise=0.01:64), reset, hang-up, and seed=NUMBER; in SCIP 2 also wrong-sum,
    /// ignored (an answer without effect) and clock-jump (with a maximum time).
    #[arg(long, value_name = "SPEC")]
    faults: Option<Faults>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ModelName {
    /// SCIP 1.1 on USB or RS-232, 10 scans a second
    #[value(name = "urg-04lx")]
    Urg04lx,
    /// SCIP 2 on USB, 10 scans a second
    #[value(name = "urg-04lx-ug01")]
    Urg04lxUg01,
    /// SCIP 2 on USB, 40 scans a second
    #[value(name = "utm-30lx")]
    Utm30lx,
    /// SCIP 2 on Ethernet, 40 scans a second
    #[value(name = "ust-10lx")]
    Ust10lx,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum FirmwareDialect {
    /// As in the protocol text: V has five lines, unknown commands get no reply
    Text,
    /// As in real sensors: V has six lines, unknown commands get the reply E
    V3,
    /// The same, and SCIP2.0 switches to SCIP 2
    V31,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum RoomKind {
    /// 5.0 by 4.4 m with two people; about 8 % of the points have no distance
    Easy,
    /// About 55 % of the points have no distance, as in captures of a real sensor
    Hard,
}

impl Emulate {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        if self.model != ModelName::Urg04lx && (self.baud.is_some() || self.firmware.is_some()) {
            let unknown = "only a URG-04LX has these: leave out --baud and --firmware";
            return Err(Failure::Usage(unknown.to_owned()));
        }
        let emulator = self.emulator();
        match &self.tcp {
            Some(address) => self.serve_tcp(&emulator, address).await,
            None => self.serve_pty(&emulator).await,
        }
    }

    fn emulator(&self) -> Emulator {
        let builder = Emulator::builder()
            .model(match self.model {
                ModelName::Urg04lx => Model::Urg04lx,
                ModelName::Urg04lxUg01 => Model::Urg04lxUg01,
                ModelName::Utm30lx => Model::Utm30lx,
                ModelName::Ust10lx => Model::Ust10lx,
            })
            .firmware(match self.firmware {
                Some(FirmwareDialect::Text) => Firmware::Text,
                Some(FirmwareDialect::V3) | None => Firmware::V3,
                Some(FirmwareDialect::V31) => Firmware::V31,
            })
            .serial_number(&self.serial_number)
            .seed(self.seed)
            .faults(self.faults.clone().unwrap_or_default());
        let builder = match self.room {
            RoomKind::Easy => builder.world(Room::new(self.seed)),
            RoomKind::Hard => builder.world(Room::hard(self.seed)),
        };
        let builder = match self.revolution {
            Some(revolution) => builder.revolution(revolution),
            None => builder,
        };
        match self.baud {
            Some(speed) => builder.baud_rate(speed),
            None => builder.usb(),
        }
        .build()
    }

    async fn serve_tcp(&self, emulator: &Emulator, address: &str) -> Result<(), Failure> {
        let failed = |error| {
            Failure::new(format_args!("cannot serve on {address}"), &error)
                .advise("--tcp chooses another address, such as `--tcp 4002`")
        };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let speed = self.baud.filter(|speed| *speed != BaudRate::B19200);
        let query = speed.map(|speed| format!("?baud={speed}")).unwrap_or_default();
        self.announce(&format!("tcp://{address}{query}"));
        emulator.serve_tcp(listener).await.map_err(failed)
    }

    #[cfg(unix)]
    async fn serve_pty(&self, emulator: &Emulator) -> Result<(), Failure> {
        let failed = |error| match &self.link {
            Some(link) => perhaps_without_folder(link, &error),
            None => Failure::new("cannot serve on a pseudo-terminal", &error),
        };
        self.link.as_deref().filter(|_| !self.force).map_or(Ok(()), check_link)?;
        let pty = Pty::open(emulator, self.link.as_deref()).map_err(failed)?;
        self.announce(&pty.path().display().to_string());
        pty.serve().await.map_err(failed)
    }

    #[cfg(not(unix))]
    async fn serve_pty(&self, _: &Emulator) -> Result<(), Failure> {
        Err(Failure::Usage("this system has no pseudo-terminals: use --tcp 4001".to_owned()))
    }

    /// Prints the port of the sensor, and a command to try.
    fn announce(&self, port: &str) {
        let speed = self.baud.map(|speed| format!(" at {speed} baud")).unwrap_or_default();
        notice(format_args!("emulated sensor {}{speed}, on {port}", self.serial_number));
        let scip2 = if self.model == ModelName::Urg04lx { "" } else { "it speaks SCIP 2: " };
        notice(format_args!("{scip2}try `urg info {port}`; Ctrl-C stops the sensor"));
    }
}

/// Fails if no emulator has left the link at `path`: its terminal exists, or it never led to one.
#[cfg(unix)]
fn check_link(path: &Path) -> Result<(), Failure> {
    let terminals = if cfg!(target_os = "linux") { "/dev/pts/" } else { "/dev/ttys" };
    match path.read_link() {
        Ok(target) if target.exists() || !target.to_string_lossy().starts_with(terminals) => {
            Err(Failure::Failed(format!(
                "cannot serve on {}: it is a link to {}, and not of an emulator that has ended; \
                 use another --link, or replace it with --force",
                path.display(),
                target.display()
            )))
        }
        _ => Ok(()),
    }
}

/// Parses a serial number, a line of the reply to `V`.
fn serial_number(text: &str) -> Result<String, &'static str> {
    let is_line = !text.is_empty() && !text.contains(char::is_control);
    is_line.then(|| text.to_owned()).ok_or("expected text without control characters")
}
