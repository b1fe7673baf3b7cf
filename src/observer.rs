//! [`RawReply`]: a frame of the sensor as it came, and the observer that gets it.

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, OnceLock};
use std::time::SystemTime;

use tokio::time::Instant;

use crate::protocol::Command;

/// A frame that came from the sensor after a command, passed to the observer of
/// [`SensorBuilder::on_reply`](crate::SensorBuilder::on_reply). Bytes that come at
/// other times are dropped before they are a frame.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct RawReply<'a> {
    /// The command that it answers, well or badly (a reply may be malformed), or
    /// `None` for the reply to a fence and for a frame with another echo.
    pub command: Option<Command>,
    /// The bytes as they came, without the two LFs that end a frame and without
    /// NULs before it.
    pub bytes: &'a [u8],
    /// The time when its last byte was read, on tokio's clock; the same as that of its
    /// [`Scan`](crate::Scan) to within microseconds.
    pub received_at: Instant,
    /// The wall clock when its first byte arrived, the same as
    /// [`Scan::stamp`](crate::Scan::stamp).
    pub stamp: SystemTime,
}

/// The observer of all replies, if there is one.
#[derive(Clone, Default)]
pub(crate) struct ReplyObserver(Option<Arc<Observer>>);

struct Observer {
    call: Box<dyn Fn(RawReply<'_>) + Send + Sync>,
    /// The message of its panic, which ends the driver.
    panic: OnceLock<String>,
}

impl ReplyObserver {
    pub(crate) fn new(call: impl Fn(RawReply<'_>) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(Observer { call: Box::new(call), panic: OnceLock::new() })))
    }

    /// Passes `reply` on, which is built only if there is an observer.
    pub(crate) fn observe<'a>(&self, reply: impl FnOnce() -> RawReply<'a>) {
        let Some(observer) = &self.0 else { return };
        // Nothing of the observer is used again after its panic.
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| (observer.call)(reply()))) {
            let _ = observer.panic.set(message(&*panic));
            resume_unwind(panic)
        }
    }

    /// Returns the message with which the observer has panicked.
    pub(crate) fn panic_message(&self) -> Option<String> {
        self.0.as_ref()?.panic.get().cloned()
    }
}

/// Returns the message of a panic.
fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("no message").to_owned()
}

impl fmt::Debug for ReplyObserver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ReplyObserver").field(&self.0.is_some()).finish()
    }
}
