//! [`RawReply`]: what a sensor sent, byte by byte, for those who want to keep it.

use std::fmt;
use std::sync::Arc;
use std::time::SystemTime;

use tokio::time::Instant;

use crate::protocol::Command;

/// A frame that came from the sensor while something was asked of it, as
/// [`SensorBuilder::on_reply`](crate::SensorBuilder::on_reply) gets it. What comes at other
/// times is thrown away as it comes, before it is a frame.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct RawReply<'a> {
    /// The command that it answers, well or badly (a reply may be damaged), or
    /// `None` for the reply to a fence and for what was not asked for.
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

/// Who listens, if anybody does.
#[derive(Clone, Default)]
pub(crate) struct ReplyObserver(Option<Arc<Listener>>);

type Listener = dyn Fn(RawReply<'_>) + Send + Sync;

impl ReplyObserver {
    pub(crate) fn new(observer: impl Fn(RawReply<'_>) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(observer)))
    }

    /// Whether anybody listens.
    pub(crate) fn is_some(&self) -> bool {
        self.0.is_some()
    }

    /// Tells what was reply, which is made only if somebody listens.
    pub(crate) fn observe<'a>(&self, reply: impl FnOnce() -> RawReply<'a>) {
        if let Some(observer) = &self.0 {
            observer(reply());
        }
    }
}

impl fmt::Debug for ReplyObserver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ReplyObserver").field(&self.is_some()).finish()
    }
}
