//! A pseudo-terminal with a sensor at its other end that answers at once, on a thread or
//! in a process of its own.

#![allow(dead_code, reason = "each benchmark uses a part of it")]

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::PathBuf;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// Both ends of a pseudo-terminal in raw mode.
pub(crate) struct Terminal {
    /// The sensor's end.
    pub(crate) master: File,
    /// Kept open, so that the terminal outlives its clients.
    pub(crate) slave: File,
    pub(crate) path: PathBuf,
}

impl Terminal {
    pub(crate) fn open() -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)
            .expect("a pseudo-terminal");
        grantpt(&master).expect("the right to open it");
        unlockpt(&master).expect("an unlocked terminal");
        let name = ptsname(&master, Vec::new()).expect("a name");
        let path = PathBuf::from(name.to_str().expect("a plain name"));
        let slave = open(&path);
        let mut settings = tcgetattr(&slave).expect("settings");
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings).expect("raw mode");
        Self { master: File::from(master), slave, path }
    }
}

/// Opens a terminal as a plain blocking file.
pub(crate) fn open(path: &std::path::Path) -> File {
    OpenOptions::new().read(true).write(true).open(path).expect("the terminal")
}

/// Reads the next command, without its terminator. Returns `None` at the end.
pub(crate) fn read_command(master: &mut File, command: &mut Vec<u8>) -> Option<()> {
    command.clear();
    let mut buffer = [0; 64];
    loop {
        let count = master.read(&mut buffer).ok().filter(|count| *count > 0)?;
        command.extend_from_slice(&buffer[..count]);
        if command.ends_with(b"\n") {
            command.pop();
            // The driver sends an LF first, which ends a command of an earlier program.
            let start = command.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
            command.drain(..start);
            return Some(());
        }
    }
}

/// Answers commands until the terminal is closed, each reply in one piece.
pub(crate) fn serve(mut master: File) {
    let (mut command, mut reply) = (Vec::new(), Vec::new());
    while read_command(&mut master, &mut command).is_some() {
        reply.clear();
        crate::instant_sensor::reply(&command, &mut reply);
        if master.write_all(&reply).is_err() {
            return;
        }
    }
}
