//! What a driver tells of itself: [`State`], to be awaited, and [`Stats`], to
//! be counted.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;

use crate::protocol::{Malformed, ReplyError, Text, Version};
use crate::{BaudRate, Error, Rate, Window};

/// What the driver is about. [`Sensor::state`](crate::Sensor::state) gives a
/// watch of it. [`Closed`](Self::Closed) is the last one, whatever came before.
///
/// As data (feature `serde`) it is an object whose `state` says which one it is,
/// in snake case, beside its fields: `baud_rate` in baud, `since` as the seconds
/// that have gone by, `error` as the text of the error and its causes. Such as
/// `{"state":"disconnected","since":1.5,"error":"..."}`.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(tag = "state", rename_all = "snake_case"))]
#[non_exhaustive]
pub enum State {
    /// The port is being opened for the first time, or the sensor looked for.
    Connecting {
        /// Why it has not worked yet, where the driver was told to
        /// [wait for the sensor](crate::SensorBuilder::wait_for_sensor).
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain_if_any"))]
        error: Option<Error>,
    },
    /// The sensor answers.
    Connected {
        /// The speed of the line to it, or `None` where none matters (USB).
        baud_rate: Option<BaudRate>,
        /// Whether scans are polled: a stream is open, and the laser was not
        /// switched off.
        streaming: bool,
        /// The sensor's serial number, as in its `SERI:` line. It changes when
        /// another sensor has taken the place of the one before, which
        /// [`any_sensor`](crate::SensorBuilder::any_sensor) allows.
        serial_number: Text,
    },
    /// The sensor fell silent on a port that is still open, and is looked for at
    /// every baud rate.
    Recovering,
    /// The link is lost; the driver tries to get it back.
    Disconnected {
        /// Since when.
        #[cfg_attr(feature = "serde", serde(serialize_with = "elapsed"))]
        since: Instant,
        /// The latest reason.
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain"))]
        error: Error,
    },
    /// The driver has ended for good.
    Closed {
        /// Why, or `None` if it was closed or nobody used it any more.
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain_if_any"))]
        error: Option<Error>,
    },
}

impl State {
    /// Returns the baud rate of the line to the sensor: `None` unless
    /// [connected](Self::Connected), and where the link has none (USB).
    pub fn baud_rate(&self) -> Option<BaudRate> {
        match self {
            Self::Connected { baud_rate, .. } => *baud_rate,
            _ => None,
        }
    }
}

/// Serialises an error and its causes as one text.
#[cfg(feature = "serde")]
fn chain<S: serde::Serializer>(error: &Error, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&error.chain())
}

#[cfg(feature = "serde")]
fn chain_if_any<S: serde::Serializer>(
    error: &Option<Error>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    match error {
        Some(error) => chain(error, serializer),
        None => serializer.serialize_none(),
    }
}

/// An instant means nothing elsewhere; how long ago it was does.
#[cfg(feature = "serde")]
fn elapsed<S: serde::Serializer>(since: &Instant, serializer: S) -> Result<S::Ok, S::Error> {
    seconds(&since.elapsed(), serializer)
}

#[cfg(feature = "serde")]
fn seconds<S: serde::Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_secs_f64())
}

