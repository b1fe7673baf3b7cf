//! State shared by the handles to one emulated sensor and its links.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::task::Waker;

use tokio::sync::Notify;
use tokio::time::Instant;

use super::timed_device::TimedDevice;

#[derive(Debug)]
pub(super) struct Shared {
    plugged: Mutex<Plugged>,
    /// Notified when a link is opened or the cable is pulled or put back.
    pub(super) link_changed: Notify,
}

/// Sensor, and what is plugged into it.
#[derive(Debug)]
pub(super) struct Plugged {
    pub(super) sensor: TimedDevice,
    pub(super) plugged_in: bool,
    /// Id of the open link.
    pub(super) link: Option<u64>,
    /// Number of links opened so far.
    pub(super) links: u64,
    /// Baud rate of the host's end when it was last used.
    pub(super) host: Option<u32>,
    /// Task that waits for bytes from the sensor.
    pub(super) reader: Option<Waker>,
}

impl Plugged {
    /// Sets the baud rate of the host's end. The bytes so far arrived at the one before.
    pub(super) fn set_host(&mut self, host: Option<u32>) -> Instant {
        let now = Instant::now();
        self.sensor.advance(now, self.host);
        if host != self.host {
            self.sensor.transmitter.retune(now);
        }
        self.host = host;
        now
    }
}

impl Shared {
    pub(super) fn new(sensor: TimedDevice) -> Self {
        let plugged =
            Plugged { sensor, plugged_in: true, link: None, links: 0, host: None, reader: None };
        Self { plugged: Mutex::new(plugged), link_changed: Notify::new() }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Plugged> {
        // Only the user's `World` can panic under the lock. It is called before a
        // reply is queued, so that the sensor stays consistent.
        self.plugged.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Unlocks the sensor, and wakes the reader, which may have found no event to wait for.
    pub(super) fn wake_reader(mut plugged: MutexGuard<'_, Plugged>) {
        let reader = plugged.reader.take();
        drop(plugged);
        if let Some(reader) = reader {
            reader.wake();
        }
    }

    /// Locks the sensor, brought up to date.
    pub(super) fn lock_now(&self) -> MutexGuard<'_, Plugged> {
        let mut plugged = self.lock();
        let host = plugged.host;
        plugged.sensor.advance(Instant::now(), host);
        plugged
    }

    /// Waits until `condition` holds.
    pub(super) async fn wait_until(&self, condition: impl Fn(&Plugged) -> bool) {
        loop {
            // Created before the check, so that a notification between the two is not
            // lost.
            let notified = self.link_changed.notified();
            if condition(&self.lock()) {
                return;
            }
            notified.await;
        }
    }
}
