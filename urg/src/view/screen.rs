//! Terminal access for the radar: takes over the terminal, draws without blocking the
//! driver, and restores the terminal however the program ends.

use std::cell::RefCell;
use std::io::{self, IsTerminal, Write};
use std::rc::Rc;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossterm::cursor::{Hide, Show};
use crossterm::event::{DisableBracketedPaste, EnableBracketedPaste};
use crossterm::execute;
use crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::backend::CrosstermBackend;
use ratatui::{Frame, Terminal};
use tokio::io::AsyncWriteExt;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use crate::failure::Failure;

/// Time limit for writing the last frame, because a stopped terminal never takes it.
const LAST_FRAME_GRACE: Duration = Duration::from_secs(1);

/// True while the terminal must be restored. The panic hook reads it.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// Terminal that shows the radar.
///
/// A separate task writes the frames. A slow terminal, such as one over ssh, gets fewer
/// frames, and the driver never waits for it.
pub(crate) struct Screen {
    terminal: Terminal<CrosstermBackend<FrameBuffer>>,
    bytes: FrameBuffer,
    frames: mpsc::Sender<Vec<u8>>,
    writer: JoinHandle<()>,
    taken: Taken,
}

impl Screen {
    /// Checks that standard output is a terminal.
    pub(crate) fn require_terminal() -> Result<(), Failure> {
        if !io::stdout().is_terminal() {
            let text = "standard output is not a terminal, which view needs: \
                        `urg stream` writes scans, `urg scan --format svg` a picture";
            return Err(Failure::Usage(text.to_owned()));
        }
        if cfg!(unix) && std::env::var_os("TERM").is_some_and(|term| term == "dumb") {
            let text = "this terminal cannot draw (TERM=dumb): `urg stream` writes lines";
            return Err(Failure::Usage(text.to_owned()));
        }
        Ok(())
    }

    /// Takes over the terminal. The current runtime runs the task that writes frames.
    pub(crate) fn take() -> Result<Self, Failure> {
        let taken = Taken::now().map_err(cannot_draw)?;
        let bytes = FrameBuffer::default();
        let terminal = Terminal::new(CrosstermBackend::new(bytes.clone())).map_err(cannot_draw)?;
        let (frames, receiver) = mpsc::channel(1);
        let writer = tokio::spawn(write(receiver));
        Ok(Self { terminal, bytes, frames, writer, taken })
    }

    /// Waits until the terminal accepts another frame. Fails once the terminal is gone. Cancel-safe.
    pub(crate) async fn ready(&self) -> Result<(), Failure> {
        self.frames.reserve().await.map(drop).map_err(|_| Failure::PipeClosed)
    }

