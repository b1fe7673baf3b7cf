//! One sensor and the one stream of it that all viewers share, and its health.

use std::fmt::Write;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio_scip::{Event, Freshness, Rate, Sensor, State, Window};

use super::recent_times::RecentTimes;
use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::name::PortName;
use crate::port::open::{begin, opened};
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::Ended;
use crate::stream::jitter::Jitter;
use crate::stream::link::trouble;
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::Reporter;

/// A scan may be late by three periods and this.
const SCAN_GRACE: Duration = Duration::from_secs(2);

/// One sensor and one stream of it, for everybody.
#[derive(Debug)]
pub(crate) struct Hub {
    port: PortName,
    window: Window,
    rate: Rate,
    /// The sensor, also while it is looked for.
    sensor: OnceLock<Sensor>,
    /// `None` until the sensor is found.
    live: watch::Sender<Option<Live>>,
    /// The times of the latest scans.
    times: Mutex<RecentTimes>,
}

/// The stream as of its latest update.
#[derive(Debug, Clone)]
pub(super) struct Live {
    pub(super) sensor: Sensor,
    /// The stream at its current place: a clone continues from there.
    feed: Feed,
}

/// The state of the link in a word, and the reason if no scans flow.
#[derive(Debug)]
pub(super) struct Health {
    pub(super) link: &'static str,
    /// `None` while scans arrive.
    pub(super) why: Option<String>,
}

impl Hub {
    pub(crate) fn new(port: PortName, window: Window, rate: Rate) -> Arc<Self> {
        let (sensor, live) = (OnceLock::new(), watch::Sender::new(None));
        let times = Mutex::default();
        Arc::new(Self { port, window, rate, sensor, live, times })
    }

    /// Finds the sensor and starts its stream, unless that is done.
    pub(crate) async fn open(&self, link: &LinkArgs) -> Result<(), Failure> {
        if self.live.borrow().is_some() {
            return Ok(());
        }
        // Viewers want the newest scan, and no other.
        let sensor = begin(&self.port, link, Delivery::Newest, Sensor::builder())?;
        // It is opened once.
        let _ = self.sensor.set(sensor.clone());
        opened(&self.port, link, &sensor).await?;
        let scans = sensor.scans(self.window, self.rate).await;
        let scans = scans.map_err(|error| Failure::at(&self.port.to_string(), &error))?;
        let feed = Feed::new(&self.port, scans);
        self.live.send_replace(Some(Live { sensor, feed }));
        Ok(())
    }

    /// Opens the sensor unless that is done, and follows the stream until it ends
    /// for good.
    pub(crate) async fn run(&self, link: &LinkArgs) -> Result<(), Failure> {
        self.open(link).await?;
        let Some(mut live) = self.live.borrow().clone() else { return Ok(()) };
        let mut reporter = Reporter::new(self.port.clone(), live.sensor.clone());
        let mut pace = RateWatch::new(&self.port, self.window, self.rate);
        while let Some(update) = live.feed.next().await {
            reporter.report(&update);
            match &update {
                Update::Scan(scan) => {
                    self.times().push(scan.received_at());
                    if let Some(text) = pace.scanned(scan, &live.sensor) {
                        notice(format_args!("{}: {text}", self.port));
                    }
                }
                Update::Event(Event::Reconnected) => self.times().clear(),
                Update::Error(_) | Update::Event(_) => {}
            }
            self.live.send_replace(Some(live.clone()));
        }
        reporter.finish(Ended::ByItself)
    }

    /// Returns a feed for a viewer, once the sensor is found.
    pub(super) async fn feed(&self) -> Option<Feed> {
        let mut live = self.live.subscribe();
        let live = live.wait_for(Option::is_some).await.ok()?;
        live.as_ref().map(|live| live.feed.clone())
    }

    fn times(&self) -> MutexGuard<'_, RecentTimes> {
        // Nothing panics while it is held.
        self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns how evenly scans came lately.
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

    pub(super) fn health(&self) -> Health {
        let Some(sensor) = self.sensor.get() else {
            return Health { link: "waiting", why: Some("looking for the sensor".to_owned()) };
        };
        let state = sensor.state().borrow().clone();
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
        Health { link, why }
    }
}

/// Returns the reason why no scans flow over a working link, if none do.
fn overdue(freshness: &Freshness, limit: Duration) -> Option<String> {
    let stale = freshness.check(limit).err()?;
    let mut why = match stale.age {
        Some(age) => format!("no scan for {:.1} s", age.as_secs_f64()),
        None => "no scan yet".to_owned(),
    };
    if let Some(error) = &stale.source {
        // Writing to a string does not fail.
        let _ = write!(why, ": {}", error.chain());
    }
    Some(why)
}
