//! [`Player`]: the task that plays a recording, for any number of viewers.

use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tokio_scip::Scan;

use super::command::PlaybackCommand;
use super::deck::{Deck, PlaybackStatus};
use super::settings::PlaybackArgs;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::recording::recorded::Recorded;
use crate::recording::reel::Reel;

/// The position is reported at least so often, also in a gap of the recording.
const REPORT_INTERVAL: Duration = Duration::from_millis(250);
/// Reading the file may take so long before a notice reports it.
const SILENT_WAIT: Duration = Duration::from_secs(1);

/// A recording that is played. All clones are one playback: the task ends with the
/// last of them.
#[derive(Debug, Clone)]
pub(crate) struct Player {
    commands: mpsc::UnboundedSender<PlaybackCommand>,
    shown: watch::Receiver<Shown>,
}

/// The scan that a playback shows, and its place.
#[derive(Debug, Clone)]
pub(crate) struct Shown {
    pub(crate) scan: Scan,
    pub(crate) status: PlaybackStatus,
}

impl Player {
    /// Reads the recording and begins to play it.
    pub(crate) async fn start(
        recorded: &Recorded,
        settings: PlaybackArgs,
    ) -> Result<Self, Failure> {
        let mut opened = {
            let recorded = recorded.clone();
            tokio::task::spawn_blocking(move || {
                let mut reel = Reel::open(recorded)?;
                let first = reel.scan(0)?;
                Ok((reel, first))
            })
        };
        let opened = tokio::select! {
            opened = &mut opened => opened,
            () = tokio::time::sleep(SILENT_WAIT) => {
                notice(format_args!("reading {recorded}, Ctrl-C ends it"));
                opened.await
            }
        };
        let (reel, first): (Reel, Scan) =
            opened.map_err(|error| Failure::of(&recorded.to_string(), &error))??;
        let speed = settings.speed.unwrap_or(1.0);
        let deck = Deck::new(reel.times(), speed, settings.is_looping, Instant::now());
        let shown = Shown { scan: first, status: deck.status() };
        let (sender, shown) = watch::channel(shown);
        let (commands, receiver) = mpsc::unbounded_channel();
        tokio::spawn(run(deck, reel, receiver, sender));
        Ok(Self { commands, shown })
    }

    /// Asks for a change. It is in [`shown`](Self::shown) soon.
    pub(crate) fn send(&self, command: PlaybackCommand) {
        // It fails at the end of the program only.
        let _ = self.commands.send(command);
    }

    /// Returns a watch of what is shown.
    pub(crate) fn shown(&self) -> watch::Receiver<Shown> {
        self.shown.clone()
    }

    pub(crate) fn status(&self) -> PlaybackStatus {
        self.shown.borrow().status
    }
}

/// Plays until nobody is left to look or to command.
async fn run(
    mut deck: Deck,
    mut reel: Reel,
    mut commands: mpsc::UnboundedReceiver<PlaybackCommand>,
    shown: watch::Sender<Shown>,
) {
    loop {
        let due = deck.due().map(|due| due.min(Instant::now() + REPORT_INTERVAL));
        let next = async {
            match due {
                Some(due) => tokio::time::sleep_until(due).await,
                None => std::future::pending().await,
            }
        };
        let command = tokio::select! {
            command = commands.recv() => match command {
                Some(command) => Some(command),
                None => return,
            },
            () = next => None,
        };
        let now = Instant::now();
        match command {
            Some(command) => deck.apply(command, now),
            None => deck.advance(now),
        }
        // A slider sends many: only the last one counts.
        while let Ok(command) = commands.try_recv() {
            deck.apply(command, now);
        }
        let status = deck.status();
        if status.scan == shown.borrow().status.scan {
            shown.send_modify(|shown| shown.status = status);
            continue;
        }
        let read = tokio::task::spawn_blocking(move || {
            let scan = reel.scan(status.scan);
            (reel, scan)
        });
        // It panics or is cancelled at the end of the program only.
        let Ok((returned, scan)) = read.await else { return };
        reel = returned;
        match scan {
            Ok(scan) => {
                shown.send_replace(Shown { scan, status });
            }
            Err(failure) => {
                // The file has changed since it was opened.
                notice(failure.line());
                return;
            }
        }
    }
}
