//! [`LeftOut`]: messages that were read and are no scan of the stream, counted by reason.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex};

use serde::Serialize;

use super::lock;

/// Number of messages that were left out for one reason. `Display` writes it in words, such as
/// `50 scans of another window (the first: steps 100..=400)`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct LeftOut {
    /// Why they were left out.
    pub reason: LeftOutReason,
    /// Number of messages.
    pub messages: u64,
    /// Details of the first one.
    pub first: String,
}

/// Why a message was left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LeftOutReason {
    /// Scan of another window than the stream's.
    OtherWindow,
    /// Scan whose directions are not steps of a sensor, or in a replay one of another sensor.
    OtherLaser,
    /// The message ends before its fields do, or a field is malformed.
    Malformed,
    /// The message is compressed.
    Compressed,
    /// Message of ROS 1.
    Ros1,
    /// The message is not CDR, or is XCDR2 with another layout.
    OtherEncoding,
    /// Message of another type than the topic's.
    OtherType,
    /// The sensor refused the poll, or its reply was malformed.
    FailedPoll,
    /// Scan on another topic.
    OtherTopic,
    /// Reply to a request of another stream or task.
    OtherRequest,
}

impl LeftOutReason {
    /// Returns true for messages that do not belong to the stream anyway.
    pub fn is_expected(self) -> bool {
        matches!(self, Self::OtherTopic | Self::OtherRequest)
    }

    /// What one message is called, and why it was left out.
    fn words(self) -> &'static str {
        match self {
            Self::OtherWindow => "scan of another window",
            Self::OtherLaser => "scan of another laser scanner",
            Self::Malformed => "message cut short or malformed",
            // Only the description of their bag, in its folder, tells that they are compressed.
            Self::Compressed => {
                "message that `rosbags-convert --src FOLDER --dst OTHER --dst-storage mcap` decompresses"
            }
            Self::Ros1 => "message of ROS 1, whose bag `rosbags-convert` converts",
            Self::OtherEncoding => "message in another encoding",
            Self::OtherType => "message of another type",
            Self::FailedPoll => "poll refused, or with a malformed reply",
            Self::OtherTopic => "scan on another topic",
            Self::OtherRequest => "answer to another request",
        }
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { reason, messages, first } = self;
        let (what, why) = reason.words().split_once(' ').unwrap_or_default();
        match messages {
            1 => write!(f, "1 {what} {why} ({first})"),
            _ => write!(f, "{messages} {what}s {why} (the first: {first})"),
        }
    }
}

/// Counter of the messages that the readers of one recording leave out. Clones share the counts,
/// which grow while the recording is read or replayed.
#[derive(Debug, Clone, Default)]
pub struct LeftOutCounter(Arc<Mutex<BTreeMap<LeftOutReason, LeftOut>>>);

impl LeftOutCounter {
    /// Returns the counts so far, one for each reason.
    pub fn counts(&self) -> Vec<LeftOut> {
        lock(&self.0).values().cloned().collect()
    }

    pub(super) fn add(&self, reason: LeftOutReason, details: impl fmt::Display) {
        let first = || LeftOut { reason, messages: 0, first: details.to_string() };
        lock(&self.0).entry(reason).or_insert_with(first).messages += 1;
    }
}

/// Lists counts in one line, each after a separator.
pub(super) fn listed(counts: &[LeftOut]) -> String {
    counts.iter().map(|count| format!("; {count}")).collect()
}
