//! [`Topic`]: the topics of a recording and their message types.

use crate::ros::MessageType;

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
