//! [`Event`]: what a recording knows of besides scans and replies.

use std::fmt::{self, Write};

/// Something other than a scan, as a recording has it. `Display` gives the JSON
/// object that stands in the file, such as
/// `{"event":"disconnected","error":"..."}`.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// The link to the sensor was lost.
    Disconnected {
        /// Why.
        error: String,
    },
    /// The first scan after that came.
    Reconnected,
    /// No scan came, or the driver has ended.
    Error {
        /// Why.
        error: String,
    },
    /// Scans that the stream's consumer was too slow to see. Their replies are
    /// there.
    Missed {
        /// How many.
        scans: u64,
    },
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
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_a_json_object_whatever_the_error_says() {
        let event = Event::Disconnected { error: "a \"b\" \\ \n\u{7f}é".to_owned() };
        assert_eq!(
            event.to_string(),
            r#"{"event":"disconnected","error":"a \"b\" \\ \u000a\u007fé"}"#
        );
        assert_eq!(Event::Missed { scans: 3 }.to_string(), r#"{"event":"missed","scans":3}"#);
    }
}
