//! Sources of the radar's scans: sensors, or the playback of a recording.

use futures_util::future::select_all;
use tokio::sync::watch;
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, Version, Window};

use crate::playback::{PlaybackStatus, Player, Shown};
use crate::port::name::PortName;
use crate::stream::rate_watch::RateWatch;

pub(super) enum ViewSource {
    Sensor(Box<PolledSensor>),
    Playback(PlayedRecording),
}

pub(super) struct PolledSensor {
    pub(super) port: PortName,
    pub(super) sensor: Sensor,
    /// `None` before the sensor opens and after its stream ends.
    pub(super) scans: Option<ScanStream>,
    pub(super) pace: RateWatch,
}

pub(super) struct PlayedRecording {
    pub(super) player: Player,
    pub(super) shown: watch::Receiver<Shown>,
}

pub(super) enum Arrival {
    Scan(Scan),
    Trouble(Error),
    Moved(Scan, PlaybackStatus),
    End,
}

impl ViewSource {
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
            Self::Playback(playback) => tokio::select! {
                Ok(()) = playback.shown.changed() => {
                    let Shown { scan, status } = playback.shown.borrow_and_update().clone();
                    Arrival::Moved(scan, status)
                }
                _ = playback.player.failed() => Arrival::End,
            },
        }
    }
}

/// Waits for the next scan or change from any source. The number identifies the source. Cancel-safe.
pub(super) async fn next_of_any(sources: &mut [ViewSource]) -> (usize, Arrival) {
    let (arrival, number, _) =
        select_all(sources.iter_mut().map(|source| Box::pin(source.next()))).await;
    (number, arrival)
}

/// Waits until a sensor is open, then starts to poll it.
pub(super) async fn start(
    sensor: Sensor,
    window: Window,
    rate: Rate,
) -> Result<(Version, ScanStream), Error> {
    sensor.watch_state().connected().await?;
    let version = sensor.version().await?;
    Ok((version, sensor.scans(window, rate).await?))
}
