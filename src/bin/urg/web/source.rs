//! A source of scans: a sensor or the playback of a recording, with its name and
//! its place. No source knows of another one.

use std::sync::Arc;

use futures_util::StreamExt;
use futures_util::stream::{self, BoxStream};
use serde::Serialize;
use tokio::sync::watch;
use tokio_scip::{Version, Window};

use super::hub::{Health, Hub};
use super::line::{NewestLine, ViewerLine};
use crate::failure::Failure;
use crate::format::json;
use crate::playback::{PlaybackArgs, PlaybackStatus, Player, Shown, seen_through};
use crate::plot::pose::Pose;
use crate::port::name::PortName;
use crate::recording::recorded::Recorded;
use crate::stream::feed::{NamedLine, Update};

/// A source of scans.
#[derive(Debug)]
pub(crate) struct Source {
    pub(super) name: Option<Arc<str>>,
    pub(super) pose: Pose,
    pub(super) kind: SourceKind,
    newest: Arc<NewestLine>,
}

#[derive(Debug)]
pub(super) enum SourceKind {
    Sensor(Arc<Hub>),
    Recording(Box<Playback>),
}

/// A recording that is played, for everybody.
#[derive(Debug)]
pub(super) struct Playback {
    pub(super) port: PortName,
    pub(super) window: Window,
    pub(super) version: Version,
    pub(super) player: Player,
}

/// The form of an event of a playback.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename = "playback")]
struct PlaybackEvent {
    playback: PlaybackStatus,
}

impl Source {
    pub(crate) fn of_sensor(name: Option<&str>, pose: Pose, hub: Arc<Hub>) -> Self {
        Self::new(name, pose, SourceKind::Sensor(hub))
    }

    /// Begins to play a recording.
    pub(crate) async fn of_recording(
        name: Option<&str>,
        pose: Pose,
        port: &PortName,
        recorded: &Recorded,
        window: Window,
        settings: PlaybackArgs,
    ) -> Result<Self, Failure> {
        let version = recorded.version().await?;
        let player = Player::start(recorded, settings).await?;
        let playback = Playback { port: port.clone(), window, version, player };
        Ok(Self::new(name, pose, SourceKind::Recording(Box::new(playback))))
    }

    fn new(name: Option<&str>, pose: Pose, kind: SourceKind) -> Self {
        Self { name: name.map(Arc::from), pose, kind, newest: Arc::default() }
    }

    /// Returns the sensor, unless it is a recording.
    pub(crate) fn hub(&self) -> Option<&Arc<Hub>> {
        match &self.kind {
            SourceKind::Sensor(hub) => Some(hub),
            SourceKind::Recording(_) => None,
        }
    }

    pub(super) fn port(&self) -> &PortName {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.port(),
            SourceKind::Recording(playback) => &playback.port,
        }
    }

    pub(super) fn window(&self) -> Window {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.window(),
            SourceKind::Recording(playback) => playback.window,
        }
    }

    pub(super) fn health(&self) -> Health {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.health(),
            SourceKind::Recording(_) => Health { link: "recording", why: None },
        }
    }

    /// Returns the lines for a viewer from now on.
    pub(super) fn lines(&self) -> BoxStream<'static, Result<ViewerLine, Failure>> {
        let (name, newest) = (self.name.clone(), Arc::clone(&self.newest));
        match &self.kind {
            SourceKind::Sensor(hub) => {
                let hub = Arc::clone(hub);
                stream::unfold(None, move |feed| {
                    let (hub, name, newest) = (Arc::clone(&hub), name.clone(), Arc::clone(&newest));
                    async move {
                        let mut feed = match feed {
                            Some(feed) => feed,
                            None => hub.feed().await?,
                        };
                        let update = feed.next().await?;
                        let ndjson = || update.line(name.as_deref());
                        let line = match &update {
                            Update::Scan(scan) => newest.of(scan.sequence(), ndjson),
                            _ => ndjson().map(|ndjson| ViewerLine::new(&ndjson, false)),
                        };
                        Some((line, Some(feed)))
                    }
                })
                .boxed()
            }
            SourceKind::Recording(playback) => {
                let (shown, window) = (playback.player.shown(), playback.window);
                let lines =
                    PlaybackLines { shown, window, name, newest, scan: None, settings: None };
                stream::unfold(lines, async |mut lines| Some((lines.next().await?, lines))).boxed()
            }
        }
    }
}

/// The lines of a playback: each scan that is shown, and each change of pause, speed
/// and loop.
struct PlaybackLines {
    shown: watch::Receiver<Shown>,
    window: Window,
    name: Option<Arc<str>>,
    newest: Arc<NewestLine>,
    /// The scan and the settings that the viewer has.
    scan: Option<usize>,
    settings: Option<(bool, bool, u64, bool)>,
}

impl PlaybackLines {
    async fn next(&mut self) -> Option<Result<ViewerLine, Failure>> {
        loop {
            let Shown { scan, status } = self.shown.borrow_and_update().clone();
            let speed = status.speed.to_bits();
            let settings = (status.paused, status.ended, speed, status.is_looping);
            if self.settings.replace(settings) != Some(settings) {
                return Some(event(self.name.as_deref(), status));
            }
            if self.scan.replace(status.scan) != Some(status.scan) {
                let (sensor, position) = (self.name.as_deref(), Some(status.position));
                return Some(self.newest.of(status.scan as u64, || {
                    let data = seen_through(&scan, self.window);
                    json::line(&NamedLine { sensor, position, data })
                }));
            }
            self.shown.changed().await.ok()?;
        }
    }
}

fn event(sensor: Option<&str>, playback: PlaybackStatus) -> Result<ViewerLine, Failure> {
    let line = NamedLine { sensor, position: None, data: PlaybackEvent { playback } };
    json::line(&line).map(|ndjson| ViewerLine::new(&ndjson, false))
}
