//! [`Telemetry`]: the state, the counters and the identity of the sensor, written by
//! the driver and read by its handles.

use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, SystemTime};

use tokio::sync::watch;
use tokio::time::Instant;

use super::link_log::LinkLog;
use super::{Freshness, State, StateWatch};
use crate::protocol::Version;
use crate::ring::Ring;
use crate::stats::{ScheduleStats, Stats};
use crate::{BaudRate, Error, ErrorKind};

/// A driver that waits for its sensor repeats each reason in the log after this time.
const WAITING_INTERVAL: Duration = Duration::from_secs(600);

#[derive(Debug)]
pub(crate) struct Telemetry {
    name: Option<Arc<str>>,
    state: watch::Sender<State>,
    counters: Mutex<Counters>,
    schedules: Mutex<Vec<(ScheduleStats, Weak<Ring>)>>,
    version: Mutex<Option<VersionReply>>,
    link_log: Mutex<LinkLog>,
    /// Shared with each handle that waits for the driver to close.
    closing: Arc<()>,
    polls: AtomicU64,
}

/// Reply to `V`: parsed, and as received.
#[derive(Debug, Clone)]
pub(crate) struct VersionReply {
    pub(crate) version: Version,
    /// Bytes without the terminator.
    pub(crate) frame: Arc<[u8]>,
    pub(crate) received_at: Instant,
    /// Wall clock when the first byte arrived.
    pub(crate) stamp: SystemTime,
}

/// [`Stats`] and [`Freshness`], which change together.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    stats: Stats,
    last_scan: Option<Instant>,
    /// Latest error since the last scan.
    error: Option<Error>,
    /// Why there is no link.
    link_error: Option<Error>,
    /// True while the laser is switched off by request.
    is_laser_off: bool,
}

impl Telemetry {
    pub(crate) fn new(name: Option<Arc<str>>) -> Self {
        Self {
            name,
            state: watch::Sender::new(State::Connecting { error: None }),
            counters: Mutex::default(),
            version: Mutex::default(),
            schedules: Mutex::default(),
            link_log: Mutex::default(),
            closing: Arc::default(),
            polls: AtomicU64::new(0),
        }
    }

    /// Creates an error with the name of the sensor. Every error of a driver is made here.
    pub(crate) fn error(&self, kind: ErrorKind) -> Error {
        Error::new(kind, self.name.as_ref())
    }

    pub(crate) fn watch(&self) -> StateWatch {
        StateWatch::new(self.state.subscribe(), self.name.clone())
    }

    /// Enters a state, and logs it. Does nothing if an attempt failed for the same reason as
    /// the previous one.
    pub(crate) fn enter(&self, state: State) {
        self.log(&state);
        let link_error = match &state {
            State::Connecting { error } => error.clone(),
            State::Disconnected { error, .. } => Some(error.clone()),
            State::Closed { error } => {
                Some(error.clone().unwrap_or_else(|| self.error(ErrorKind::Closed)))
            }
            State::Connected { .. } | State::Recovering => None,
        };
        let mut counters = self.stats();
        if link_error.is_some() {
            counters.error.clone_from(&link_error);
        }
        counters.link_error = link_error;
        drop(counters);
        if matches!(state, State::Disconnected { .. } | State::Closed { .. }) {
            *lock(&self.version) = None;
        }
        // Only changes may wake watchers, and a user may hold a borrow.
        let is_news = !is_same(&self.state.borrow(), &state);
        if is_news {
            self.state.send_replace(state);
        }
    }

    fn log(&self, state: &State) {
        let mut link_log = lock(&self.link_log);
        match state {
            State::Connecting { error: Some(error) } => {
                if link_log.is_due(error, WAITING_INTERVAL) {
                    tracing::info!(error = %error.chain(), "waiting for the sensor");
                }
            }
            State::Connecting { error: None } => tracing::debug!("searching for the sensor"),
            State::Connected { baud_rate, streaming, serial_number } => {
                let baud_rate = baud_rate.map(u32::from);
                match link_log.connect() {
                    true => tracing::info!(baud_rate, streaming, %serial_number, "connected"),
                    false => tracing::debug!(baud_rate, streaming, %serial_number, "connected"),
                }
            }
            State::Recovering => match link_log.lose() {
                true => {
                    let losses = link_log.losses();
                    tracing::warn!(losses, "the sensor does not answer: searching for it");
                }
                false => tracing::debug!("the sensor does not answer: searching for it"),
            },
            State::Disconnected { error, .. } => {
                let is_logged = link_log.lose();
                if link_log.is_due(error, Duration::MAX) {
                    let error = error.chain();
                    match is_logged {
                        true => {
                            tracing::warn!(%error, losses = link_log.losses(), "disconnected");
                        }
                        false => tracing::debug!(%error, "disconnected"),
                    }
                }
            }
            State::Closed { error: Some(error) } => {
                tracing::error!(error = %error.chain(), "the driver has ended");
            }
            State::Closed { error: None } => tracing::debug!("closed"),
        }
    }

