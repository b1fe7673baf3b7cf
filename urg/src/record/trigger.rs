//! [`trigger`]: waits for the signal or line that makes `--before` write.

use std::future::pending;

use tokio::io::{AsyncBufReadExt, BufReader};

/// Waits for a line of standard input, or for a SIGUSR1 since this call.
pub(super) fn trigger() -> impl Future<Output = ()> {
    let signal = signal();
    async {
        tokio::select! {
            () = line() => {}
            () = signal => {}
        }
    }
}

/// Waits for Enter, or for a line from a program. Waits forever if standard input has ended.
async fn line() {
    let mut line = Vec::new();
    // Neither an error nor the end of the file alone is a line.
    if !matches!(BufReader::new(tokio::io::stdin()).read_until(b'\n', &mut line).await, Ok(1..)) {
        pending().await
    }
}

#[cfg(unix)]
fn signal() -> impl Future<Output = ()> {
    use tokio::signal::unix::{SignalKind, signal};
    let signal = signal(SignalKind::user_defined1());
    async {
        match signal {
            Ok(mut signal) => drop(signal.recv().await),
            Err(_) => pending().await,
        }
    }
}

#[cfg(not(unix))]
fn signal() -> impl Future<Output = ()> {
    pending()
}
