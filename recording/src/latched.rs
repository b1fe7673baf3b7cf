//! [`Latched`]: messages of latched topics before a part of a recording. Whoever subscribes late
//! gets the last message of such a topic, so the part begins with it.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use super::mcap::{Channel, MessageHeader};
use super::record::Record;
use crate::ros::{MessageType, child_frames};

/// Bytes of messages to keep in memory.
const MAX_LATCHED_BYTES: usize = 64 << 20;
/// Bytes that a frame takes in memory besides its name.
const FRAME_BYTES: usize = 64;

/// Topic whose last message counts.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct LatchedTopic {
    name: Arc<str>,
    /// True if each message has some frames, and each frame has its last message: `/tf_static` has
    /// several publishers.
    has_frames: bool,
}

impl LatchedTopic {
    /// Returns the topic of a channel if ROS 2 latches it: one of its publishers offers the
    /// durability `transient_local`. rosbag2 writes its number up to Iron, and its name since Jazzy.
    pub(super) fn of_channel(channel: &Channel<'_>) -> Option<Self> {
        let (_, profiles) =
            channel.metadata.iter().find(|(key, _)| *key == "offered_qos_profiles")?;
        let is_latched = profiles.split([',', '\n', '{', '}', '[', ']']).any(|line| {
            let line = line.trim();
            let pair = line.strip_prefix("- ").unwrap_or(line).split_once(':');
            pair.is_some_and(|(key, value)| {
                let value = value.trim().trim_matches(['"', '\'']);
                key.trim() == "durability" && matches!(value, "1" | "transient_local")
            })
        });
        is_latched.then(|| Self {
            name: channel.topic.into(),
            has_frames: channel.schema == Some(MessageType::TF_MESSAGE.name()),
        })
    }
}

/// Last messages of latched topics.
#[derive(Debug, Default)]
pub(super) struct Latched {
    /// Number of the last message of each topic and frame.
    last: HashMap<(LatchedTopic, String), u64>,
    messages: BTreeMap<u64, LatchedMessage>,
    next: u64,
    bytes: usize,
}

#[derive(Debug)]
pub(super) struct LatchedMessage {
    pub(super) header: MessageHeader,
    pub(super) data: Vec<u8>,
    /// Set if it is one of a recording's own.
    pub(super) record: Option<Record>,
    /// Number of frames whose last message it is.
    frames: usize,
}

impl LatchedMessage {
    pub(super) fn new(header: MessageHeader, data: &[u8], record: Option<Record>) -> Self {
        Self { header, data: data.to_vec(), record, frames: 0 }
    }

    fn bytes(&self) -> usize {
        self.data.len() * (1 + usize::from(self.record.is_some()))
    }
}

impl Latched {
    /// Keeps a message in place of earlier ones. Returns false if there is no room for it.
    pub(super) fn keep(&mut self, topic: &LatchedTopic, mut message: LatchedMessage) -> bool {
        let frames = child_frames(&message.data).filter(|_| topic.has_frames);
        let frames: BTreeSet<_> = frames.unwrap_or_else(|| vec![""]).into_iter().collect();
        let frames = frames.into_iter().map(|frame| (topic.clone(), frame.to_owned()));
        let frames: Vec<_> = frames.collect();
        let needed = message.bytes() + frames.len() * FRAME_BYTES;
        if self.bytes + needed > MAX_LATCHED_BYTES {
            return false;
        }
        let number = self.next;
        self.next += 1;
        for frame in frames {
            let last = self.last.entry(frame).or_insert(number);
            if let Some(earlier) = self.messages.get_mut(last) {
                if earlier.header.log_time > message.header.log_time {
                    continue;
                }
                self.bytes -= FRAME_BYTES;
                earlier.frames -= 1;
                if earlier.frames == 0 {
                    self.bytes -= earlier.bytes();
                    self.messages.remove(last);
                }
            }
            *last = number;
            message.frames += 1;
        }
        if message.frames > 0 {
            self.bytes += message.bytes() + message.frames * FRAME_BYTES;
            self.messages.insert(number, message);
        }
        true
    }

    /// Returns the messages in the order of their times.
    pub(super) fn into_messages(self) -> impl Iterator<Item = LatchedMessage> {
        let mut messages: Vec<_> = self.messages.into_values().collect();
        messages.sort_by_key(|message| message.header.log_time);
        messages.into_iter()
    }
}
