//! Standard output: data, and nothing else.

use std::io;

use tokio::io::{AsyncWriteExt, Stdout};

use crate::failure::Failure;

/// Standard output, written on a thread of its own: a reader that is slow
/// does not keep the driver from the line.
#[derive(Debug)]
pub(crate) struct Output {
    stdout: Stdout,
}

impl Output {
    pub(crate) fn new() -> Self {
        Self { stdout: tokio::io::stdout() }
    }

    /// Writes `text`, and waits until the reader has it.
    pub(crate) async fn write(&mut self, text: &str) -> Result<(), Failure> {
        let written = async {
            self.stdout.write_all(text.as_bytes()).await?;
            // Without it an error would show with the next write only.
            self.stdout.flush().await
        };
        written.await.map_err(|error| match error.kind() {
            io::ErrorKind::BrokenPipe => Failure::PipeClosed,
            _ => Failure::of("cannot write to standard output", &error),
        })
    }
}

/// Writes what a command has to say, in one piece.
pub(crate) async fn print(text: &str) -> Result<(), Failure> {
    Output::new().write(text).await
}
