//! Sensor with the one stream that all viewers share, and its health.

use std::fmt::Write;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio_scip::event::Event;
use tokio_scip::{Freshness, Scan, Sensor, State, Version};

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::picture::PictureSource;
use crate::port::open::{begin, opened};
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::StreamEnd;
use crate::stream::jitter::{Jitter, RecentTimes};
use crate::stream::reporter::{Reporter, trouble};
use crate::wait::some;

/// Tolerance for a late scan, in addition to three periods.
const SCAN_GRACE: Duration = Duration::from_secs(2);

/// Sensor with one stream for all viewers.
#[derive(Debug)]
pub(super) struct Hub {
    source: Arc<PictureSource>,
    /// Set as soon as the search for the sensor begins.
    sensor: OnceLock<Sensor>,
    /// Identity of the sensor, read once it is found.
    version: OnceLock<Version>,
    /// Current position in the stream, where a clone continues. `None` until the sensor is
    /// found.
    feed: watch::Sender<Option<Feed>>,
    /// Arrival times of recent scans.
    times: Mutex<RecentTimes>,
}

/// State of the link in one word, and the reason if no scans arrive.
#[derive(Debug)]
pub(super) struct SensorHealth {
    pub(super) link: &'static str,
    /// `None` while scans arrive.
    pub(super) why: Option<String>,
}

impl Hub {
    pub(super) fn new(source: Arc<PictureSource>) -> Self {
        let (sensor, version, times) = (OnceLock::new(), OnceLock::new(), Mutex::default());
        Self { source, sensor, version, feed: watch::Sender::new(None), times }
    }

    /// Finds the sensor and starts its stream.
    pub(super) async fn open(&self, link: &LinkArgs) -> Result<(Sensor, Feed), Failure> {
        let PictureSource { port, window, rate, .. } = &*self.source;
        // Viewers only want the newest scan.
        let sensor = begin(port, link, Delivery::Newest)?;
        // A hub is opened only once, so `set` succeeds.
        let _ = self.sensor.set(sensor.clone());
        opened(port, link, &sensor).await?;
        if let Ok(version) = sensor.version().await {
            let _ = self.version.set(version);
        }
        let scans = sensor.scans(*window, *rate).await;
        let scans = scans.map_err(|error| Failure::at(&port.to_string(), &error))?;
        let feed = Feed::new(port, scans);
        self.feed.send_replace(Some(feed.clone()));
        Ok((sensor, feed))
    }

    /// Follows the stream until it ends permanently.
    pub(super) async fn follow(&self, sensor: Sensor, mut feed: Feed) -> Result<(), Failure> {
        let PictureSource { port, window, rate, .. } = &*self.source;
        let mut reporter = Reporter::new(port.clone(), sensor).with_rate(*window, *rate);
        while let Some(update) = feed.next().await {
            reporter.report(&update);
            match &update {
                Update::Scan(scan) => self.times().push(scan.received_at()),
                Update::Event(Event::Reconnected) => self.times().clear(),
                Update::Error(_) | Update::Event(_) => {}
            }
            self.feed.send_replace(Some(feed.clone()));
        }
        reporter.finish(StreamEnd::ByItself)
    }

    /// Waits until the sensor is found, then creates a feed for a viewer.
    pub(super) async fn feed(&self) -> Feed {
        some(self.feed.subscribe()).await
    }

    /// Latest scan, if no scans arrive at the moment.
    pub(super) fn old_scan(&self) -> Option<Scan> {
        self.health().why.and_then(|_| self.feed.borrow().as_ref()?.latest())
    }

    pub(super) fn version(&self) -> Option<&Version> {
        self.version.get()
    }

    fn times(&self) -> MutexGuard<'_, RecentTimes> {
        // Nothing panics while it holds this lock.
        self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn jitter(&self) -> Option<Jitter> {
        self.times().jitter()
    }

    /// Sensor, once it is found.
    pub(super) fn sensor(&self) -> Option<&Sensor> {
        self.sensor.get().filter(|_| self.feed.borrow().is_some())
    }

    pub(super) fn health(&self) -> SensorHealth {
        let Some(sensor) = self.sensor.get() else {
            return SensorHealth {
                link: "waiting",
                why: Some("looking for the sensor".to_owned()),
            };
        };
        let state = sensor.watch_state().get();
        let link = match &state {
            State::Connected { .. } => "connected",
            State::Connecting { .. } => "waiting",
            State::Recovering => "recovering",
            State::Disconnected { .. } => "disconnected",
            State::Closed { .. } => "closed",
            _ => "unknown",
        };
        let PictureSource { window, rate, .. } = &*self.source;
        let why = trouble(&state).or_else(|| {
            let wire_time = state.baud_rate().map(|rate| window.wire_time(rate));
            let period = rate.period().unwrap_or_default().max(wire_time.unwrap_or_default());
            overdue(&sensor.freshness(), 3 * period + SCAN_GRACE)
        });
        SensorHealth { link, why }
    }
}

/// Explains why no scans arrive over a working link. Returns `None` while they do.
fn overdue(freshness: &Freshness, limit: Duration) -> Option<String> {
    let stale = freshness.check(limit).err()?;
    let mut why = match stale.age {
        Some(age) => format!("no scan for {:.1} s", age.as_secs_f64()),
        None => "no scan yet".to_owned(),
    };
    if let Some(error) = &stale.source {
        // Writing to a `String` is infallible.
        let _ = write!(why, ": {}", error.chain());
    }
    Some(why)
}