    /// Records a changed baud rate.
    pub(crate) fn set_baud_rate(&self, now: Option<BaudRate>) {
        self.state.send_if_modified(|state| match state {
            State::Connected { baud_rate, .. } => std::mem::replace(baud_rate, now) != now,
            _ => false,
        });
    }

    /// Records whether scans are polled. Wakes watchers only on a change.
    pub(crate) fn set_streaming(&self, now: bool) {
        self.state.send_if_modified(|state| match state {
            State::Connected { streaming, .. } => std::mem::replace(streaming, now) != now,
            _ => false,
        });
    }

    /// Error of calls after the driver has ended.
    pub(crate) fn cause(&self) -> Error {
        match &*self.state.borrow() {
            State::Closed { error: Some(error) } => error.clone(),
            _ => self.error(ErrorKind::Closed),
        }
    }

    /// Waits until the driver has ended, and returns the error of later calls.
    pub(crate) async fn closed(&self) -> Error {
        let is_closed = |state: &State| matches!(state, State::Closed { .. });
        // Fails only without a sender, and `self` owns it.
        let _ = self.state.subscribe().wait_for(is_closed).await.map(drop);
        self.cause()
    }

    pub(crate) fn is_closed(&self) -> bool {
        matches!(&*self.state.borrow(), State::Closed { .. })
    }

    pub(crate) fn stats(&self) -> MutexGuard<'_, Counters> {
        lock(&self.counters)
    }

    /// Copies the counters, with the schedules that have a stream.
    pub(crate) fn snapshot(&self) -> Stats {
        let mut stats = self.stats().stats.clone();
        stats.polls = self.polls.load(Ordering::Relaxed);
        // The streams may all be gone before the driver notices.
        let is_read = |ring: &Weak<Ring>| ring.upgrade().is_some_and(|ring| ring.readers() > 0);
        let schedules = lock(&self.schedules);
        let read = schedules.iter().filter(|(_, ring)| is_read(ring));
        stats.schedules.extend(read.map(|(schedule, _)| *schedule));
        stats
    }

    /// Replaces the schedules, in place and without allocating.
    pub(crate) fn set_schedules(
        &self,
        schedules: impl Iterator<Item = (ScheduleStats, Weak<Ring>)>,
    ) {
        let mut noted = lock(&self.schedules);
        noted.clear();
        noted.extend(schedules);
    }

    /// Counts a poll, without a lock.
    pub(crate) fn count_poll(&self) {
        self.polls.fetch_add(1, Ordering::Relaxed);
    }

    /// Announces that the driver is closing, until the guard is dropped.
    pub(crate) fn closing(&self) -> Arc<()> {
        Arc::clone(&self.closing)
    }

    /// Returns true while the driver is closing. A silent sensor then gets no second try.
    pub(crate) fn is_closing(&self) -> bool {
        Arc::strong_count(&self.closing) > 1
    }

    /// Records whether the laser is switched off by request.
    pub(crate) fn set_laser_off(&self, is_off: bool) {
        self.stats().is_laser_off = is_off;
    }

    /// Records why a poll has no scan.
    pub(crate) fn fail(&self, kind: ErrorKind) {
        self.stats().error = Some(self.error(kind));
    }

    /// Freshness of all scans.
    pub(crate) fn freshness(&self) -> Freshness {
        let reason = self.pause_reason();
        let counters = self.stats();
        Freshness::new(counters.last_scan, reason.or_else(|| counters.error.clone()))
    }

    /// Why nothing is polled now, if so.
    pub(crate) fn pause_reason(&self) -> Option<Error> {
        let counters = self.stats();
        let laser_off = || counters.is_laser_off.then(|| self.error(ErrorKind::LaserOff));
        counters.link_error.clone().or_else(laser_off)
    }

    /// Why there is no link. While none of the attempts has failed yet, the sensor is silent.
    pub(crate) fn link_error(&self) -> ErrorKind {
        let no_answer =
            ErrorKind::NoAnswer { baud_rate: None, searched: false, bytes: 0, words: None };
        self.stats().link_error.as_ref().map_or(no_answer, |error| error.kind().clone())
    }

    pub(crate) fn version(&self) -> Option<Version> {
        self.version_reply().map(|reply| reply.version)
    }

    pub(crate) fn version_reply(&self) -> Option<VersionReply> {
        lock(&self.version).clone()
    }

    pub(crate) fn set_version(&self, reply: VersionReply) {
        *lock(&self.version) = Some(reply);
    }
}

/// Returns true if there still is no link, for the same reason.
fn is_same(before: &State, now: &State) -> bool {
    let text = |error: &Error| error.chain().to_string();
    match (before, now) {
        (State::Connecting { error: before }, State::Connecting { error: now }) => {
            before.as_ref().map(text) == now.as_ref().map(text)
        }
        (
            State::Disconnected { since: before, error: last },
            State::Disconnected { since, error },
        ) => before == since && text(last) == text(error),
        _ => false,
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

#[inline(never)]
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Counters and plain values: always consistent.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
