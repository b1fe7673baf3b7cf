//! What the messages of a file mean.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::left_out::LeftOutReason;
use super::mcap::{self, Channel, Definitions, MessageHeader};
use super::record::{Entry, Record, Topic};
use super::reply::RecordedReply;
use crate::event::Event;
use crate::ros::{self, CdrError};

/// Longest name of a topic of ROS 2.
const MAX_NAME_BYTES: usize = 255;

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

/// Returns the topic of a channel if recordings have it, and the topic that its messages are read as, or why
/// they cannot be read. Scans may be on any topic. The types are looked up for each message, since a damaged
/// file may define one again: then it makes no difference whether a channel is repeated.
fn topic(channel: &Channel<'_>) -> (Option<Topic>, Result<Topic, (LeftOutReason, String)>) {
    let known = Topic::ALL.into_iter().find(|topic| topic.name() == channel.topic);
    let topic = known.unwrap_or(Topic::Scans);
    // Without a type, or if it was lost with a damaged part, assume the topic's own.
    let is_own = channel.schema.map_or(known.is_some(), |name| topic.message_type().is_named(name));
    let shown = |text: &str| text.escape_default().take(MAX_NAME_BYTES).collect();
    let topic = match channel.encoding {
        _ if !is_own => Err((LeftOutReason::OtherType, shown(channel.schema.unwrap_or("no type")))),
        "cdr" => Ok(topic),
        "ros1" => Err((LeftOutReason::Ros1, String::new())),
        encoding => Err((LeftOutReason::OtherEncoding, shown(encoding))),
    };
    (known, topic)
}

/// Parses the content of a message. Returns `None` if its topic is none of ROS, or if the file's
/// reader reports it as damaged.
pub(super) fn parse(content: &[u8], definitions: &Definitions) -> Option<Result<Record, Unread>> {
    let (header, data) = MessageHeader::parse(content)?;
    let channel = definitions.channel(header.channel)?;
    if !(1..=MAX_NAME_BYTES).contains(&channel.topic.len()) {
        return None;
    }
    let (at, stamp) = (time(header.log_time), time(header.publish_time));
    let (known, topic) = topic(&channel);
    let (sequence, name) = (header.sequence, || Arc::from(channel.topic));
    let entry = topic.and_then(|topic| {
        parse_entry(topic, stamp, data).map_err(|error| match error {
            CdrError::Malformed => (LeftOutReason::Malformed, format!("{} bytes", data.len())),
            CdrError::Compressed => (LeftOutReason::Compressed, String::new()),
            CdrError::Encoding([a, b]) => {
                (LeftOutReason::OtherEncoding, format!("CDR header {a:02x} {b:02x}"))
            }
        })
    });
    let topic = known.is_none().then(name);
    Some(match entry {
        Ok(entry) => Ok(Record { at, stamp, topic, sequence, entry }),
        Err((reason, details)) => Err(Unread { at, topic, name: name(), reason, details }),
    })
}

/// Encodes the type of a channel whose schema was lost, as after its number. `content` is that of
/// the channel after its number. Returns `None` for a channel that recordings do not have.
pub(super) fn lost_schema(content: &[u8]) -> Option<Vec<u8>> {
    let own = |topic: &Topic| mcap::channel(topic.schema(), topic.name()) == content;
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

pub(super) fn time(nanos: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}
