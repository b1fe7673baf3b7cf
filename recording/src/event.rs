//! [`Event`]: what happened to a stream, besides its scans. [`Events`] derives the events from the
//! items of a stream:
//!
//! ```no_run
//! # async fn run(mut scans: tokio_scip::ScanStream) {
//! use urg_recording::Events;
//!
//! let mut events = Events::new();
//! while let Some(item) = scans.next().await {
//!     for event in events.of(&item) {
//!         println!("{event}"); // such as {"event":"missed","scans":3}
//!     }
//! }
//! # }
//! ```

use std::fmt::{self, Write};
use std::str::FromStr;

use tokio_scip::{Error, ErrorKind, Scan};

/// Event in the life of a stream. `Display` writes a JSON object, such as
/// `{"event":"disconnected","error":"..."}`, as in recordings. `FromStr` parses
/// it.
///
/// ```
/// use urg_recording::Event;
///
/// let event: Event = r#"{"event":"missed","scans":3}"#.parse()?;
/// assert_eq!(event, Event::Missed { scans: 3 });
/// # Ok::<(), urg_recording::EventError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// The link to the sensor was lost.
    Disconnected {
        /// Reason of the loss.
        error: String,
    },
    /// The link is back. Precedes the next scan.
    Reconnected,
    /// A poll failed, or the driver has ended.
    Error {
        /// Reason of the failure.
        error: String,
    },
    /// Scans were overwritten before their consumer read them. A recording still has their
    /// replies.
    Missed {
        /// Number of scans.
        scans: u64,
    },
    /// Text of no known event: from a later version, or from another program.
    Unknown {
        /// Unchanged text.
        text: String,
    },
}

/// Error for a text that is not an [`Event`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "not an event of a recording: expected a JSON object as `Event` writes it, such as {{\"event\":\"reconnected\"}}"
)]
pub struct EventError;

/// Converts a lost link to [`Event::Disconnected`] and any other error to [`Event::Error`],
/// with the error and its causes on one line.
impl From<&Error> for Event {
    fn from(error: &Error) -> Self {
        let text = error.chain().to_string();
        match error.kind() {
            ErrorKind::Disconnected { .. } => Self::Disconnected { error: text },
            _ => Self::Error { error: text },
        }
    }
}

/// Derives the events of one stream from its items.
#[derive(Debug, Clone, Default)]
pub struct Events {
    /// Number of the next scan if none is missed.
    expected: Option<u64>,
    is_disconnected: bool,
}

impl Events {
    /// Starts before the first item of a stream.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the events of the stream's next item. An error is an event itself. Before a
    /// scan, the sensor may have come [back](Event::Reconnected), and scans may have been
    /// [missed](Event::Missed).
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
                self.is_disconnected |= matches!(error.kind(), ErrorKind::Disconnected { .. });
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

/// Parses exactly what `Display` writes; does not interpret other JSON.
impl FromStr for Event {
    type Err = EventError;

    fn from_str(text: &str) -> Result<Self, EventError> {
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
            // Writing it again must give the same bytes.
            (event.to_string() == text).then_some(event)
        };
        parse().ok_or(EventError)
    }
}

/// JSON string.
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

/// Undoes [`Quoted`].
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
    use tokio_scip::Window;

    #[test]
    fn events_stand_before_the_scan_that_follows_them() {
        let scan = |sequence| {
            let values = vec![0; Window::DETECTION.points()];
            Ok(Scan::builder(Window::DETECTION, values).sequence(sequence).build().unwrap())
        };
        let lost = || Error::from(ErrorKind::Disconnected { source: None });
        let closed = || Error::from(ErrorKind::Closed);
        let mut events = Events::new();
        let mut of = |item| events.of(&item).collect::<Vec<_>>();
        assert_eq!(of(scan(7)), []); // a stream of which no scan was read misses none
        assert_eq!(of(scan(8)), []);
        assert_eq!(of(scan(11)), [Event::Missed { scans: 2 }]);
        assert_eq!(of(Err(closed())), [Event::from(&closed())]);
        assert_eq!(of(scan(12)), []);
        assert_eq!(of(Err(lost())), [Event::Disconnected { error: lost().to_string() }]);
        assert_eq!(of(Err(closed())), [Event::Error { error: closed().to_string() }]);
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
            assert_eq!(text.parse::<Event>(), Err(EventError), "{text}");
        }
    }
}
