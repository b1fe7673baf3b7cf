//! The source of the radar's scans: a sensor, or the playback of a recording.

use tokio::sync::watch;
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, Version, Window};

use crate::failure::Failure;
use crate::playback::{PlaybackArgs, PlaybackStatus, Player, Shown};
use crate::port::name::PortName;
use crate::recording::recorded::Recorded;
use crate::stream::rate_watch::RateWatch;

/// A source of scans.
pub(super) enum Source {
    Sensor(Box<Live>),
    Playback(Playback),
}

/// A sensor that is polled.
pub(super) struct Live {
    pub(super) sensor: Sensor,
    pub(super) scans: ScanStream,
    pub(super) pace: RateWatch,
}

/// A recording that is played.
pub(super) struct Playback {
    pub(super) player: Player,
    shown: watch::Receiver<Shown>,
}

/// A scan, an error or a change of a source.
pub(super) enum Arrival {
    Scan(Scan),
    Trouble(Error),
    Moved(Scan, PlaybackStatus),
    End,
}

impl Source {
    /// Waits for the next scan or change. Cancel-safe.
    pub(super) async fn next(&mut self) -> Arrival {
        match self {
            Self::Sensor(live) => match live.scans.next().await {
                Some(Ok(scan)) => Arrival::Scan(scan),
                Some(Err(error)) => Arrival::Trouble(error),
                None => Arrival::End,
            },
            Self::Playback(playback) => match playback.shown.changed().await {
                Ok(()) => {
                    let Shown { scan, status } = playback.shown.borrow_and_update().clone();
                    Arrival::Moved(scan, status)
                }
                Err(_) => Arrival::End,
            },
        }
    }
}

impl Live {
    /// Begins to poll.
    pub(super) async fn start(
        port: &PortName,
        sensor: Sensor,
        window: Window,
        rate: Rate,
    ) -> Result<Self, Failure> {
        let scans = sensor.scans(window, rate).await;
        let scans = scans.map_err(|error| Failure::at(&port.to_string(), &error))?;
        Ok(Self { pace: RateWatch::new(port, window, rate), sensor, scans })
    }
}

impl Playback {
    /// Begins to play. Returns the recorded sensor's version, too.
    pub(super) async fn start(
        recorded: &Recorded,
        settings: PlaybackArgs,
    ) -> Result<(Self, Version), Failure> {
        let player = Player::start(recorded, settings).await?;
        let version = recorded.version().await?;
        let mut shown = player.shown();
        // So that the first scan is an arrival.
        shown.mark_changed();
        Ok((Self { player, shown }, version))
    }
}
