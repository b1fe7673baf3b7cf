//! [`Record`]: one message of a recording, on its [`Topic`].

use std::sync::Arc;
use std::time::SystemTime;

use super::reply::RecordedReply;
use crate::event::Event;
use crate::ros::{LaserScan, MessageType};

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

/// Topic of a recording. Each has one channel of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topic {
    /// Scans that the stream delivered.
    Scans,
    /// Replies of the sensor, byte by byte.
    Replies,
    /// Other events, as JSON.
    Events,
}

impl Topic {
    pub(super) const ALL: [Self; 3] = [Self::Scans, Self::Replies, Self::Events];

    /// Number of its channel in the files that this crate writes.
    pub(super) const fn channel(self) -> u16 {
        self as u16
    }

    /// Number of its message type in those files. 0 is reserved for "no type".
    pub(super) const fn schema(self) -> u16 {
        self.channel() + 1
    }

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Scans => "/scan",
            Self::Replies => "/scip/replies",
            Self::Events => "/scip/events",
        }
    }

    pub(super) const fn message_type(self) -> MessageType {
        match self {
            Self::Scans => MessageType::LASER_SCAN,
            Self::Replies => MessageType::LABELLED_BYTES,
            Self::Events => MessageType::TEXT,
        }
    }
}
