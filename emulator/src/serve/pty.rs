//! [`Pty`]: an emulated sensor on a pseudo-terminal.

use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustix::fs::{Mode, OFlags};
use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};
use serialport::TTYPort;
use tokio::time::interval;
use tokio_serial::{SerialPort, SerialStream};

use super::pump;
use crate::handle::Emulator;
use crate::link::HostBaudRate;

/// Pseudo-terminal with an emulated sensor at the other end.
///
/// Programs open [`path`](Self::path) as a serial port. They may close it and open it
/// again: the terminal keeps its unread bytes. With a sensor on RS-232, the client has to
/// set the sensor's baud rate; otherwise both sides receive garbage. Bytes take as much
/// time as on a real line.
///
/// The terminal works in real time: do not use it with tokio's paused clock.
///
/// To hang up the client and remove the symbolic link, drop the value or the future of
/// [`serve`](Self::serve).
///
/// A client that locks the terminal (`TIOCEXCL`) and is killed leaves the lock behind. So
/// [`serve`](Self::serve) removes this lock twice a second. Locks by `flock` hold.
///
/// A program that another thread starts at the moment when [`open`](Self::open) creates
/// the terminal inherits it. The terminal then cannot hang up while that program runs.
#[derive(Debug)]
pub struct Pty {
    emulator: Emulator,
    symlink: Option<PathBuf>,
    terminal: TerminalPair,
}

impl Pty {
    /// Creates a pseudo-terminal for the sensor, in raw mode at 19,200 baud, and a
    /// symbolic link to it if you pass a path. Replaces an existing symbolic link.
    ///
    /// # Errors
    ///
    /// Fails with [`AlreadyExists`](io::ErrorKind::AlreadyExists) if the path of the link
    /// exists and is no symbolic link, and with the system's errors.
    ///
    /// # Panics
    ///
    /// Panics outside of a tokio runtime with I/O enabled.
    pub fn open(emulator: &Emulator, symlink: Option<&Path>) -> io::Result<Self> {
        let terminal = TerminalPair::open(symlink)?;
        Ok(Self { emulator: emulator.clone(), symlink: symlink.map(Path::to_owned), terminal })
    }

    /// Path for clients to open: the symbolic link if there is one.
    pub fn path(&self) -> &Path {
        self.symlink.as_deref().unwrap_or(&self.terminal.path)
    }

    /// Serves the clients of the terminal until you drop the future.
    ///
    /// When you unplug the sensor, or a fault hangs up the link, the terminal and its
    /// symbolic link disappear. Plugging the sensor in creates a new terminal; without a
    /// symbolic link its path may differ.
    ///
    /// # Errors
    ///
    /// The errors of the system.
    pub async fn serve(self) -> io::Result<()> {
        let Self { emulator, symlink, mut terminal } = self;
        loop {
            let TerminalPair { master, slave, path: _, _symlink } = terminal;
            let shared = Arc::new(slave);
            let slave = shared.clone();
            let probe = move || tcgetattr(&slave).ok().map(|settings| settings.output_speed());
            let link = emulator.open(HostBaudRate::Probed(Box::new(probe)));
            tokio::select! {
                ended = pump(master, link) => ended?,
                () = unlock(&shared) => {}
            }
            drop((shared, _symlink));
            emulator.wait_until_plugged_in().await;
            terminal = TerminalPair::open(symlink.as_deref())?;
        }
    }
}

/// Time for which the lock of a killed client stays.
const UNLOCK_INTERVAL: Duration = Duration::from_millis(500);

/// Removes a lock (`TIOCEXCL`) again and again. Nothing tells when a client has ended, because the
/// terminal stays open here.
async fn unlock(slave: &OwnedFd) {
    let mut interval = interval(UNLOCK_INTERVAL);
    loop {
        interval.tick().await;
        // Fails only if the terminal has hung up.
        let _ = ioctl_tiocnxcl(slave);
    }
}

#[derive(Debug)]
struct TerminalPair {
    master: SerialStream,
    /// Kept open so that the terminal survives its clients. Not locked, so that they can.
    slave: OwnedFd,
    path: PathBuf,
    _symlink: Option<Symlink>,
}

impl TerminalPair {
    fn open(symlink: Option<&Path>) -> io::Result<Self> {
        // Programs that the process starts inherit the pair itself, and its master would
        // keep the terminal open after the sensor was unplugged. They do not inherit
        // a copy (F_DUPFD_CLOEXEC) and a terminal opened with CLOEXEC.
        let (master, slave) = TTYPort::pair()?;
        let master = SerialStream::try_from(master.try_clone_native()?)?;
        let path = PathBuf::from(slave.name().ok_or(io::ErrorKind::Unsupported)?);
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = rustix::fs::open(&path, flags, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        settings.set_speed(19_200)?;
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        let symlink = symlink.map(|at| Symlink::create(&path, at)).transpose()?;
        Ok(Self { master, slave, path, _symlink: symlink })
    }
}

/// Symbolic link that is removed when it is dropped.
#[derive(Debug)]
struct Symlink {
    at: PathBuf,
    target: PathBuf,
}

impl Symlink {
    fn create(target: &Path, at: &Path) -> io::Result<Self> {
        match std::fs::symlink_metadata(at) {
            Ok(there) if there.is_symlink() => std::fs::remove_file(at)?,
            Ok(_) => {
                let why = format!(
                    "{} exists and is not a symbolic link: remove it, or choose another path",
                    at.display()
                );
                return Err(io::Error::new(io::ErrorKind::AlreadyExists, why));
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        std::os::unix::fs::symlink(target, at)?;
        Ok(Self { at: at.to_owned(), target: target.to_owned() })
    }
}

impl Drop for Symlink {
    fn drop(&mut self) {
        // Another program may have replaced it since.
        if std::fs::read_link(&self.at).is_ok_and(|target| target == self.target) {
            let _ = std::fs::remove_file(&self.at);
        }
    }
}
