//! [`Player`]: the task that plays a recording, for any number of viewers.

use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tokio_scip::{Scan, Version};

use super::command::PlaybackCommand;
use super::deck::{Deck, PlaybackStatus};
use super::settings::PlaybackArgs;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::recording::recorded::Recorded;
use crate::recording::reel::Reel;
use crate::wait::wait_for_value;

/// Longest time between two updates of the position, even in a gap of the recording.
const REPORT_INTERVAL: Duration = Duration::from_millis(250);
/// Delay before a notice says that the file is being read.
const SILENT_WAIT: Duration = Duration::from_secs(1);

/// Handle to a playback. Clones share one task, which stops when you drop the last clone.
#[derive(Debug, Clone)]
pub(crate) struct Player {
    commands: mpsc::UnboundedSender<PlaybackCommand>,
    shown: watch::Receiver<Shown>,
    /// Reason why the playback failed; `None` while it runs.
    failure: watch::Receiver<Option<Failure>>,
    /// What the recording has of the sensor's version.
    version: Version,
}

#[derive(Debug, Clone)]
pub(crate) struct Shown {
    pub(crate) scan: Scan,
    pub(crate) status: PlaybackStatus,
}

impl Player {
    pub(crate) async fn start(recorded: &Recorded, args: PlaybackArgs) -> Result<Self, Failure> {
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
            opened.map_err(|error| Failure::new(recorded, &error))??;
        let speed = args.speed.unwrap_or(1.0);
        let deck = Deck::new(reel.times(), speed, args.is_looping, Instant::now());
        let shown = Shown { scan: first, status: deck.status() };
        let (sender, shown) = watch::channel(shown);
        let (commands, receiver) = mpsc::unbounded_channel();
        let (failed, failure) = watch::channel(None);
        let version = reel.version().clone();
        let running = tokio::spawn(run(deck, reel, receiver, sender));
        let name = recorded.to_string();
        tokio::spawn(async move {
            // A panic is a failure, too: without it, the playback would seem to run.
            let outcome = running.await.unwrap_or_else(|panic| Err(Failure::new(&name, &panic)));
            failed.send_replace(outcome.err());
        });
        Ok(Self { commands, shown, failure, version })
    }

    /// Sends a command. Its effect appears in [`shown`](Self::shown).
    pub(crate) fn send(&self, command: PlaybackCommand) {
        // A playback that has stopped ignores commands.
        let _ = self.commands.send(command);
    }

    /// Watch of the current scan and its position.
    pub(crate) fn shown(&self) -> watch::Receiver<Shown> {
        self.shown.clone()
    }

    pub(crate) fn failure(&self) -> Option<Failure> {
        self.failure.borrow().clone()
    }

    /// Waits until the playback fails, and returns the reason.
    pub(crate) async fn failed(&self) -> Failure {
        wait_for_value(self.failure.clone()).await
    }

    pub(crate) fn version(&self) -> &Version {
        &self.version
    }

    pub(crate) fn status(&self) -> PlaybackStatus {
        self.shown.borrow().status
    }
}

/// Plays until the last handle is dropped. Fails if the file can no longer be read, because
/// it has changed since it was opened.
async fn run(
    mut deck: Deck,
    mut reel: Reel,
    mut commands: mpsc::UnboundedReceiver<PlaybackCommand>,
    shown: watch::Sender<Shown>,
) -> Result<(), Failure> {
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
                None => return Ok(()),
            },
            () = next => None,
        };
        let now = Instant::now();
        match command {
            Some(command) => deck.apply(command, now),
            None => deck.advance(now),
        }
        // A slider sends many commands at once. Only the last one needs its scan read.
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
        let (returned, scan) =
            read.await.map_err(|error| Failure::new("reading the recording", &error))?;
        reel = returned;
        shown.send_replace(Shown { scan: scan?, status });
    }
}
