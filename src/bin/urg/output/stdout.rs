//! Standard output: data, and nothing else.

use std::io;

use tokio::io::{AsyncWriteExt, Stdout};

use crate::failure::Failure;

/// Standard output, written by a thread of its own: a slow reader does not keep
/// the driver from the port.
#[derive(Debug)]
pub(crate) struct Output {
    stdout: Stdout,
}

impl Output {
    pub(crate) fn new() -> Self {
        Self { stdout: tokio::io::stdout() }
    }

    /// Writes `text`, and waits until the system has taken it.
    pub(crate) async fn write(&mut self, text: &str) -> Result<(), Failure> {
        let written = async {
            self.stdout.write_all(text.as_bytes()).await?;
            // Without it an error would show only with the next write.
            self.stdout.flush().await
        };
        written.await.map_err(|error| failure(&error))
    }
}

/// Writes the whole output of a command at once.
pub(crate) async fn print(text: &str) -> Result<(), Failure> {
    Output::new().write(text).await
}

/// Maps an error of standard output to the way in which the program ends.
pub(crate) fn failure(error: &io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::PipeClosed,
        _ => Failure::of("cannot write to standard output", error),
    }
}