    /// Draws a frame and hands it to the writing task. Wait for [`ready`](Self::ready)
    /// first: the task has room for one frame.
    pub(crate) fn draw(&mut self, render: impl FnOnce(&mut Frame<'_>)) -> Result<(), Failure> {
        self.terminal.draw(render).map_err(cannot_draw)?;
        let frame = std::mem::take(&mut *self.bytes.0.borrow_mut());
        self.frames.try_send(frame).map_err(|_| Failure::PipeClosed)
    }

    /// Restores the terminal and stops the program, as Ctrl-Z does, until the shell
    /// continues it. Then takes over the terminal again.
    pub(crate) async fn suspend(&mut self) -> Result<(), Failure> {
        let mut last = Vec::new();
        leave(&mut last);
        let _ = self.frames.send(last).await;
        // The task takes this frame only after it has written the one before.
        let _ = self.frames.send(Vec::new()).await;
        self.ready().await?;
        TAKEN.store(false, Ordering::SeqCst);
        let stopped = disable_raw_mode().and_then(|()| stop_program());
        enable_raw_mode().map_err(cannot_draw)?;
        TAKEN.store(true, Ordering::SeqCst);
        enter().map_err(cannot_draw)?;
        // A new `Terminal` redraws every cell of the next frame.
        let backend = CrosstermBackend::new(self.bytes.clone());
        self.terminal = Terminal::new(backend).map_err(cannot_draw)?;
        stopped.map_err(cannot_draw)
    }

    /// Restores the terminal after writing the last frame.
    pub(crate) async fn restore(self) {
        let Self { frames, writer, taken, .. } = self;
        let mut last = Vec::new();
        leave(&mut last);
        let written = async {
            let _ = frames.send(last).await;
            drop(frames);
            let _ = writer.await;
        };
        let _ = tokio::time::timeout(LAST_FRAME_GRACE, written).await;
        TAKEN.store(false, Ordering::SeqCst);
        let _ = disable_raw_mode();
        drop(taken);
    }
}

#[cfg(unix)]
fn stop_program() -> io::Result<()> {
    use rustix::process::{Signal, getpid, kill_process};
    Ok(kill_process(getpid(), Signal::STOP)?)
}

/// Does nothing: Windows cannot stop a program.
#[cfg(not(unix))]
fn stop_program() -> io::Result<()> {
    Ok(())
}

/// Requests from outside to stop (SIGTSTP). Without a handler, the program would stop and
/// leave the picture on the terminal.
pub(crate) struct StopRequests {
    #[cfg(unix)]
    signals: Option<tokio::signal::unix::Signal>,
}

impl StopRequests {
    #[cfg(unix)]
    pub(crate) fn listen() -> Self {
        let kind = rustix::process::Signal::TSTP.as_raw();
        let kind = tokio::signal::unix::SignalKind::from_raw(kind);
        // Without a handler, the system itself stops the program.
        Self { signals: tokio::signal::unix::signal(kind).ok() }
    }

    #[cfg(not(unix))]
    pub(crate) fn listen() -> Self {
        Self {}
    }

    pub(crate) async fn requested(&mut self) {
        #[cfg(unix)]
        if let Some(signals) = &mut self.signals
            && signals.recv().await.is_some()
        {
            return;
        }
        std::future::pending().await
    }
}

fn enter() -> io::Result<()> {
    // Pasted text arrives as one event, and not as keys. An old Windows console has no such mode.
    let _ = execute!(io::stdout(), EnableBracketedPaste);
    execute!(io::stdout(), EnterAlternateScreen, Hide)
}

/// Ignores errors: there is nowhere left to show them.
fn leave(out: &mut impl Write) {
    let _ = execute!(out, DisableBracketedPaste);
    let _ = execute!(out, LeaveAlternateScreen, Show);
}

fn cannot_draw(error: io::Error) -> Failure {
    Failure::new("cannot draw on the terminal", &error)
}

/// Writes frames until the terminal is gone.
async fn write(mut frames: mpsc::Receiver<Vec<u8>>) {
    let mut stdout = tokio::io::stdout();
    while let Some(frame) = frames.recv().await {
        if stdout.write_all(&frame).await.is_err() || stdout.flush().await.is_err() {
            return;
        }
    }
}

/// Guard that restores the terminal when dropped.
struct Taken;

impl Taken {
    fn now() -> io::Result<Self> {
        static HOOK: Once = Once::new();
        HOOK.call_once(|| {
            let report = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                // The radar would hide the panic message.
                restore_now();
                report(panic);
            }));
        });
        enable_raw_mode()?;
        TAKEN.store(true, Ordering::SeqCst);
        let taken = Self;
        enter()?;
        Ok(taken)
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        restore_now();
    }
}

fn restore_now() {
    if TAKEN.swap(false, Ordering::SeqCst) {
        leave(&mut io::stdout());
        let _ = disable_raw_mode();
    }
}

/// Bytes of a frame, which ratatui writes and the writing task takes.
#[derive(Clone, Default)]
struct FrameBuffer(Rc<RefCell<Vec<u8>>>);

impl Write for FrameBuffer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
