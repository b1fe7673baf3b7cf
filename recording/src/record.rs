//! [`Record`]: one message of a recording.

use std::sync::Arc;
use std::time::SystemTime;

use super::reply::RecordedReply;
use crate::event::Event;
use crate::ros::LaserScan;

/// One recorded message.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Record {
    /// When it happened: the wall clock at the start of the recording, continued by a
    /// steady clock, which is never set.
    pub at: SystemTime,
    /// Publish time: for a recorded scan or reply, its stamp.
    pub(super) stamp: SystemTime,
    /// Topic of a scan if it is not `/scan`.
    pub(super) topic: Option<Arc<str>>,
    /// Number among the records of its kind. For a scan, its number in its schedule.
    pub sequence: u32,
    /// Content.
    pub entry: Entry,
}

/// Content of a [`Record`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Entry {
    /// Scan that the stream delivered.
    Scan(LaserScan),
    /// Reply of the sensor.
    Reply(RecordedReply),
    /// Other event.
    Event(Event),
}
