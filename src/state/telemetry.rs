//! [`Telemetry`]: the state, the counters and the identity of the sensor, written by
//! the driver and read by its handles.

use std::mem::{Discriminant, discriminant};
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;

use super::{Freshness, ScheduleStats, State, Stats};
use crate::protocol::Version;
use crate::{BaudRate, Error};

/// While a driver waits for its sensor it logs so at level info at this interval.
const WAITING_INTERVAL: Duration = Duration::from_secs(600);

#[derive(Debug)]
pub(crate) struct Telemetry {
    name: Option<Arc<str>>,
    state: watch::Sender<State>,
    counters: Mutex<Counters>,
    schedules: Mutex<Vec<(ScheduleStats, Weak<dyn Audience>)>>,
    version: Mutex<Option<Version>>,
    /// The last log line of a driver that waits for its sensor.
    waiting: Mutex<Option<(Discriminant<Error>, Instant)>>,
    /// The number of handles that wait for the driver to close.
    closing: AtomicUsize,
}

/// The streams of a schedule, which may all be gone before the driver notices.
pub(crate) trait Audience: Send + Sync + std::fmt::Debug {
    /// Returns true if a stream is left.
    fn is_present(&self) -> bool;
}

/// [`Stats`] and [`Freshness`], which change together.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    stats: Stats,
    last_scan: Option<Instant>,
    /// The latest error since the last scan.
    error: Option<Error>,
}

impl Telemetry {
    pub(crate) fn new(name: Option<Arc<str>>) -> Self {
        Self {
            name,
            state: watch::Sender::new(State::Connecting { error: None }),
            counters: Mutex::default(),
            version: Mutex::default(),
            schedules: Mutex::default(),
            waiting: Mutex::default(),
            closing: AtomicUsize::new(0),
        }
    }

    /// Returns the name of the sensor in logs and errors.
    pub(crate) fn name(&self) -> Option<&Arc<str>> {
        self.name.as_ref()
    }

    pub(crate) fn watch(&self) -> watch::Receiver<State> {
        self.state.subscribe()
    }

    /// Enters a state, and logs it.
    pub(crate) fn enter(&self, state: State) {
        self.log(&state);
        match &state {
            State::Connecting { error: Some(error) }
            | State::Disconnected { error, .. }
            | State::Closed { error: Some(error) } => self.stats().failed(error),
            State::Closed { error: None } => self.stats().failed(&Error::Closed),
            State::Connecting { error: None } | State::Connected { .. } | State::Recovering => {}
        }
        if matches!(state, State::Disconnected { .. } | State::Closed { .. }) {
            *lock(&self.version) = None;
        }
        self.state.send_replace(state);
    }

    fn log(&self, state: &State) {
        match state {
            State::Connecting { error: Some(error) } => self.log_waiting(error),
            State::Connecting { error: None } => tracing::debug!("searching for the sensor"),
            State::Connected { baud_rate, streaming, serial_number } => {
                let baud_rate = baud_rate.map(u32::from);
                tracing::info!(baud_rate, streaming, %serial_number, "connected");
            }
            State::Recovering => tracing::warn!("the sensor does not answer: searching for it"),
            State::Disconnected { error, .. } => {
                tracing::warn!(error = %error.chain(), "disconnected");
            }
            State::Closed { error: Some(error) } => {
                tracing::error!(error = %error.chain(), "the driver has ended");
            }
            State::Closed { error: None } => tracing::debug!("closed"),
        }
    }

    /// Logs once for each reason, and again at long intervals: a service may wait for
    /// its sensor for days, and tries once a second.
    fn log_waiting(&self, error: &Error) {
        let (kind, now) = (discriminant(error), Instant::now());
        let mut last = lock(&self.waiting);
        let is_due = last.is_none_or(|(last, at)| last != kind || now - at >= WAITING_INTERVAL);
        if is_due {
            *last = Some((kind, now));
            tracing::info!(error = %error.chain(), "waiting for the sensor");
        }
    }

    /// Records the baud rate after it was changed.
    pub(crate) fn set_baud_rate(&self, now: Option<BaudRate>) {
        self.state.send_if_modified(|state| match state {
            State::Connected { baud_rate, .. } if *baud_rate != now => {
                *baud_rate = now;
                true
            }
            _ => false,
        });
    }

    /// Records whether scans are polled; wakes watchers only if that has changed.
    pub(crate) fn set_streaming(&self, now: bool) {
        self.state.send_if_modified(|state| match state {
            State::Connected { streaming, .. } if *streaming != now => {
                *streaming = now;
                true
            }
            _ => false,
        });
    }

    /// Returns the error of calls after the driver has ended.
    pub(crate) fn cause(&self) -> Error {
        match &*self.state.borrow() {
            State::Closed { error: Some(error) } => error.clone(),
            _ => Error::Closed,
        }
    }

    pub(crate) fn is_closed(&self) -> bool {
        matches!(&*self.state.borrow(), State::Closed { .. })
    }

    pub(crate) fn stats(&self) -> MutexGuard<'_, Counters> {
        lock(&self.counters)
    }

    /// Returns a copy of the counters, with the schedules that have a stream.
    pub(crate) fn snapshot(&self) -> Stats {
        let mut stats = self.stats().stats.clone();
        let is_read = |audience: &Weak<dyn Audience>| {
            audience.upgrade().is_some_and(|audience| audience.is_present())
        };
        let schedules = lock(&self.schedules);
        let read = schedules.iter().filter(|(_, audience)| is_read(audience));
        stats.schedules.extend(read.map(|(schedule, _)| *schedule));
        stats
    }

    /// Replaces the schedules, in place and without allocating.
    pub(crate) fn set_schedules(
        &self,
        schedules: impl Iterator<Item = (ScheduleStats, Weak<dyn Audience>)>,
    ) {
        let mut noted = lock(&self.schedules);
        noted.clear();
        noted.extend(schedules);
    }

    /// Announces that the driver is to close, as long as the guard lives.
    pub(crate) fn closing(&self) -> Closing<'_> {
        self.closing.fetch_add(1, Ordering::Relaxed);
        Closing(&self.closing)
    }

    /// Returns true if the driver is to close: then a sensor that does not answer gets
    /// no further try.
    pub(crate) fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed) > 0
    }

    pub(crate) fn freshness(&self) -> Freshness {
        let counters = self.stats();
        Freshness::new(counters.last_scan, counters.error.clone())
    }

    pub(crate) fn version(&self) -> Option<Version> {
        lock(&self.version).clone()
    }

    pub(crate) fn set_version(&self, version: Version) {
        *lock(&self.version) = Some(version);
    }
}

impl Counters {
    /// Counts a good scan.
    pub(crate) fn scanned(&mut self, requested_at: Instant, received_at: Instant) {
        self.stats.scans += 1;
        self.stats.reply_latency.add(received_at - requested_at);
        self.last_scan = Some(received_at);
        self.error = None;
    }

    /// Records why there is no scan.
    pub(crate) fn failed(&mut self, error: &Error) {
        self.error = Some(error.clone());
    }
}

impl Deref for Counters {
    type Target = Stats;

    fn deref(&self) -> &Stats {
        &self.stats
    }
}

impl DerefMut for Counters {
    fn deref_mut(&mut self) -> &mut Stats {
        &mut self.stats
    }
}

/// A handle that waits for the driver to close.
pub(crate) struct Closing<'a>(&'a AtomicUsize);

impl Drop for Closing<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Counters and plain values: never half changed.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
