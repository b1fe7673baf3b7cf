//! [`Event`]: what happens to a stream besides its scans, and its form as JSON.
//! [`Events`] derives the events from the items of a stream.

use std::fmt::{self, Write};
use std::str::FromStr;

use crate::{Error, Scan};

/// Something that happened to a stream besides its scans. `Display` writes a JSON
/// object, such as `{"event":"disconnected","error":"..."}`, which also stands in
/// recordings; `FromStr` parses it.
///
/// ```
/// use tokio_scip::Event;
///
/// let event: Event = r#"{"event":"missed","scans":3}"#.parse()?;
/// assert_eq!(event, Event::Missed { scans: 3 });
/// # Ok::<(), tokio_scip::InvalidEvent>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// The link to the sensor was lost.
    Disconnected {
        /// The reason.
        error: String,
    },
    /// The first scan after a lost link came.
    Reconnected,
    /// A poll failed, or the driver has ended.
    Error {
        /// The reason.
        error: String,
    },
    /// Scans were overwritten before their consumer read them. A recording has their
    /// replies.
    Missed {
        /// The number of scans.
        scans: u64,
    },
    /// A text that is no event of this version: of a later one, or written by
    /// somebody else.
    Unknown {
        /// The text, unchanged.
        text: String,
    },
}

/// The error of parsing a text that no [`Event`] writes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "not an event of a recording: expected a JSON object as `Event` writes it, such as {{\"event\":\"reconnected\"}}"
)]
pub struct InvalidEvent;

/// Returns [`Event::Disconnected`] for a lost link, [`Event::Error`] for all else, with the
/// error and its causes as one line.
impl From<&Error> for Event {
    fn from(error: &Error) -> Self {
        let text = error.chain().to_string();
        match error {
            Error::Disconnected { .. } => Self::Disconnected { error: text },
            _ => Self::Error { error: text },
        }
    }
}

/// The events of one stream, derived from its items.
///
/// ```no_run
/// # async fn run(mut scans: tokio_scip::ScanStream) {
/// use tokio_scip::Events;
///
/// let mut events = Events::new();
/// while let Some(item) = scans.next().await {
///     for event in events.of(&item) {
///         println!("{event}"); // such as {"event":"missed","scans":3}
///     }
/// }
/// # }
/// ```
#[derive(Debug, Clone, Default)]
pub struct Events {
    /// The number of the scan that comes next if none is missed.
    expected: Option<u64>,
    is_disconnected: bool,
}

