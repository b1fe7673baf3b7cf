//! The terminal while the radar is on it: taken over, drawn to without blocking
//! the driver, and restored, however the program ends.

use std::cell::RefCell;
use std::io::{self, IsTerminal, Write};
use std::rc::Rc;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossterm::cursor::{Hide, Show};
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

/// The last frame may take so long; a terminal that is stopped is not waited for.
const LAST_FRAME_GRACE: Duration = Duration::from_secs(1);

/// Set while the terminal has to be restored, for the panic hook.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The terminal, taken over.
///
/// Frames are written by a task of their own: a terminal that is slow, as over
/// ssh, gets fewer of them and the driver never waits for it.
pub(crate) struct Screen {
    terminal: Terminal<CrosstermBackend<FrameBuffer>>,
    bytes: FrameBuffer,
    frames: mpsc::Sender<Vec<u8>>,
    writer: JoinHandle<()>,
    taken: Taken,
}

impl Screen {
    /// Fails with advice if standard output is no terminal.
    pub(crate) fn require_terminal() -> Result<(), Failure> {
        if !io::stdout().is_terminal() {
            let text = "standard output is not a terminal, which view needs: \
                        `urg stream` writes scans, `urg scan --format svg` a picture";
            return Err(Failure::Usage(text.to_owned()));
        }
        Ok(())
    }

    /// Takes the terminal over, on the current runtime.
    pub(crate) fn take() -> Result<Self, Failure> {
        Self::take_over().map_err(cannot_draw)
    }

    fn take_over() -> io::Result<Self> {
        let taken = Taken::now()?;
        let bytes = FrameBuffer::default();
        let terminal = Terminal::new(CrosstermBackend::new(bytes.clone()))?;
        let (frames, receiver) = mpsc::channel(1);
        let writer = tokio::spawn(write(receiver));
        Ok(Self { terminal, bytes, frames, writer, taken })
    }

    /// Waits until the terminal takes another frame; an error when it never
    /// will. Cancel-safe.
    pub(crate) async fn ready(&self) -> Result<(), Failure> {
        self.frames.reserve().await.map(drop).map_err(|_| Failure::PipeClosed)
    }

    /// Draws a frame, which is on its way when this returns. Who has waited for
    /// [`ready`](Self::ready) finds room for it.
    pub(crate) fn draw(&mut self, render: impl FnOnce(&mut Frame<'_>)) -> Result<(), Failure> {
        self.terminal.draw(render).map_err(cannot_draw)?;
        let frame = std::mem::take(&mut *self.bytes.0.borrow_mut());
        self.frames.try_send(frame).map_err(|_| Failure::PipeClosed)
    }

    /// Restores the terminal after the last frame.
    pub(crate) async fn restore(self) {
        let Self { frames, writer, taken, .. } = self;
        let mut last = Vec::new();
        // Writing to memory does not fail.
        let _ = execute!(last, LeaveAlternateScreen, Show);
        let written = async {
            let _ = frames.send(last).await;
            drop(frames);
            let _ = writer.await;
        };
        // A terminal that takes nothing now would not take more later.
        let _ = tokio::time::timeout(LAST_FRAME_GRACE, written).await;
        TAKEN.store(false, Ordering::SeqCst);
        let _ = disable_raw_mode();
        drop(taken);
    }
}

fn cannot_draw(error: io::Error) -> Failure {
    Failure::of("cannot draw on the terminal", &error)
}

/// Writes frames one after the other, until the terminal is gone.
async fn write(mut frames: mpsc::Receiver<Vec<u8>>) {
    let mut stdout = tokio::io::stdout();
    while let Some(frame) = frames.recv().await {
        let written = async {
            stdout.write_all(&frame).await?;
            stdout.flush().await
        };
        if written.await.is_err() {
            return;
        }
    }
}

/// The taken-over terminal. Drop restores it at once.
struct Taken;

impl Taken {
    fn now() -> io::Result<Self> {
        static HOOK: Once = Once::new();
        HOOK.call_once(|| {
            let report = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                // The radar would cover the message.
                restore_now();
                report(panic);
            }));
        });
        enable_raw_mode()?;
        TAKEN.store(true, Ordering::SeqCst);
        let taken = Self;
        execute!(io::stdout(), EnterAlternateScreen, Hide)?;
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
        // An error cannot be reported any more.
        let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
        let _ = disable_raw_mode();
    }
}

/// The bytes of a frame, on their way from ratatui to the writer.
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
