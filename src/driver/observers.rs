//! [`RawReply`]: a frame as the sensor sent it. [`ReplyObservers`]: what receives each. Handles add to
//! the list and remove from it while the driver runs.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::SystemTime;

use tokio::time::Instant;

use crate::protocol::{Command, Protocol, scip2};

/// Frame that the sensor sent after a command. The observers of
/// [`SensorBuilder::on_reply`](crate::SensorBuilder::on_reply) and
/// [`Sensor::observe_replies`](crate::Sensor::observe_replies) receive it. Bytes that
/// arrive at other times are dropped and form no frame.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct RawReply<'a> {
    /// Protocol that the sensor speaks.
    pub protocol: Protocol,
    /// Command of SCIP 1.1 that the frame answers, even if the reply is malformed. `None` for the
    /// reply to a fence and for a frame with another echo.
    pub command: Option<Command>,
    /// Request of SCIP 2 that the frame answers, even if the reply is malformed. The frame begins with
    /// it, unless an earlier reply was cut short. `None` for the reply to a probe or another request.
    pub request: Option<scip2::Request>,
    /// Bytes as received, without the two LFs at the end and without NULs at the front.
    pub bytes: &'a [u8],
    /// When the last byte was read, on tokio's clock. Equal to the time of its [`Scan`](crate::Scan) to
    /// within microseconds.
    pub received_at: Instant,
    /// Wall clock when the first byte arrived, the same as
    /// [`stamp`](crate::scan::ScanTimes::stamp) of its scan.
    pub stamp: SystemTime,
}

type Observer = dyn Fn(RawReply<'_>) + Send + Sync;
type Observers = Arc<[Arc<Observer>]>;

/// Observers of all replies, in the order of their calls.
#[derive(Default)]
pub(crate) struct ReplyObservers(Mutex<Observers>);

impl ReplyObservers {
    pub(crate) fn add(&self, call: impl Fn(RawReply<'_>) + Send + Sync + 'static) {
        self.add_shared(Arc::new(call));
    }

    /// Adds an observer until the observation is dropped.
    pub(crate) fn observe_until_dropped(
        self: &Arc<Self>,
        call: impl Fn(RawReply<'_>) + Send + Sync + 'static,
    ) -> ReplyObservation {
        let observer: Arc<Observer> = Arc::new(call);
        self.add_shared(Arc::clone(&observer));
        ReplyObservation { observers: Arc::downgrade(self), observer }
    }

    fn add_shared(&self, observer: Arc<Observer>) {
        let mut list = self.locked();
        *list = list.iter().cloned().chain([observer]).collect();
    }

    fn remove(&self, observer: &Arc<Observer>) {
        let mut list = self.locked();
        let others = list.iter().filter(|other| !Arc::ptr_eq(other, observer));
        let others: Observers = others.cloned().collect();
        // Dropped after the lock, because an observer may own an observation.
        let _before = std::mem::replace(&mut *list, others);
        drop(list);
    }

    /// Passes `reply` to each observer.
    pub(crate) fn pass<'a>(&self, reply: impl FnOnce() -> RawReply<'a>) {
        let list = self.locked();
        if !list.is_empty() {
            let shared = Arc::clone(&list);
            // Called without the lock, so that an observer may add and remove others.
            drop(list);
            call(&shared, reply());
        }
    }

    fn locked(&self) -> MutexGuard<'_, Observers> {
        // No code that holds the lock can panic.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cold]
fn call(list: &[Arc<Observer>], reply: RawReply<'_>) {
    list.iter().for_each(|observer| observer(reply));
}

/// Copies the list: what is added to the clone is not added to the original.
impl Clone for ReplyObservers {
    fn clone(&self) -> Self {
        Self(Mutex::new(Arc::clone(&*self.locked())))
    }
}

impl fmt::Debug for ReplyObservers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ReplyObservers").field(&self.locked().len()).finish()
    }
}

/// Observer added by [`Sensor::observe_replies`](crate::Sensor::observe_replies). Drop it to end the
/// observation. Keeps no driver running.
#[must_use = "dropping an observation ends it"]
pub struct ReplyObservation {
    observers: Weak<ReplyObservers>,
    observer: Arc<Observer>,
}

impl Drop for ReplyObservation {
    fn drop(&mut self) {
        if let Some(observers) = self.observers.upgrade() {
            observers.remove(&self.observer);
        }
    }
}

impl fmt::Debug for ReplyObservation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReplyObservation").finish_non_exhaustive()
    }
}