impl Events {
    /// Returns the events of a stream of which no item was read.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the events that the next item of the stream stands for: an error is one
    /// itself; before a scan, the sensor may have come [back](Event::Reconnected), and
    /// scans may have been [missed](Event::Missed).
    pub fn of(&mut self, item: &Result<Scan, Error>) -> impl Iterator<Item = Event> + use<> {
        let events = match item {
            Ok(scan) => {
                let expected = self.expected.replace(scan.sequence().saturating_add(1));
                let scans = expected.map_or(0, |expected| scan.sequence().saturating_sub(expected));
                let is_back = std::mem::take(&mut self.is_disconnected);
                [
                    is_back.then_some(Event::Reconnected),
                    (scans > 0).then_some(Event::Missed { scans }),
                ]
            }
            Err(error) => {
                self.is_disconnected |= matches!(error, Error::Disconnected { .. });
                [Some(Event::from(error)), None]
            }
        };
        events.into_iter().flatten()
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disconnected { error } => {
                write!(f, r#"{{"event":"disconnected","error":{}}}"#, Quoted(error))
            }
            Self::Reconnected => f.write_str(r#"{"event":"reconnected"}"#),
            Self::Error { error } => {
                write!(f, r#"{{"event":"error","error":{}}}"#, Quoted(error))
            }
            Self::Missed { scans } => write!(f, r#"{{"event":"missed","scans":{scans}}}"#),
            Self::Unknown { text } => f.write_str(text),
        }
    }
}

/// Parses what `Display` writes, byte for byte; other JSON is not interpreted.
impl FromStr for Event {
    type Err = InvalidEvent;

    fn from_str(text: &str) -> Result<Self, InvalidEvent> {
        let parse = || {
            let (name, rest) = text.strip_prefix(r#"{"event":""#)?.split_once('"')?;
            let rest = rest.strip_suffix('}')?;
            let error = || unquote(rest.strip_prefix(r#","error":"#)?);
            let event = match name {
                "disconnected" => Self::Disconnected { error: error()? },
                "reconnected" => Self::Reconnected,
                "error" => Self::Error { error: error()? },
                "missed" => {
                    Self::Missed { scans: rest.strip_prefix(r#","scans":"#)?.parse().ok()? }
                }
                _ => return None,
            };
            // Whoever writes it again must get the same bytes.
            (event.to_string() == text).then_some(event)
        };
        parse().ok_or(InvalidEvent)
    }
}

/// A JSON string.
struct Quoted<'a>(&'a str);

impl fmt::Display for Quoted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_char('"')?;
        for c in self.0.chars() {
            match c {
                '"' | '\\' => write!(f, "\\{c}")?,
                c if c.is_control() => write!(f, "\\u{:04x}", u32::from(c))?,
                c => f.write_char(c)?,
            }
        }
        f.write_char('"')
    }
}

/// Returns the text of a JSON string as [`Quoted`] writes it.
fn unquote(json: &str) -> Option<String> {
    let mut rest = json.strip_prefix('"')?.strip_suffix('"')?;
    let mut text = String::new();
    while let Some((plain, escaped)) = rest.split_once('\\') {
        text.push_str(plain);
        let c = escaped.chars().next()?;
        rest = escaped.get(1..)?;
        if c == 'u' {
            text.push(char::from_u32(u32::from_str_radix(rest.get(..4)?, 16).ok()?)?);
            rest = rest.get(4..)?;
        } else {
            text.push(c);
        }
    }
    text.push_str(rest);
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Window;

    #[test]
    fn events_stand_before_the_scan_that_follows_them() {
        let scan = |sequence| {
            let values = vec![0; Window::DETECTION.points()];
            Ok(Scan::builder(Window::DETECTION, values).sequence(sequence).build().unwrap())
        };
        let lost = || Error::Disconnected { sensor: None, source: None };
        let mut events = Events::new();
        let mut of = |item| events.of(&item).collect::<Vec<_>>();
        assert_eq!(of(scan(7)), []); // a stream of which no scan was read misses none
        assert_eq!(of(scan(8)), []);
        assert_eq!(of(scan(11)), [Event::Missed { scans: 2 }]);
        assert_eq!(of(Err(Error::Closed)), [Event::from(&Error::Closed)]);
        assert_eq!(of(scan(12)), []);
        assert_eq!(of(Err(lost())), [Event::Disconnected { error: lost().to_string() }]);
        assert_eq!(of(Err(Error::Closed)), [Event::Error { error: Error::Closed.to_string() }]);
        assert_eq!(of(scan(14)), [Event::Reconnected, Event::Missed { scans: 1 }]);
        assert_eq!(of(scan(15)), []);
    }

    #[test]
    fn an_event_is_a_json_object_whatever_the_error_contains_and_parses_back() {
        let error = "a \"b\" \\ \n\u{7f}é \\u0041 \\".to_owned();
        let disconnected = Event::Disconnected { error: error.clone() };
        assert_eq!(
            disconnected.to_string(),
            r#"{"event":"disconnected","error":"a \"b\" \\ \u000a\u007fé \\u0041 \\"}"#
        );
        assert_eq!(Event::Missed { scans: 3 }.to_string(), r#"{"event":"missed","scans":3}"#);
        for event in [
            disconnected,
            Event::Reconnected,
            Event::Error { error },
            Event::Error { error: String::new() },
            Event::Missed { scans: u64::MAX },
        ] {
            assert_eq!(event.to_string().parse(), Ok(event));
        }
    }

    #[test]
    fn a_text_that_no_event_writes_is_an_error() {
        for text in [
            "",
            "{}",
            r#"{"event":"reconnected"}}"#,
            r#"{"event":"reconnected","error":""}"#,
            r#"{"event":"rebooted"}"#,
            r#"{"event":"missed","scans":-1}"#,
            r#"{"event":"missed","scans":+1}"#,
            r#"{"event":"error","error":"}"#,
            r#"{"event":"error","error":"a"b"}"#,
            r#"{"event":"error","error":"\u00"}"#,
            r#"{"event":"error","error":"\u000A"}"#,
            r#"{"event":"error","error":"\é"}"#,
            r#"{"event":"error","error":"\"}"#,
        ] {
            assert_eq!(text.parse::<Event>(), Err(InvalidEvent), "{text}");
        }
    }
}
