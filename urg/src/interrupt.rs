//! Clean shutdown on Ctrl-C (Windows: Ctrl-Break, too), signals, or a closed terminal.

use std::io;
use std::time::Duration;
use tokio::time::Instant;

#[cfg(unix)]
use futures_util::future::select_all;
use tokio::sync::watch;

use crate::failure::Failure;
use crate::wait::wait_for_value;

/// Time that an interrupted command has to finish.
pub(crate) const COMMAND_GRACE: Duration = Duration::from_secs(1);

/// How a command ended.
type Outcome = Result<(), Failure>;

#[derive(Debug, Clone)]
pub(crate) struct Interrupt {
    since: watch::Receiver<Option<Instant>>,
}

impl Interrupt {
    /// Starts to listen for signals, without SIGUSR1 if that is a trigger. Needs a tokio runtime.
    pub(crate) fn listen(has_trigger: bool) -> io::Result<Self> {
        let (sender, since) = watch::channel(None);
        let signalled = signalled(has_trigger)?;
        #[cfg(unix)]
        report_file_size_limit()?;
        tokio::spawn(async move {
            signalled.await;
            sender.send_replace(Some(Instant::now()));
            sender.closed().await;
        });
        Ok(Self { since })
    }

    pub(crate) async fn requested(&self) -> Instant {
        wait_for_value(self.since.clone()).await
    }

    /// Waits until an interrupted command has used up its time to finish.
    pub(crate) async fn overdue(&self) {
        tokio::time::sleep_until(self.requested().await + COMMAND_GRACE).await;
    }

    /// Waits for `work`, and drops it if it has not finished a second after an interrupt.
    pub(crate) async fn limit(&self, work: impl Future<Output = Outcome>) -> Outcome {
        tokio::select! {
            done = work => done,
            () = self.overdue() => Err(Failure::Interrupted),
        }
    }

    /// Waits for `work`, and drops it on an interrupt.
    pub(crate) async fn unless<T>(
        &self,
        work: impl Future<Output = Result<T, Failure>>,
    ) -> Result<T, Failure> {
        tokio::select! {
            done = work => done,
            _ = self.requested() => Err(Failure::Interrupted),
        }
    }

    /// Does the same, but says that the work is not done.
    pub(crate) async fn or_fail(&self, work: impl Future<Output = Outcome>) -> Outcome {
        self.unless(work).await.map_err(|failure| match failure {
            Failure::Interrupted => Failure::Failed("interrupted before it was done".into()),
            failure => failure,
        })
    }
}

/// Starts to listen for signals. The future completes at the first signal since this call, not
/// since its first `poll`.
#[cfg(unix)]
fn signalled(has_trigger: bool) -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let kinds = [
        SignalKind::interrupt(),
        SignalKind::terminate(),
        SignalKind::quit(),
        SignalKind::alarm(),
        SignalKind::user_defined1(),
        SignalKind::user_defined2(),
        SignalKind::hangup(),
    ];
    let wanted = kinds.into_iter().filter(|kind| match *kind {
        kind if kind == SignalKind::hangup() => !ignores_hangup(),
        kind if kind == SignalKind::user_defined1() => !has_trigger,
        _ => true,
    });
    let mut signals = wanted.map(signal).collect::<io::Result<Vec<_>>>()?;
    Ok(async move {
        select_all(signals.iter_mut().map(|signal| Box::pin(signal.recv()))).await;
    })
}

/// Checks whether `nohup` or a similar parent set SIGHUP to be ignored. Linux only.
#[cfg(unix)]
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    // SIGHUP is signal 1, in the lowest bit.
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0) & 1 == 1
}

/// Turns SIGXFSZ (`ulimit -f`) into an ordinary write error. Without a handler, the signal
/// kills the program silently. tokio never removes its handler, so the result can be dropped.
#[cfg(unix)]
fn report_file_size_limit() -> io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let exceeded = rustix::process::Signal::XFSZ.as_raw();
    signal(SignalKind::from_raw(exceeded)).map(drop)
}

/// Starts to listen for console events. Ctrl-Break is the event that one program can send to another.
/// After its console closes, or during shutdown, Windows kills the program within five seconds.
#[cfg(windows)]
fn signalled(_has_trigger: bool) -> io::Result<impl Future<Output = ()>> {
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
