//! Ctrl-C, SIGTERM, Ctrl-Break on Windows, and a terminal that is closed: each ends the
//! program in good order.

#[cfg(unix)]
use std::future::poll_fn;
use std::io;
#[cfg(unix)]
use std::task::Poll;
use std::time::Duration;
use tokio::time::Instant;

use tokio::sync::watch;

use crate::failure::Failure;

/// A command that was interrupted ends by itself within this time.
const COMMAND_GRACE: Duration = Duration::from_secs(1);

/// The user's wish to stop the program.
#[derive(Debug, Clone)]
pub(crate) struct Interrupt {
    since: watch::Receiver<Option<Instant>>,
}

impl Interrupt {
    /// Listens from now on, on the current runtime. Fails if the system allows
    /// no signal handler.
    pub(crate) fn listen() -> io::Result<Self> {
        let (sender, since) = watch::channel(None);
        let signalled = signalled()?;
        #[cfg(unix)]
        report_file_size_limit()?;
        tokio::spawn(async move {
            signalled.await;
            sender.send_replace(Some(Instant::now()));
            // A receiver would take a sender that is gone for a signal.
            sender.closed().await;
        });
        Ok(Self { since })
    }

    /// Waits for the interrupt, and returns the time when it came.
    pub(crate) async fn requested(&self) -> Instant {
        let mut since = self.since.clone();
        // A guard held over an await would bind the future to one thread.
        let came = match since.wait_for(Option::is_some).await {
            Ok(since) => *since,
            Err(_) => None,
        };
        match came {
            Some(since) => since,
            None => std::future::pending().await,
        }
    }

    /// Waits until the program should have ended because of the interrupt.
    pub(crate) async fn overdue(&self) {
        let deadline = self.requested().await + COMMAND_GRACE;
        tokio::time::sleep_until(deadline).await;
    }

    /// Runs a command that may be dropped anywhere, until it is done or
    /// interrupted.
    pub(crate) async fn or(
        &self,
        command: impl Future<Output = Result<(), Failure>>,
    ) -> Result<(), Failure> {
        tokio::select! {
            outcome = command => outcome,
            _ = self.requested() => Ok(()),
        }
    }
}

/// Returns a future that ends with the first signal since this call, not since
/// its first poll.
#[cfg(unix)]
fn signalled() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
    let wanted =
        kinds.into_iter().filter(|kind| *kind != SignalKind::hangup() || !ignores_hangup());
    let mut signals = wanted.map(signal).collect::<io::Result<Vec<_>>>()?;
    Ok(poll_fn(move |cx| {
        let mut came = signals.iter_mut().map(|signal| signal.poll_recv(cx));
        if came.any(|came| came.is_ready()) { Poll::Ready(()) } else { Poll::Pending }
    }))
}

/// Returns whether the program was started to outlive its terminal, as by
/// `nohup`: with SIGHUP ignored. Known on Linux only.
#[cfg(unix)]
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    // SIGHUP is number 1: the lowest bit.
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0) & 1 == 1
}

/// Has a write beyond the limit on the size of files (`ulimit -f`) fail. Without a
/// handler the signal ends the program without a word, and tokio's is never removed.
#[cfg(unix)]
fn report_file_size_limit() -> io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let exceeded = rustix::process::Signal::XFSZ.as_raw();
    signal(SignalKind::from_raw(exceeded)).map(drop)
}

/// Returns a future that ends with the first event since this call. Ctrl-Break is what
/// one program can send to another. After a closed console, or when it shuts down, the
/// system ends the program after five seconds.
#[cfg(windows)]
fn signalled() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::windows::{ctrl_break, ctrl_c, ctrl_close, ctrl_shutdown};
    let (mut ctrl_c, mut ctrl_break) = (ctrl_c()?, ctrl_break()?);
    let (mut closed, mut shutdown) = (ctrl_close()?, ctrl_shutdown()?);
    Ok(async move {
        tokio::select! {
            _ = ctrl_c.recv() => {}
            _ = ctrl_break.recv() => {}
            _ = closed.recv() => {}
            _ = shutdown.recv() => {}
        }
    })
}
