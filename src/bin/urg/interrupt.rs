//! Ctrl-C and SIGTERM: they end the program in good order.

use std::io;
use std::time::{Duration, Instant};

use tokio::sync::watch;

/// How long a command may take to end in good order.
const GRACE: Duration = Duration::from_secs(1);

/// Tells whether the user wants the program to stop.
#[derive(Debug, Clone)]
pub(crate) struct Interrupt {
    since: watch::Receiver<Option<Instant>>,
}

impl Interrupt {
    /// Listens from now on, on the current runtime.
    ///
    /// # Errors
    ///
    /// The system's.
    pub(crate) fn listen() -> io::Result<Self> {
        let (sender, since) = watch::channel(None);
        let signalled = signalled()?;
        tokio::spawn(async move {
            signalled.await;
            sender.send_replace(Some(Instant::now()));
            // The receivers must not take a sender that is gone for a signal.
            sender.closed().await;
        });
        Ok(Self { since })
    }

    /// Waits for it, and tells when it came.
    pub(crate) async fn requested(&self) -> Instant {
        let mut since = self.since.clone();
        match since.wait_for(Option::is_some).await.as_deref() {
            Ok(Some(since)) => *since,
            _ => std::future::pending().await,
        }
    }

    /// Waits until the program should have ended because of it.
    pub(crate) async fn overdue(&self) {
        let deadline = self.requested().await + GRACE;
        tokio::time::sleep_until(deadline.into()).await;
    }
}

/// Signals count from this call on, not only once the future is polled.
#[cfg(unix)]
fn signalled() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

#[cfg(windows)]
fn signalled() -> io::Result<impl Future<Output = ()>> {
    let mut ctrl_c = tokio::signal::windows::ctrl_c()?;
    Ok(async move {
        ctrl_c.recv().await;
    })
}