/// What happened since the driver began: a copy, as
/// [`Sensor::stats`](crate::Sensor::stats) gives it. No count ever goes back, also
/// when the link is lost. As data (feature `serde`) it has its fields by name.
#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Stats {
    /// `G`s sent for streams and single scans.
    pub polls: u64,
    /// Scans that came back whole.
    pub scans: u64,
    /// Scans equal to the one before.
    pub repeats: u64,
    /// Commands that were not answered in time, fences not counted.
    pub timeouts: u64,
    /// Commands that the sensor refused.
    pub refused: u64,
    /// Replies that were damaged, by what was wrong with them.
    pub malformed: MalformedCounts,
    /// Fences sent: single-step `G`s that prove that nothing older is on its
    /// way.
    pub fences: u64,
    /// Fences that were not answered in time.
    pub fence_timeouts: u64,
    /// Times that the link was lost.
    pub disconnects: u64,
    /// Times that a sensor was found again, on the same port or a new one.
    pub reconnects: u64,
    /// Bytes that belonged to no reply that was asked for.
    pub bytes_skipped: u64,
    /// Scans that streams did not get to see because their consumers were slow.
    pub missed: u64,
    /// Polls that were dropped because the line was busy when they were due and
    /// still was when the next one was.
    pub polls_skipped: u64,
    /// Whether a reply came faster than the baud rate of the port can carry, so that
    /// the port has another one or none that matters: a pseudo-terminal, a sensor on
    /// USB, a serial server. Limits computed from the baud rate do not hold then.
    pub baud_rate_outrun: bool,
    /// From a `G` sent to the last byte of its reply.
    pub reply_latency: LatencyStats,
    /// What is polled now, and how fast.
    pub schedules: Vec<ScheduleStats>,
}

/// Damaged replies, by what was wrong with them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct MalformedCounts {
    /// The echo was that of another command, or damaged.
    pub echo: u64,
    /// The status was missing or not one character.
    pub status: u64,
    /// A line had the wrong length, or data was missing or too much.
    pub length: u64,
    /// A character carried no 6-bit number.
    pub character: u64,
    /// No end came in sight.
    pub overlong: u64,
}

impl MalformedCounts {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.echo + self.status + self.length + self.character + self.overlong
    }

    pub(crate) fn count(&mut self, error: &ReplyError) {
        let counter = match error {
            ReplyError::Foreign { .. } => &mut self.echo,
            ReplyError::Scip2 { .. } => &mut self.status,
            ReplyError::Malformed(malformed) => match malformed {
                Malformed::Echo { .. } | Malformed::Early { .. } => &mut self.echo,
                Malformed::NoStatus | Malformed::Status { .. } => &mut self.status,
                Malformed::Character { .. } => &mut self.character,
                Malformed::Overlong { .. } | Malformed::NotRaw => &mut self.overlong,
                _ => &mut self.length,
            },
        };
        *counter += 1;
    }
}

/// How long replies took. All zero before the first one. As data (feature
/// `serde`), all times are in seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct LatencyStats {
    /// The latest.
    #[cfg_attr(feature = "serde", serde(serialize_with = "seconds"))]
    pub last: Duration,
    /// The shortest.
    #[cfg_attr(feature = "serde", serde(serialize_with = "seconds"))]
    pub min: Duration,
    /// The longest.
    #[cfg_attr(feature = "serde", serde(serialize_with = "seconds"))]
    pub max: Duration,
    /// The sum of all.
    #[cfg_attr(feature = "serde", serde(serialize_with = "seconds"))]
    pub total: Duration,
    /// How many replies were timed.
    pub count: u64,
}

impl LatencyStats {
    /// The mean, or zero before the first reply.
    pub fn mean(&self) -> Duration {
        if self.count == 0 { Duration::ZERO } else { self.total.div_f64(self.count as f64) }
    }

    pub(crate) fn add(&mut self, latency: Duration) {
        self.last = latency;
        self.min = if self.count == 0 { latency } else { self.min.min(latency) };
        self.max = self.max.max(latency);
        self.total += latency;
        self.count += 1;
    }
}

/// What one schedule asked for, and what it gets.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct ScheduleStats {
    /// What is polled.
    pub window: Window,
    /// How often, or `None` for [`Rate::MAX`], in scans a second.
    pub asked: Option<f64>,
    /// Scans a second that came, over the last three seconds or so that they
    /// were polled; 0 before that, and while the link is lost.
    pub reached: f64,
    /// Polls of those seconds that failed: their replies were lost, malformed or
    /// refused. While there are some, `reached` says nothing of what the line and
    /// the sensor can carry.
    pub failed: u32,
}

impl ScheduleStats {
    pub(crate) fn new(window: Window, rate: Rate, reached: f64, failed: u32) -> Self {
        let asked = rate.period().map(|period| 1.0 / period.as_secs_f64());
        Self { window, asked, reached, failed }
    }
}

