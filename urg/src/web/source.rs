//! Sources of scans: sensors and playbacks of recordings, each with a name and a place.
//! Sources do not depend on each other.

use std::convert::Infallible;
use std::sync::Arc;

use futures_util::stream::{self, BoxStream, StreamExt};
use serde::Serialize;
use tokio::sync::{mpsc, watch};
use tokio_scip::{Scan, Version};

use super::codes::ErrorCodes;
use super::hub::Hub;
use super::line::{NewestLine, ViewerLine};
use crate::args::LinkArgs;
use crate::failure::Failure;
use crate::format::json_line;
use crate::picture::PictureSource;
use crate::playback::{PlaybackArgs, PlaybackStatus, Player, Shown, seen_through};
use crate::stream::feed::{Feed, NamedLine, Update};
use crate::stream::health::SensorHealth;

#[derive(Debug)]
pub(crate) struct SiteSource {
    pub(super) picture: Arc<PictureSource>,
    kind: SourceKind,
    newest: NewestLine,
    pub(super) codes: ErrorCodes,
}

#[derive(Debug)]
enum SourceKind {
    Sensor(Hub),
    Recording(Player),
}

#[derive(Debug, Serialize)]
#[serde(tag = "event", rename = "playback")]
struct PlaybackEvent {
    playback: PlaybackStatus,
}

impl SiteSource {
    /// Starts to play a recording. [`run`](Self::run) opens a sensor.
    pub(crate) async fn new(
        picture: PictureSource,
        settings: PlaybackArgs,
    ) -> Result<Arc<Self>, Failure> {
        let picture = Arc::new(picture);
        let kind = match picture.port.recorded() {
            Some(recorded) => SourceKind::Recording(Player::start(recorded, settings).await?),
            None => SourceKind::Sensor(Hub::new(Arc::clone(&picture))),
        };
        let (newest, codes) = (NewestLine::default(), ErrorCodes::default());
        Ok(Arc::new(Self { picture, kind, newest, codes }))
    }

    /// Runs until the source ends permanently: a playback, when its file becomes unreadable.
    /// Drops `opening` when a sensor is open or has failed to open.
    pub(crate) async fn run(
        &self,
        link: &LinkArgs,
        opening: mpsc::Sender<Infallible>,
    ) -> Result<(), Failure> {
        match &self.kind {
            SourceKind::Sensor(hub) => {
                let (sensor, feed) = hub.open(link).await?;
                drop(opening);
                hub.follow(sensor, feed).await
            }
            SourceKind::Recording(player) => {
                drop(opening);
                Err(player.failed().await)
            }
        }
    }

    pub(super) fn hub(&self) -> Option<&Hub> {
        match &self.kind {
            SourceKind::Sensor(hub) => Some(hub),
            SourceKind::Recording(_) => None,
        }
    }

    pub(super) fn player(&self) -> Option<&Player> {
        match &self.kind {
            SourceKind::Sensor(_) => None,
            SourceKind::Recording(player) => Some(player),
        }
    }

    /// Name that the user gave the source.
    pub(super) fn name(&self) -> Option<&str> {
        self.picture.name.as_deref()
    }

    pub(super) fn version(&self) -> Option<&Version> {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.version(),
            SourceKind::Recording(player) => Some(player.version()),
        }
    }

    /// Newest scan of a sensor, or the shown scan of a recording.
    pub(super) fn latest(&self) -> Option<Scan> {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.latest(),
            SourceKind::Recording(player) => Some(player.shown().borrow().scan.clone()),
        }
    }

    pub(super) fn health(&self) -> SensorHealth {
        match &self.kind {
            SourceKind::Sensor(hub) => hub.health(),
            SourceKind::Recording(player) => match player.failure() {
                None => SensorHealth { link: "recording", why: None },
                Some(failure) => {
                    SensorHealth { link: "closed", why: Some(failure.line().to_owned()) }
                }
            },
        }
    }

    /// Starts the lines for a new client. With `with_old`, the latest scan comes first,
    /// marked as old, if no scans arrive at the moment.
    pub(super) fn lines(self: &Arc<Self>, with_old: bool) -> BoxStream<'static, ViewerLine> {
        let source = Arc::clone(self);
        match &self.kind {
            SourceKind::Sensor(hub) => {
                let old = hub.old_scan().filter(|_| with_old);
                let lines = SensorLines { source, old, feed: None };
                stream::unfold(lines, |mut lines| async { Some((lines.next().await?, lines)) })
                    .boxed()
            }
            SourceKind::Recording(player) => {
                let shown = player.shown();
                let lines = PlaybackLines { source, shown, scan: None, settings: None };
                stream::unfold(lines, |mut lines| async { Some((lines.next().await?, lines)) })
                    .boxed()
            }
        }
    }
}

struct SensorLines {
    source: Arc<SiteSource>,
    old: Option<Scan>,
    /// `None` until the sensor is found.
    feed: Option<Feed>,
}

impl SensorLines {
    /// Waits for the next line. Returns `None` after the end.
    async fn next(&mut self) -> Option<ViewerLine> {
        let sensor = self.source.name();
        if let Some(data) = &self.old.take() {
            let line = NamedLine { sensor, position: None, data };
            return other_line(&OldScan { old: true, line });
        }
        let feed = match &mut self.feed {
            Some(feed) => feed,
            none => none.insert(self.source.hub()?.feed().await),
        };
        let update = feed.next().await?;
        let ndjson = || update.line(sensor);
        match &update {
            Update::Scan(scan) => self.source.newest.scan(scan.sequence(), ndjson),
            _ => Some(ViewerLine::new(&ndjson().ok()?, false)),
        }
    }
}

/// Latest scan of a sensor that sends no scans at the moment.
#[derive(Debug, Serialize)]
struct OldScan<'a> {
    old: bool,
    #[serde(flatten)]
    line: NamedLine<'a, &'a Scan>,
}

/// Lines of a playback: each scan shown, and each change of pause, speed or loop.
struct PlaybackLines {
    source: Arc<SiteSource>,
    shown: watch::Receiver<Shown>,
    /// Scan and settings that the client already has.
    scan: Option<usize>,
    settings: Option<PlaybackStatus>,
}

impl PlaybackLines {
    async fn next(&mut self) -> Option<ViewerLine> {
        let sensor = self.source.name();
        loop {
            let Shown { scan, status } = self.shown.borrow_and_update().clone();
            let settings = PlaybackStatus { scan: 0, position: 0.0, ..status };
            if self.settings.replace(settings) != Some(settings) {
                let data = PlaybackEvent { playback: status };
                return other_line(&NamedLine { sensor, position: None, data });
            }
            if self.scan.replace(status.scan) != Some(status.scan) {
                let position = Some(status.position);
                return self.source.newest.scan(status.scan as u64, || {
                    let data = seen_through(&scan, self.source.picture.window);
                    json_line(&NamedLine { sensor, position, data })
                });
            }
            self.shown.changed().await.ok()?;
        }
    }
}

fn other_line(data: &impl Serialize) -> Option<ViewerLine> {
    // Serializing is infallible.
    Some(ViewerLine::new(&json_line(data).ok()?, false))
}
