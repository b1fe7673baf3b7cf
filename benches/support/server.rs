//! [`Server`]: a sensor in another process, so that its CPU time and wake-ups are not
//! counted as the driver's.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

/// A sensor in another process: this program, started with the arguments `serve NAME`.
/// Dropping it ends the process.
pub(crate) struct Server {
    process: Child,
    /// Path of its pseudo-terminal, which the process prints.
    pub(crate) path: PathBuf,
}

impl Server {
    pub(crate) fn start(name: &str) -> Self {
        let mut process = Command::new(std::env::current_exe().unwrap())
            .args(["serve", name])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { process, path: line.trim().into() }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }
}
