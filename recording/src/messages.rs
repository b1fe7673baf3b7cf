//! [`Messages`]: what the messages of a file mean. Knows the topic of each channel.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::mcap::{self, Fields, MessageHeader, kind};
use super::record::{Entry, Record, RecordedReply, parse_command};
use super::topics::Topic;
use crate::event::Event;
use crate::ros;

/// Longest name of a topic of ROS 2.
const MAX_NAME_BYTES: usize = 255;

/// Message types and channels defined up to a position in a file.
#[derive(Debug, Default)]
pub(super) struct Messages {
    /// Name of each message type, if recordings use it.
    types: HashMap<u16, Option<&'static str>>,
    channels: HashMap<u16, Channel>,
}

#[derive(Debug)]
struct Channel {
    schema: u16,
    /// `None` if recordings do not have the topic.
    topic: Option<Topic>,
    /// Name of the topic if its messages are CDR, else empty.
    name: Arc<str>,
}

impl Messages {
    /// Remembers a well-formed record that defines a message type or a channel.
    pub(super) fn define(&mut self, kind: u8, content: &[u8]) {
        match kind {
            kind::SCHEMA => drop(self.define_type(content)),
            kind::CHANNEL => drop(self.define_channel(content)),
            _ => {}
        }
    }

    fn define_type(&mut self, content: &[u8]) -> Option<()> {
        let mut fields = Fields(content);
        let (id, name) = (fields.u16()?, fields.bytes()?);
        let known = Topic::ALL.map(|topic| topic.message_type().name());
        self.types.insert(id, known.into_iter().find(|known| known.as_bytes() == name));
        Some(())
    }

    fn define_channel(&mut self, content: &[u8]) -> Option<()> {
        let mut fields = Fields(content);
        let (id, schema) = (fields.u16()?, fields.u16()?);
        let (name, encoding) = (fields.string()?, fields.bytes()?);
        // Other names and encodings are not of ROS.
        let name = Some(name).filter(|name| name.len() <= MAX_NAME_BYTES && encoding == b"cdr");
        let topic = Topic::ALL.into_iter().find(|topic| Some(topic.name()) == name);
        self.channels.insert(id, Channel { schema, topic, name: name.unwrap_or_default().into() });
        Some(())
    }

    /// Returns the topic of a channel, or `None` if recordings do not have it. Scans may be on any
    /// topic. The types are looked up for each message, since a damaged file may define one again:
    /// then it makes no difference whether a channel is repeated.
    fn topic(&self, channel: &Channel) -> Option<Topic> {
        let kind = self.types.get(&channel.schema);
        let is_a = |topic: &Topic| kind == Some(&Some(topic.message_type().name()));
        match channel.topic {
            // Without a type, or if it was lost with a damaged part, assume the topic's own.
            Some(topic) => Some(topic).filter(|topic| kind.is_none() || is_a(topic)),
            None if channel.name.is_empty() => None,
            None => Some(Topic::Scans).filter(is_a),
        }
    }

    /// Parses the content of a message. Returns `None` for a topic that recordings do not
    /// have, and for a message in another form, such as a compressed one.
    pub(super) fn parse(&self, content: &[u8]) -> Option<Record> {
        let (header, data) = MessageHeader::parse(content)?;
        let channel = self.channels.get(&header.channel)?;
        let (at, stamp) = (time(header.log_time), time(header.publish_time));
        let (sequence, topic) = (header.sequence, channel.topic.is_none());
        let topic = topic.then(|| Arc::clone(&channel.name));
        let entry = parse_entry(self.topic(channel)?, stamp, data)?;
        Some(Record { at, stamp, topic, sequence, entry })
    }
}

/// Encodes the type of a channel whose schema was lost, as after its number. `content` is that of
/// the channel after its number. Returns `None` for a channel that recordings do not have.
pub(super) fn lost_schema(channel: u16, content: &[u8]) -> Option<Vec<u8>> {
    let known = own_topic(channel, content)?.message_type();
    Some(mcap::schema(known.name(), known.definition()))
}

/// Topic of a channel as recordings of this crate have it. `content` follows its number.
fn own_topic(channel: u16, content: &[u8]) -> Option<Topic> {
    let own = |topic: &Topic| {
        topic.channel() == channel && mcap::channel(topic.schema(), topic.name()) == content
    };
    Topic::ALL.into_iter().find(own)
}

fn parse_entry(topic: Topic, stamp: SystemTime, data: &[u8]) -> Option<Entry> {
    Some(match topic {
        Topic::Scans => Entry::Scan(ros::read_scan(data).ok()?),
        Topic::Events => Entry::Event(Event::from(ros::read_text(data).ok()?)),
        Topic::Replies => {
            let (command, bytes) = ros::read_labelled_bytes(data).ok()?;
            let (command, bytes) = (parse_command(command), bytes.to_vec());
            Entry::Reply(RecordedReply { command, bytes, stamp })
        }
    })
}

/// Converts from the form in files.
pub(super) fn time(nanos: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}
