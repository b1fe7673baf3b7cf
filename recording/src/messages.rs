//! [`Messages`]: what the messages of a file mean. Knows the topic of each channel. Reading
//! and repairing agree because this is the only judge of a message.

use std::collections::HashMap;
use std::time::{Duration, SystemTime};

use super::mcap::{Fields, MessageHeader, kind};
use super::record::{Entry, Record, RecordedReply, parse_command};
use super::topics::Topic;
use crate::event::Event;
use crate::ros;

/// Message types and channels defined up to a position in a file.
#[derive(Debug, Default)]
pub(super) struct Messages {
    /// Name of each message type, if recordings use it.
    types: HashMap<u16, Option<&'static str>>,
    /// Message type and topic of each channel, or no topic if recordings do not have it.
    channels: HashMap<u16, (u16, Option<Topic>)>,
}

/// Message that is malformed, or whose channel is not defined.
#[derive(Debug)]
pub(super) struct InvalidMessage;

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
        let (id, schema, topic) = parse_channel(content)?;
        self.channels.insert(id, (schema, topic));
        Some(())
    }

    /// Returns the topic of a channel, or `None` if recordings do not have it. The types are looked
    /// up for each message, since a damaged file may define one again: then it makes no difference
    /// whether a channel is repeated, and a repaired file does not repeat any.
    fn topic(&self, channel: u16) -> Result<Option<Topic>, InvalidMessage> {
        let (schema, topic) = self.channels.get(&channel).ok_or(InvalidMessage)?;
        // Number 0 stands for no type. If a type was lost with a damaged part, assume the topic's own
        // type where the number is the one that recordings give it: a repaired file defines these,
        // and no others.
        Ok(topic.filter(|topic| match self.types.get(schema) {
            Some(name) => *name == Some(topic.message_type().name()),
            None => *schema == 0 || *schema == topic.schema(),
        }))
    }

    /// Defines the message type of a topic. Returns false if its number has a type already.
    pub(super) fn add_type(&mut self, schema: u16, topic: Topic) -> bool {
        let is_new = !self.types.contains_key(&schema);
        self.types.entry(schema).or_insert(Some(topic.message_type().name()));
        is_new
    }

    /// Parses the content of a message. Returns `None` for a topic that recordings do not
    /// have.
    pub(super) fn parse(&self, content: &[u8]) -> Result<Option<Record>, InvalidMessage> {
        let (header, data) = MessageHeader::parse(content).ok_or(InvalidMessage)?;
        let Some(topic) = self.topic(header.channel)? else { return Ok(None) };
        let entry = parse_entry(topic, header, data).ok_or(InvalidMessage)?;
        let (at, sequence) = (time(header.log_time), header.sequence);
        Ok(Some(Record { at, sequence, entry }))
    }
}

/// Parses a channel: its number, its message type's number, and the topic of a recording
/// that its name and encoding stand for.
pub(super) fn parse_channel(content: &[u8]) -> Option<(u16, u16, Option<Topic>)> {
    let mut fields = Fields(content);
    let (id, schema) = (fields.u16()?, fields.u16()?);
    let (name, encoding) = (fields.bytes()?, fields.bytes()?);
    let named = |topic: &Topic| topic.name().as_bytes() == name && encoding == b"cdr";
    Some((id, schema, Topic::ALL.into_iter().find(named)))
}

fn parse_entry(topic: Topic, header: MessageHeader, data: &[u8]) -> Option<Entry> {
    Some(match topic {
        Topic::Scans => Entry::Scan(ros::read_scan(data)?),
        Topic::Events => Entry::Event(Event::from(ros::read_text(data)?)),
        Topic::Replies => {
            let (command, bytes) = ros::read_labelled_bytes(data)?;
            let (command, bytes) = (parse_command(command), bytes.to_vec());
            Entry::Reply(RecordedReply { command, bytes, stamp: time(header.publish_time) })
        }
    })
}

fn time(nanos: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Content of a record that begins with numbers, followed by texts.
    fn content(numbers: &[u16], texts: [&str; 3]) -> Vec<u8> {
        let mut content: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        for text in texts {
            content.extend((text.len() as u32).to_le_bytes());
            content.extend(text.as_bytes());
        }
        content
    }

    fn channel(schema: u16) -> Vec<u8> {
        content(&[0, schema], [Topic::Events.name(), "cdr", ""])
    }

    #[test]
    fn a_channel_whose_type_was_lost_has_the_number_that_recordings_give_its_type() {
        for (schema, is_known) in [(Topic::Events.schema(), true), (Topic::Scans.schema(), false)] {
            let mut messages = Messages::default();
            messages.define(kind::CHANNEL, &channel(schema));
            assert_eq!(messages.topic(0).unwrap().is_some(), is_known);
        }
    }

    #[test]
    fn a_type_that_is_defined_again_counts_whether_or_not_its_channels_are_repeated() {
        for is_repeated in [false, true] {
            let mut messages = Messages::default();
            for (name, is_known) in [("std_msgs/msg/String", true), ("std_msgs/msg/Header", false)]
            {
                messages.define(kind::SCHEMA, &content(&[5], [name, "ros2msg", ""]));
                if is_known || is_repeated {
                    messages.define(kind::CHANNEL, &channel(5));
                }
                assert_eq!(messages.topic(0).unwrap().is_some(), is_known, "{name}");
            }
        }
    }
}