/// What driver and handles share: the state, the counters, and who the sensor
/// is while it is there.
#[derive(Debug)]
pub(crate) struct Telemetry {
    state: watch::Sender<State>,
    stats: Mutex<Stats>,
    schedules: Mutex<Vec<(ScheduleStats, Weak<dyn Audience>)>>,
    version: Mutex<Option<Version>>,
    /// Handles that wait for the driver to close.
    closing: AtomicUsize,
}

/// The streams of a schedule, which may all be gone before the driver notices.
pub(crate) trait Audience: Send + Sync + std::fmt::Debug {
    /// Returns whether a stream is left.
    fn is_present(&self) -> bool;
}

impl Telemetry {
    pub(crate) fn new() -> Self {
        Self {
            state: watch::Sender::new(State::Connecting { error: None }),
            stats: Mutex::default(),
            schedules: Mutex::default(),
            version: Mutex::default(),
            closing: AtomicUsize::new(0),
        }
    }

    pub(crate) fn watch(&self) -> watch::Receiver<State> {
        self.state.subscribe()
    }

    /// Enters a state; one line of log for each.
    pub(crate) fn enter(&self, state: State) {
        match &state {
            State::Connecting { error: Some(error) } => {
                tracing::debug!(%error, "waiting for the sensor");
            }
            State::Connecting { error: None } => tracing::debug!("looking for the sensor"),
            State::Connected { baud_rate, streaming, serial_number } => {
                let baud_rate = baud_rate.map(u32::from);
                tracing::info!(baud_rate, streaming, %serial_number, "connected");
            }
            State::Recovering => tracing::warn!("the sensor is silent: looking for it"),
            State::Disconnected { error, .. } => tracing::warn!(%error, "disconnected"),
            State::Closed { error: Some(error) } => tracing::error!(%error, "the driver has ended"),
            State::Closed { error: None } => tracing::debug!("closed"),
        }
        if matches!(state, State::Disconnected { .. } | State::Closed { .. }) {
            *lock(&self.version) = None;
        }
        self.state.send_replace(state);
    }

    /// Notes the speed after a change of it.
    pub(crate) fn set_baud_rate(&self, now: Option<BaudRate>) {
        self.state.send_if_modified(|state| match state {
            State::Connected { baud_rate, .. } if *baud_rate != now => {
                *baud_rate = now;
                true
            }
            _ => false,
        });
    }

    /// Notes whether scans are polled, if that is news.
    pub(crate) fn set_streaming(&self, now: bool) {
        self.state.send_if_modified(|state| match state {
            State::Connected { streaming, .. } if *streaming != now => {
                *streaming = now;
                true
            }
            _ => false,
        });
    }

    /// The error that calls get once the driver has ended.
    pub(crate) fn cause(&self) -> Error {
        match &*self.state.borrow() {
            State::Closed { error: Some(error) } => error.clone(),
            _ => Error::Closed,
        }
    }

    pub(crate) fn is_closed(&self) -> bool {
        matches!(&*self.state.borrow(), State::Closed { .. })
    }

    pub(crate) fn stats(&self) -> MutexGuard<'_, Stats> {
        lock(&self.stats)
    }

    /// Returns a copy of the counters, with the schedules that have a stream.
    pub(crate) fn snapshot(&self) -> Stats {
        let mut stats = self.stats().clone();
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

    /// Notes that the driver is asked to close, as long as the guard lives.
    pub(crate) fn closing(&self) -> Closing<'_> {
        self.closing.fetch_add(1, Ordering::Relaxed);
        Closing(&self.closing)
    }

    /// Returns whether the driver is asked to close: a sensor that does not answer
    /// gets no further chance.
    pub(crate) fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed) > 0
    }

    pub(crate) fn version(&self) -> Option<Version> {
        lock(&self.version).clone()
    }

    pub(crate) fn set_version(&self, version: Version) {
        *lock(&self.version) = Some(version);
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
