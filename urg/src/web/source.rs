//! Sources of scans: sensors and playbacks of recordings, each with a name and a place.
//! Sources do not depend on each other.

use std::sync::Arc;

use serde::Serialize;
use tokio::sync::watch;
use tokio_scip::scan::Pose;
use tokio_scip::{Scan, Version, Window};

use super::hub::{Hub, SensorHealth};
use super::line::{NewestLine, ViewerLine};
use crate::failure::Failure;
use crate::format::json_line;
use crate::playback::{PlaybackArgs, PlaybackStatus, Player, Shown, seen_through};
use crate::port::name::PortName;
use crate::recording::recorded::Recorded;
use crate::stream::feed::{Feed, NamedLine, Update};

/// Source of scans, with its name and place.
#[derive(Debug)]
pub(crate) struct SiteSource {
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

/// Playback of a recording, shared by all viewers.
#[derive(Debug)]
pub(super) struct Playback {
    pub(super) port: PortName,
    pub(super) window: Window,
    pub(super) version: Version,
    pub(super) player: Player,
}

/// JSON of a playback event.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename = "playback")]
struct PlaybackEvent {
    playback: PlaybackStatus,
}

impl SiteSource {
    pub(crate) fn of_sensor(name: Option<&str>, pose: Pose, hub: Arc<Hub>) -> Self {
        Self::new(name, pose, SourceKind::Sensor(hub))
    }

    /// Opens a recording and starts to play it.
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

    pub(crate) fn hub(&self) -> Option<&Arc<Hub>> {
        match &self.kind {
            SourceKind::Sensor(hub) => Some(hub),
            SourceKind::Recording(_) => None,
        }
    }

    pub(crate) fn player(&self) -> Option<&Player> {
        match &self.kind {
            SourceKind::Sensor(_) => None,
            SourceKind::Recording(playback) => Some(&playback.player),
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

    pub(super) fn version(&self) -> Option<&Version> {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.version(),
            SourceKind::Recording(playback) => Some(&playback.version),
        }
    }

    pub(super) fn health(&self) -> SensorHealth {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.health(),
            SourceKind::Recording(playback) => match playback.player.failure() {
                None => SensorHealth { link: "recording", why: None },
                Some(failure) => SensorHealth { link: "closed", why: Some(failure.to_string()) },
            },
        }
    }

    /// Starts the lines for a new client. With `with_old`, the latest scan comes first,
    /// marked as old, if no scans arrive at the moment.
    pub(super) fn lines(&self, with_old: bool) -> Lines {
        let (name, newest) = (self.name.clone(), Arc::clone(&self.newest));
        match &self.kind {
            SourceKind::Sensor(hub) => {
                let hub = Arc::clone(hub);
                let old = hub.old_scan().filter(|_| with_old);
                Lines::Sensor(Box::new(SensorLines { hub, name, newest, old, feed: None }))
            }
            SourceKind::Recording(playback) => {
                let (shown, window) = (playback.player.shown(), playback.window);
                let lines =
                    PlaybackLines { shown, window, name, newest, scan: None, settings: None };
                Lines::Recording(lines)
            }
        }
    }
}

/// Lines of a source for one client.
pub(super) enum Lines {
    Sensor(Box<SensorLines>),
    Recording(PlaybackLines),
}

impl Lines {
    /// Waits for the next line. Returns `None` after the end. Cancel-safe.
    pub(super) async fn next(&mut self) -> Option<ViewerLine> {
        let line = match self {
            Self::Sensor(lines) => lines.next().await?,
            Self::Recording(lines) => lines.next().await?,
        };
        // Serializing a scan or an event is infallible.
        line.ok()
    }
}

/// Lines of a sensor: its scans and events.
pub(super) struct SensorLines {
    hub: Arc<Hub>,
    name: Option<Arc<str>>,
    newest: Arc<NewestLine>,
    /// Old scan to send first.
    old: Option<Scan>,
    /// `None` until the sensor is found.
    feed: Option<Feed>,
}

impl SensorLines {
    async fn next(&mut self) -> Option<Result<ViewerLine, Failure>> {
        if let Some(scan) = self.old.take() {
            let line = OldScan { old: true, line: scan_line(self.name.as_deref(), &scan) };
            return Some(json_line(&line).map(|ndjson| ViewerLine::new(&ndjson, false)));
        }
        let feed = match &mut self.feed {
            Some(feed) => feed,
            none => none.insert(self.hub.feed().await?),
        };
        let update = feed.next().await?;
        let ndjson = || update.line(self.name.as_deref());
        Some(match &update {
            Update::Scan(scan) => self.newest.of(scan.sequence(), ndjson),
            _ => ndjson().map(|ndjson| ViewerLine::new(&ndjson, false)),
        })
    }
}

/// Latest scan of a sensor that sends no scans at the moment.
#[derive(Debug, Serialize)]
struct OldScan<'a> {
    old: bool,
    #[serde(flatten)]
    line: NamedLine<'a, &'a Scan>,
}

fn scan_line<'a>(sensor: Option<&'a str>, data: &'a Scan) -> NamedLine<'a, &'a Scan> {
    NamedLine { sensor, position: None, data }
}

/// Lines of a playback: each scan shown, and each change of pause, speed or loop.
pub(super) struct PlaybackLines {
    shown: watch::Receiver<Shown>,
    window: Window,
    name: Option<Arc<str>>,
    newest: Arc<NewestLine>,
    /// Scan and settings that the client already has.
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
                    json_line(&NamedLine { sensor, position, data })
                }));
            }
            self.shown.changed().await.ok()?;
        }
    }
}

fn event(sensor: Option<&str>, playback: PlaybackStatus) -> Result<ViewerLine, Failure> {
    let line = NamedLine { sensor, position: None, data: PlaybackEvent { playback } };
    json_line(&line).map(|ndjson| ViewerLine::new(&ndjson, false))
}
