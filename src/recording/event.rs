//! [`Event`]: what a recording holds besides scans and replies, and its form as
//! JSON.

use std::fmt::{self, Write};
use std::str::FromStr;

/// Something other than a scan. `Display` writes the JSON object that stands in
/// the file, such as `{"event":"disconnected","error":"..."}`; `FromStr` parses
/// it.
///
/// ```
/// use tokio_scip::recording::Event;
///
/// let event: Event = r#"{"event":"missed","scans":3}"#.parse()?;
/// assert_eq!(event, Event::Missed { scans: 3 });
/// # Ok::<(), tokio_scip::recording::InvalidEvent>(())
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
    /// Scans were overwritten before the recording's consumer read them. Their
    /// replies are in the file.
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
