//! The one stream of scans that all viewers share, and how it goes.

use std::fmt::Write;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::time::Instant;

use tokio::sync::watch;
use tokio_scip::{Rate, Sensor, State, Window};

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::{Failure, chain};
use crate::port::name::PortName;
use crate::port::open::{begin, opened};
use crate::stream::feed::{Feed, Update};
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::Reporter;

/// What scans may be late by, beside some periods.
const GRACE: Duration = Duration::from_secs(2);

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
}

/// How it goes, as of the latest update of the stream.
#[derive(Debug, Clone)]
pub(super) struct Live {
    pub(super) sensor: Sensor,
    /// Where the stream is: a copy goes on with what comes next.
    feed: Feed,
    /// When the latest scan came.
    pub(super) scanned: Option<Instant>,
    /// What came instead of a scan since then.
    error: Option<String>,
}

/// Whether scans flow.
#[derive(Debug)]
pub(super) struct Health {
    /// One word for it.
    pub(super) link: &'static str,
    /// Why no scans flow; `None` while they do.
    pub(super) why: Option<String>,
}

impl Hub {
    pub(crate) fn new(port: PortName, window: Window, rate: Rate) -> Arc<Self> {
        let (sensor, live) = (OnceLock::new(), watch::Sender::new(None));
        Arc::new(Self { port, window, rate, sensor, live })
    }

    /// Finds the sensor and begins its stream, if that was not done yet.
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
        self.live.send_replace(Some(Live { sensor, feed, scanned: None, error: None }));
        Ok(())
    }

    /// Follows the stream, until it ends for good.
    pub(crate) async fn run(&self, link: &LinkArgs) -> Result<(), Failure> {
        self.open(link).await?;
        let Some(mut live) = self.live.borrow().clone() else { return Ok(()) };
        let mut reporter = Reporter::new(self.port.clone(), live.sensor.clone());
        let mut pace = RateWatch::new(&self.port, self.window, self.rate);
        while let Some(update) = live.feed.next().await {
            reporter.report(&update);
            match &update {
                Update::Scan(scan) => {
                    live.scanned = Some(scan.received_at());
                    live.error = None;
                    pace.look(&live.sensor);
                }
                Update::Error(error) => live.error = Some(chain(error)),
                Update::Reconnected | Update::Missed(_) => {}
            }
            self.live.send_replace(Some(live.clone()));
        }
        reporter.end()
    }

    /// A feed of its own for a viewer, once there is one.
    pub(super) async fn feed(&self) -> Option<Feed> {
        let mut live = self.live.subscribe();
        let live = live.wait_for(Option::is_some).await.ok()?;
        live.as_ref().map(|live| live.feed.clone())
    }

    pub(super) fn port(&self) -> &PortName {
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
        let (link, why) = match &*sensor.state().borrow() {
            State::Connected { baud_rate, .. } => {
                let wire = baud_rate.map_or(Duration::ZERO, |speed| self.window.wire_time(speed));
                let period = self.rate.period().unwrap_or_default().max(wire);
                let why = self.live().map_or_else(
                    || Some("no scan yet".to_owned()),
                    |live| live.overdue(3 * period + GRACE),
                );
                ("connected", why)
            }
            State::Connecting { error } => {
                let why =
                    error.as_ref().map(|error| format!("waiting for a sensor: {}", chain(error)));
                ("waiting", Some(why.unwrap_or_else(|| "looking for the sensor".to_owned())))
            }
            State::Recovering => ("recovering", Some("the sensor is silent".to_owned())),
            State::Disconnected { error, .. } => ("disconnected", Some(chain(error))),
            State::Closed { error } => {
                let why = error.as_ref().map_or_else(|| "closed".to_owned(), |error| chain(error));
                ("closed", Some(why))
            }
            _ => ("unknown", Some("in a state of no name".to_owned())),
        };
        Health { link, why }
    }
}

impl Live {
    /// Why scans do not flow over a link that is there, if they do not.
    fn overdue(&self, patience: Duration) -> Option<String> {
        let mut why = match self.scanned.map(|scanned| scanned.elapsed()) {
            Some(age) if age <= patience => return None,
            Some(age) => format!("no scan for {:.1} s", age.as_secs_f64()),
            None => "no scan yet".to_owned(),
        };
        if let Some(error) = &self.error {
            // Writing to a string does not fail.
            let _ = write!(why, ": {error}");
        }
        Some(why)
    }
}
