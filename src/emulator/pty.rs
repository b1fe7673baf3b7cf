//! The emulated sensor on a pseudo-terminal.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_serial::{SerialPort, SerialStream};

use super::Emulator;
use super::link::HostBaudRate;
use super::serve::pump;

/// A pseudo-terminal with an emulated sensor at the other end.
///
/// Programs open [`path`](Self::path) as they would a serial port. They may come
/// and go: the terminal stays, and with it what was not read. A sensor on RS-232
/// sees which baud rate the client has set, and both hear garbage where it is
/// another than the sensor's. Bytes take their time on the line.
///
/// It uses the wall clock in the end: do not mix it with tokio's paused clock.
///
/// Dropping it, or the future of [`serve`](Self::serve), hangs the client up and
/// removes the symbolic link.
///
/// On Linux a client that locks the terminal for itself (`TIOCEXCL`) and is
/// killed leaves that lock behind, and only root can then open the terminal
/// again; one that closes it leaves none.
#[derive(Debug)]
pub struct Pty {
    emulator: Emulator,
    symlink: Option<PathBuf>,
    terminal: Terminal,
}

impl Pty {
    /// Creates a pseudo-terminal for the sensor, in raw mode at 19,200 baud, and
    /// a symbolic link to it if a path is given. An old symbolic link there is
    /// replaced.
    ///
    /// # Errors
    ///
    /// [`AlreadyExists`](io::ErrorKind::AlreadyExists) if something that is no
    /// symbolic link is in the link's place, and those of the system.
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime with I/O enabled.
    pub fn open(emulator: &Emulator, symlink: Option<&Path>) -> io::Result<Self> {
        let terminal = Terminal::open(symlink)?;
        Ok(Self { emulator: emulator.clone(), symlink: symlink.map(Path::to_owned), terminal })
    }

    /// Where clients open the terminal: the symbolic link if there is one.
    pub fn path(&self) -> &Path {
        self.symlink.as_deref().unwrap_or(&self.terminal.path)
    }

    /// Serves the clients of the terminal until the future is dropped.
    ///
    /// When the sensor is unplugged, or a fault hangs up, the terminal goes away
    /// with its symbolic link. When the sensor is plugged in again a new one
    /// takes its place: without a symbolic link its path may be another.
    ///
    /// # Errors
    ///
    /// Those of the system.
    pub async fn serve(self) -> io::Result<()> {
        let Self { emulator, symlink, mut terminal } = self;
        loop {
            let Terminal { master, slave, path: _, _symlink } = terminal;
            let shared = Arc::new(slave);
            let slave = shared.clone();
            let speed = HostBaudRate::Probed(Box::new(move || slave.baud_rate().ok()));
            pump(master, emulator.open(speed)).await?;
            drop((shared, _symlink));
            emulator.wait_until_plugged_in().await;
            terminal = Terminal::open(symlink.as_deref())?;
        }
    }
}

#[derive(Debug)]
struct Terminal {
    master: SerialStream,
    /// Kept open so that the terminal survives its clients. It takes no lock,
    /// so that they can take theirs.
    slave: SerialStream,
    path: PathBuf,
    _symlink: Option<Symlink>,
}

impl Terminal {
    fn open(symlink: Option<&Path>) -> io::Result<Self> {
        let (master, mut slave) = SerialStream::pair()?;
        slave.set_baud_rate(19_200)?;
        let path = PathBuf::from(slave.name().ok_or(io::ErrorKind::Unsupported)?);
        let symlink = symlink.map(|at| Symlink::create(&path, at)).transpose()?;
        Ok(Self { master, slave, path, _symlink: symlink })
    }
}

/// A symbolic link that goes when it is dropped.
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
                let why = format!("{} is no symbolic link: it is not replaced", at.display());
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
        // Somebody else's link may be there by now.
        if std::fs::read_link(&self.at).is_ok_and(|target| target == self.target) {
            let _ = std::fs::remove_file(&self.at);
        }
    }
}
