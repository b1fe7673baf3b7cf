//! Sensor with the one stream that all viewers share, and its health.

use std::fmt::Write;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio_scip::event::Event;
use tokio_scip::{Freshness, Rate, Scan, Sensor, State, Version, Window};

use crate::args::LinkArgs;
use crate::failure::Failure;
use crate::port::name::PortName;
use crate::port::open::Delivery;
use crate::port::open::{begin, opened};
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::StreamEnd;
use crate::stream::jitter::{Jitter, RecentTimes};
use crate::stream::reporter::Reporter;
use crate::stream::reporter::trouble;

/// Tolerance for a late scan, in addition to three periods.
const SCAN_GRACE: Duration = Duration::from_secs(2);

/// Sensor with one stream for all viewers.
#[derive(Debug)]
pub(crate) struct Hub {
    port: PortName,
    window: Window,
    rate: Rate,
    /// Set as soon as the search for the sensor begins.
    sensor: OnceLock<Sensor>,
    /// `None` until the sensor is found.
    live: watch::Sender<Option<Live>>,
    /// Identity of the sensor, read once it is found.
    version: OnceLock<Version>,
    /// Latest scan, for clients that connect while no scans arrive.
    latest: Mutex<Option<Scan>>,
    /// Arrival times of recent scans.
    times: Mutex<RecentTimes>,
}

/// Stream as of its latest update.
#[derive(Debug, Clone)]
pub(super) struct Live {
    pub(super) sensor: Sensor,
    /// Current position in the stream. A clone continues from there.
    feed: Feed,
}

/// State of the link in one word, and the reason if no scans arrive.
#[derive(Debug)]
pub(super) struct SensorHealth {
    pub(super) link: &'static str,
    /// `None` while scans arrive.
    pub(super) why: Option<String>,
}

impl Hub {
    pub(crate) fn new(port: PortName, window: Window, rate: Rate) -> Arc<Self> {
        let (sensor, live) = (OnceLock::new(), watch::Sender::new(None));
        let (version, latest, times) = (OnceLock::new(), Mutex::default(), Mutex::default());
        Arc::new(Self { port, window, rate, sensor, live, version, latest, times })
    }

    /// Finds the sensor and starts its stream. Does nothing if the stream already runs.
    pub(crate) async fn open(&self, link: &LinkArgs) -> Result<(), Failure> {
        if self.live.borrow().is_some() {
            return Ok(());
        }
        // Viewers only want the newest scan.
        let sensor = begin(&self.port, link, Delivery::Newest, Sensor::builder())?;
        // A hub gets here only once, so `set` succeeds.
        let _ = self.sensor.set(sensor.clone());
        opened(&self.port, link, &sensor).await?;
        if let Ok(version) = sensor.version().await {
            let _ = self.version.set(version);
        }
        let scans = sensor.scans(self.window, self.rate).await;
        let scans = scans.map_err(|error| Failure::at(&self.port.to_string(), &error))?;
        let feed = Feed::new(&self.port, scans);
        self.live.send_replace(Some(Live { sensor, feed }));
        Ok(())
    }

    /// Opens the sensor if necessary, then follows its stream until it ends permanently.
    pub(crate) async fn run(&self, link: &LinkArgs) -> Result<(), Failure> {
        self.open(link).await?;
        let Some(mut live) = self.live.borrow().clone() else { return Ok(()) };
        let reporter = Reporter::new(self.port.clone(), live.sensor.clone());
        let mut reporter = reporter.with_rate(self.window, self.rate);
        while let Some(update) = live.feed.next().await {
            reporter.report(&update);
            match &update {
                Update::Scan(scan) => {
                    self.times().push(scan.received_at());
                    *self.lock_latest() = Some(scan.clone());
                }
                Update::Event(Event::Reconnected) => self.times().clear(),
                Update::Error(_) | Update::Event(_) => {}
            }
            self.live.send_replace(Some(live.clone()));
        }
        reporter.finish(StreamEnd::ByItself)
    }

    /// Waits until the sensor is found, then creates a feed for a viewer.
    pub(super) async fn feed(&self) -> Option<Feed> {
        let mut live = self.live.subscribe();
        let live = live.wait_for(Option::is_some).await.ok()?;
        live.as_ref().map(|live| live.feed.clone())
    }

    fn lock_latest(&self) -> MutexGuard<'_, Option<Scan>> {
        // Nothing panics while it holds this lock.
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Latest scan, if no scans arrive at the moment.
    pub(super) fn old_scan(&self) -> Option<Scan> {
        self.health().why.and_then(|_| self.lock_latest().clone())
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

    pub(crate) fn port(&self) -> &PortName {
        &self.port
    }

    pub(super) fn window(&self) -> Window {
        self.window
    }

    pub(super) fn rate(&self) -> Rate {
        self.rate
    }

    pub(super) fn live(&self) -> Option<Live> {
        self.live.borrow().clone()
    }

    pub(super) fn health(&self) -> SensorHealth {
        let Some(sensor) = self.sensor.get() else {
            return SensorHealth {
                link: "waiting",
                why: Some("looking for the sensor".to_owned()),
            };
        };
        let state = sensor.state().get();
        let link = match &state {
            State::Connected { .. } => "connected",
            State::Connecting { .. } => "waiting",
            State::Recovering => "recovering",
            State::Disconnected { .. } => "disconnected",
            State::Closed { .. } => "closed",
            _ => "unknown",
        };
        let why = trouble(&state).or_else(|| {
            let wire_time = state.baud_rate().map(|rate| self.window.wire_time(rate));
            let period = self.rate.period().unwrap_or_default().max(wire_time.unwrap_or_default());
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
