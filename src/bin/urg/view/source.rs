//! The sources of the radar's scans: sensors, or the playback of a recording.

use std::future::poll_fn;
use std::task::Poll;

use tokio::sync::watch;
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, State, Version, Window};

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
    pub(super) port: PortName,
    pub(super) sensor: Sensor,
    /// `None` until the sensor is open, and again when it has ended.
    pub(super) scans: Option<ScanStream>,
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
    async fn next(&mut self) -> Arrival {
        match self {
            Self::Sensor(live) => {
                let Some(scans) = &mut live.scans else { return std::future::pending().await };
                match scans.next().await {
                    Some(Ok(scan)) => Arrival::Scan(scan),
                    Some(Err(error)) => Arrival::Trouble(error),
                    None => {
                        live.scans = None;
                        Arrival::End
                    }
                }
            }
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

/// Waits for the next scan or change of any source, and returns it with the number
/// of its source. Cancel-safe.
pub(super) async fn next_of_any(sources: &mut [Source]) -> (usize, Arrival) {
    first_of(sources.iter_mut().map(Source::next)).await
}

/// Waits for a change of any sensor's state. Cancel-safe.
pub(super) async fn change_of_any(states: &mut [watch::Receiver<State>]) {
    first_of(states.iter_mut().map(async |state| {
        // A driver that has ended changes no more.
        if state.changed().await.is_err() {
            std::future::pending().await
        }
    }))
    .await;
}

/// Waits for the first future that is ready, and returns its number and its output.
async fn first_of<F: Future>(futures: impl Iterator<Item = F>) -> (usize, F::Output) {
    let mut futures: Vec<_> = futures.map(Box::pin).collect();
    poll_fn(|cx| {
        for (number, future) in futures.iter_mut().enumerate() {
            if let Poll::Ready(output) = future.as_mut().poll(cx) {
                return Poll::Ready((number, output));
            }
        }
        Poll::Pending
    })
    .await
}

/// Waits until a sensor is open, and begins to poll it.
pub(super) async fn start(
    sensor: Sensor,
    window: Window,
    rate: Rate,
) -> Result<(Version, ScanStream), Error> {
    sensor.opened().await?;
    let version = sensor.version().await?;
    Ok((version, sensor.scans(window, rate).await?))
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
