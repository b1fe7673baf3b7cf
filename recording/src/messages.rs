//! [`Messages`]: what the messages of a file mean. Knows the topic of each channel.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::left_out::LeftOutReason;
use super::mcap::{self, Fields, MessageHeader, kind};
use super::record::{Entry, Record};
use super::reply::RecordedReply;
use super::topics::Topic;
use crate::event::Event;
use crate::ros::{self, CdrError};

/// Scan of ROS 1, which in ROS 2 has another name and encoding.
const ROS1_SCAN: &str = "sensor_msgs/LaserScan";
/// Longest name of a topic of ROS 2.
const MAX_NAME_BYTES: usize = 255;

/// Message types and channels defined up to a position in a file.
#[derive(Debug, Default)]
pub(super) struct Messages {
    /// Names of the types, or empty if no message of them is read.
    types: HashMap<u16, &'static str>,
    channels: HashMap<u16, Channel>,
}

#[derive(Debug)]
struct Channel {
    schema: u16,
    /// `None` if recordings do not have the topic.
    topic: Option<Topic>,
    /// Name of the topic, or empty if it is none of ROS.
    name: Arc<str>,
    /// Encoding of its messages.
    encoding: Box<[u8]>,
}

/// Message that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Unread {
    pub(super) at: SystemTime,
    /// As in [`Record`].
    pub(super) topic: Option<Arc<str>>,
    pub(super) name: Arc<str>,
    pub(super) reason: LeftOutReason,
    /// What is not right with it, or empty if the reason says all.
    pub(super) details: String,
}

impl Messages {
    /// Remembers a well-formed record that defines a message type or a channel.
    pub(super) fn define(&mut self, kind: u8, content: &[u8]) -> Option<()> {
        let mut fields = Fields(content);
        if kind == kind::SCHEMA {
            let (id, name) = (fields.u16()?, fields.bytes()?);
            let known = Topic::ALL.map(|topic| topic.message_type().name()).into_iter();
            let known = known.chain([ROS1_SCAN]).find(|known| known.as_bytes() == name);
            self.types.insert(id, known.unwrap_or_default());
        } else if kind == kind::CHANNEL {
            let (id, schema) = (fields.u16()?, fields.u16()?);
            let (name, encoding) = (fields.string()?, fields.bytes()?);
            // Other names are not of ROS.
            let name = Some(name).filter(|name| name.len() <= MAX_NAME_BYTES).unwrap_or_default();
            let topic = Topic::ALL.into_iter().find(|topic| topic.name() == name);
            let encoding = encoding.get(..MAX_NAME_BYTES).unwrap_or(encoding).into();
            self.channels.insert(id, Channel { schema, topic, name: name.into(), encoding });
        }
        Some(())
    }

    /// Returns the topic of a channel, or why its messages cannot be read. Scans may be on any topic.
    /// The types are looked up for each message, since a damaged file may define one again: then it
    /// makes no difference whether a channel is repeated.
    fn topic(&self, channel: &Channel) -> Result<Topic, (LeftOutReason, String)> {
        let kind = self.types.get(&channel.schema).copied();
        let is_a = |topic: &Topic| kind == Some(topic.message_type().name());
        let is_ros1 =
            kind == Some(ROS1_SCAN) || channel.topic.is_some() && &*channel.encoding == b"ros1";
        let topic = match channel.topic {
            // Without a type, or if it was lost with a damaged part, assume the topic's own.
            Some(topic) => Some(topic).filter(|topic| kind.is_none() || is_a(topic)),
            None => Some(Topic::Scans).filter(is_a),
        };
        match topic {
            _ if is_ros1 => Err((LeftOutReason::Ros1, String::new())),
            None => Err((LeftOutReason::OtherType, String::new())),
            Some(_) if &*channel.encoding != b"cdr" => {
                let details = channel.encoding.escape_ascii().to_string();
                Err((LeftOutReason::OtherEncoding, details))
            }
            Some(topic) => Ok(topic),
        }
    }

    /// Parses the content of a message. Returns `None` if its topic has no name, or if the file's
    /// reader reports it as damaged.
    pub(super) fn parse(&self, content: &[u8]) -> Option<Result<Record, Unread>> {
        let (header, data) = MessageHeader::parse(content)?;
        let channel = self.channels.get(&header.channel).filter(|one| !one.name.is_empty())?;
        let (at, stamp) = (time(header.log_time), time(header.publish_time));
        let (sequence, topic) = (header.sequence, channel.topic.is_none());
        let topic = topic.then(|| Arc::clone(&channel.name));
        let entry = self.topic(channel).and_then(|topic| {
            parse_entry(topic, stamp, data).map_err(|error| match error {
                CdrError::Malformed => (LeftOutReason::Malformed, format!("{} bytes", data.len())),
                CdrError::Compressed => (LeftOutReason::Compressed, String::new()),
                CdrError::Encoding([first, second]) => {
                    let details = format!("CDR header {first:02x} {second:02x}");
                    (LeftOutReason::OtherEncoding, details)
                }
            })
        });
        Some(match entry {
            Ok(entry) => Ok(Record { at, stamp, topic, sequence, entry }),
            Err((reason, details)) => {
                let name = Arc::clone(&channel.name);
                Err(Unread { at, topic, name, reason, details })
            }
        })
    }
}

/// Encodes the type of a channel whose schema was lost, as after its number. `content` is that of
/// the channel after its number. Returns `None` for a channel that recordings do not have.
pub(super) fn lost_schema(channel: u16, content: &[u8]) -> Option<Vec<u8>> {
    let own = |topic: &Topic| {
        topic.channel() == channel && mcap::channel(topic.schema(), topic.name()) == content
    };
    let known = Topic::ALL.into_iter().find(own)?.message_type();
    Some(mcap::schema(known.name(), known.definition()))
}

fn parse_entry(topic: Topic, stamp: SystemTime, data: &[u8]) -> Result<Entry, CdrError> {
    Ok(match topic {
        Topic::Scans => Entry::Scan(ros::read_scan(data)?),
        Topic::Events => Entry::Event(Event::from(ros::read_text(data)?)),
        Topic::Replies => {
            let (request, bytes) = ros::read_labelled_bytes(data)?;
            Entry::Reply(RecordedReply::new(request, bytes, stamp))
        }
    })
}

/// Converts from the form in files.
pub(super) fn time(nanos: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}
