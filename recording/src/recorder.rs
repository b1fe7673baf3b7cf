//! [`Recorder`]: the handle through which a service records. Turns scans, replies and errors into
//! items of the [`Queue`].

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::time::Instant;

use super::RecordingError;
use super::item::WriteItem;
use super::progress::Progress;
use super::queue::Queue;
use super::writer::Times;
use crate::event::Events;
use tokio_scip::RawReply;
use tokio_scip::{Error, ReplyObservation, Scan, ScanStream, Sensor};

/// Records the items of a [`ScanStream`] and the replies of a sensor into an MCAP file.
///
/// No method waits for a disk. One thread writes the file, and ends a chunk of it at least once a second.
/// Another thread makes the system write it to the disk, once a second. If the process dies or the disk is
/// full, you lose at most one second; if the power fails, at most two, unless the disk is slower
/// ([`sync_interval`](super::RecorderBuilder::sync_interval)). The [module](super) has an example.
///
/// Dropping a recorder ends the file as [`finish`](Self::finish) does, without waiting for it.
#[derive(Debug)]
pub struct Recorder {
    queue: Arc<Queue>,
    events: Events,
    observation: Option<ReplyObservation>,
    is_complete: bool,
}

impl Recorder {
    pub(super) fn new(queue: Arc<Queue>) -> Self {
        Self { queue, events: Events::new(), observation: None, is_complete: false }
    }

    /// Records the bytes of every reply of an open sensor, from now until the recorder ends: first
    /// the reply to `V` that the driver knows, and then each one that comes. A replay sends them.
    ///
    /// A recorder observes one sensor: a second call ends the first observation. To record the
    /// replies with which a sensor is opened, set an [`observer`](Self::observer) instead.
    ///
    /// Two kinds of scans are left out once you have recorded a scan: those that a sensor in SCIP 2
    /// sends beyond the rate of the stream, and those that came after the last recorded scan. So a
    /// recording has exactly the scans of your stream, and those that you missed.
    pub fn observe(&mut self, sensor: &Sensor) {
        self.observation = None;
        self.observation = Some(sensor.observe_replies(self.observer()));
    }

    /// Creates an observer for [`SensorBuilder::on_reply`](tokio_scip::SensorBuilder::on_reply), which
    /// records the bytes of each reply, also those with which the sensor is opened.
    /// [`observe`](Self::observe) one that is already open. Do not do both, or each is recorded twice.
    pub fn observer(&self) -> impl Fn(RawReply<'_>) + Send + Sync + 'static {
        let queue = Arc::clone(&self.queue);
        let began = Instant::now();
        move |reply| {
            let request = match (reply.command, reply.request) {
                (Some(command), _) => command.to_string(),
                (_, Some(request)) => request.to_string(),
                _ => String::new(),
            };
            // A sensor's version may have come long before the recording.
            let steady = reply.received_at.max(began).into_std();
            let times = Times { steady, wall: reply.stamp };
            queue.push(WriteItem::Reply { request, bytes: reply.bytes.into(), times });
        }
    }

    /// Records the sensor's version and in SCIP 2 what it measures (`PP`), the window and rate of the
    /// stream, and the baud rate, as metadata. A replay takes its window and rate from it. A baud rate that the port ignores,
    /// as fast replies have shown, is `none`.
    ///
    /// Cancel-safe: a dropped future has written nothing.
    ///
    /// # Errors
    ///
    /// The same as for [`Sensor::version`].
    pub async fn describe(&self, sensor: &Sensor, scans: &ScanStream) -> Result<(), Error> {
        let (version, geometry) = (sensor.version().await?, sensor.geometry().await?);
        let baud_rate = sensor.watch_state().get().baud_rate();
        let baud_rate = baud_rate.filter(|_| !sensor.stats().baud_rate_disproved);
        let baud_rate = baud_rate.map_or_else(|| "none".to_owned(), |rate| rate.to_string());
        let window = scans.window().resolve(&geometry).unwrap_or(scans.window());
        let mut metadata: BTreeMap<_, _> = [
            ("vendor", version.vendor.to_string()),
            ("product", version.product.to_string()),
            ("firmware", version.firmware.to_string()),
            ("protocol", version.protocol.to_string()),
            ("serial_number", version.serial_number.to_string()),
            ("baud_rate", baud_rate),
            ("start", window.start().to_string()),
            ("end", window.end().to_string()),
            ("cluster", window.cluster_count().to_string()),
            ("rate", scans.rate().to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into();
        let parameters = sensor.parameters();
        let pairs = parameters.iter().flat_map(|parameters| parameters.pairs());
        metadata.extend(pairs.map(|(key, value)| (key.to_string(), value.to_string())));
        metadata.extend(version.status.map(|status| ("status".to_owned(), status.to_string())));
        self.queue.push(WriteItem::Metadata(metadata));
        Ok(())
    }

    /// Records an item of a [`ScanStream`]: a scan or an error. Also records an event for missed scans and
    /// for the first scan after a lost link. Never waits.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] once writing has failed: the recording has ended,
    /// but the stream continues.
    pub fn record(&mut self, item: &Result<Scan, Error>) -> Result<(), RecordingError> {
        let times = item.as_ref().map_or_else(|_| Times::now(), Times::of);
        for event in self.events.from_item(item) {
            self.queue.push(WriteItem::Event { json: event.to_string(), times });
        }
        if let Ok(scan) = item {
            self.queue.push(WriteItem::Scan(scan.clone()));
        }
        self.queue.failure().map_or(Ok(()), Err)
    }

    /// Writes what is held [before](super::RecorderBuilder::before) this call, and from now on every item.
    /// Does nothing if nothing is held back.
    pub fn trigger(&self) {
        self.queue.release();
    }

    /// Waits until at most 1 MiB is queued for the disk, or writing has failed.
    ///
    /// Use it as backpressure for a source that can wait, such as a replay, which then loses
    /// no scan to a slow disk. A sensor does not wait.
    ///
    /// Cancel-safe.
    pub async fn ready(&self) {
        self.queue.ready().await;
    }

    /// Current counts.
    pub fn progress(&self) -> Progress {
        self.queue.progress()
    }

    /// Writes all queued items, the file's index and its end. Returns the final counts once all of
    /// it is on the disk.
    ///
    /// Continues even if you drop this future.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] if this or any earlier write failed.
    pub async fn finish(mut self) -> Result<Progress, RecordingError> {
        if !self.is_complete {
            self.complete().await?;
        }
        self.queue.ended().await;
        self.queue.failure().map_or_else(|| Ok(self.progress()), Err)
    }

    /// Does the same as [`finish`](Self::finish), but does not wait until the file is on the disk: a
    /// slow disk may take longer for that than you want to wait. Records nothing afterwards.
    ///
    /// Continues even if you drop this future.
    ///
    /// # Errors
    ///
    /// The same as for [`finish`](Self::finish).
    pub async fn complete(&mut self) -> Result<Progress, RecordingError> {
        // First: replies that come meanwhile are not lost ones.
        self.observation = None;
        if self.queue.finish().await.is_err() {
            // The thread ends, and then `failure` has the reason.
            self.queue.ended().await;
        }
        self.is_complete = true;
        self.queue.failure().map_or_else(|| Ok(self.progress()), Err)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Requests the end, because the observer may keep the queue open for longer. Does not wait for it.
        drop(self.queue.finish());
    }
}
