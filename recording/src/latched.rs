//! [`Latched`]: messages of latched topics before a part of a recording. Whoever subscribes late
//! gets the last message of such a topic, so the part begins with it.

use std::collections::{BTreeSet, HashMap};
use std::rc::Rc;
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
        let profiles = channel.metadata("offered_qos_profiles")?;
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
            has_frames: channel.schema.is_some_and(|name| MessageType::TF_MESSAGE.is_named(name)),
        })
    }
}

#[derive(Debug, Default)]
pub(super) struct Latched {
    /// Last message of each topic and frame. Frames share a message that has several.
    last: HashMap<(LatchedTopic, String), Rc<LatchedMessage>>,
    next: u64,
    bytes: usize,
}

#[derive(Debug)]
pub(super) struct LatchedMessage {
    number: u64,
    pub(super) header: MessageHeader,
    pub(super) data: Vec<u8>,
    /// Set if it is one of a recording's own.
    pub(super) record: Option<Record>,
}

impl LatchedMessage {
    fn bytes(&self) -> usize {
        self.data.len() * (1 + usize::from(self.record.is_some()))
    }
}

impl Latched {
    /// Keeps a message in place of earlier ones. Returns false if there is no room for it.
    pub(super) fn keep(
        &mut self,
        topic: &LatchedTopic,
        header: MessageHeader,
        data: &[u8],
        record: Option<Record>,
    ) -> bool {
        let frames = child_frames(data).filter(|_| topic.has_frames);
        let frames: BTreeSet<_> = frames.unwrap_or_else(|| vec![""]).into_iter().collect();
        let number = self.next;
        let message = LatchedMessage { number, header, data: data.to_vec(), record };
        let frame_bytes = (self.last.len() + frames.len()) * FRAME_BYTES;
        if self.bytes + message.bytes() + frame_bytes > MAX_LATCHED_BYTES {
            return false;
        }
        self.next += 1;
        self.bytes += message.bytes();
        let message = Rc::new(message);
        for frame in frames {
            let frame = (topic.clone(), frame.to_owned());
            let last = self.last.get(&frame).map(|last| last.header.log_time);
            if last.is_none_or(|last| last <= header.log_time) {
                let earlier = self.last.insert(frame, Rc::clone(&message));
                earlier.into_iter().for_each(|earlier| self.release(earlier));
            }
        }
        self.release(message);
        true
    }

    /// Frees a message that no frame has any more.
    fn release(&mut self, message: Rc<LatchedMessage>) {
        self.bytes -= Rc::into_inner(message).map_or(0, |message| message.bytes());
    }

    /// Returns the messages in the order of their times.
    pub(super) fn into_messages(self) -> impl Iterator<Item = LatchedMessage> {
        let mut messages: Vec<_> = self.last.into_values().collect();
        messages.sort_by_key(|message| (message.header.log_time, message.number));
        messages.dedup_by_key(|message| message.number);
        messages.into_iter().filter_map(Rc::into_inner)
    }
}
