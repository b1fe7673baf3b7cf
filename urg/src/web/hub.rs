//! Sensor with the one stream that all viewers share, and its health.

use std::sync::{Arc, OnceLock};

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio_scip::{Scan, Sensor, Version};
use urg_recording::Event;

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::picture::PictureSource;
use crate::port::open::{begin, opened};
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::StreamEnd;
use crate::stream::health::SensorHealth;
use crate::stream::jitter::{Jitter, RecentTimes};
use crate::stream::reporter::Reporter;
use crate::wait::wait_for_value;

/// Sensor with one stream for all viewers.
#[derive(Debug)]
pub(super) struct Hub {
    source: Arc<PictureSource>,
    /// Set as soon as the search for the sensor begins.
    sensor: OnceLock<Sensor>,
    /// Identity of the sensor, read once it is found.
    version: OnceLock<Version>,
    /// Current position in the stream, where a clone continues. `None` until the sensor is found.
    feed: watch::Sender<Option<Feed>>,
    times: Mutex<RecentTimes>,
}

impl Hub {
    pub(super) fn new(source: Arc<PictureSource>) -> Self {
        let (sensor, version, times) = (OnceLock::new(), OnceLock::new(), Mutex::default());
        Self { source, sensor, version, feed: watch::Sender::new(None), times }
    }

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
        let feed = Feed::open(port, &sensor, *window, *rate).await?;
        self.feed.send_replace(Some(feed.clone()));
        Ok((sensor, feed))
    }

    pub(super) async fn follow(&self, sensor: Sensor, mut feed: Feed) -> Result<(), Failure> {
        let PictureSource { port, window, rate, .. } = &*self.source;
        let mut reporter = Reporter::new(port.clone(), sensor).with_rate(*window, *rate);
        while let Some(update) = feed.next().await {
            reporter.report(&update);
            match &update {
                Update::Scan(scan) => self.times.lock().push(scan.received_at()),
                Update::Event(Event::Reconnected) => self.times.lock().clear(),
                Update::Error(_) | Update::Event(_) => {}
            }
            self.feed.send_replace(Some(feed.clone()));
        }
        reporter.finish(StreamEnd::ByItself)
    }

    /// Waits until the sensor is found, then creates a feed for a viewer.
    pub(super) async fn feed(&self) -> Feed {
        wait_for_value(self.feed.subscribe()).await
    }

    /// Latest scan, if no scans arrive at the moment.
    pub(super) fn old_scan(&self) -> Option<Scan> {
        self.health().why.and_then(|_| self.latest())
    }

    /// Newest scan.
    pub(super) fn latest(&self) -> Option<Scan> {
        self.feed.borrow().as_ref()?.latest()
    }

    pub(super) fn version(&self) -> Option<&Version> {
        self.version.get()
    }

    pub(super) fn jitter(&self) -> Option<Jitter> {
        self.times.lock().jitter()
    }

    /// Sensor, once it is found.
    pub(super) fn sensor(&self) -> Option<&Sensor> {
        self.sensor.get().filter(|_| self.feed.borrow().is_some())
    }

    pub(super) fn health(&self) -> SensorHealth {
        let PictureSource { window, rate, .. } = &*self.source;
        SensorHealth::from_sensor(self.sensor.get(), *window, *rate)
    }
}
