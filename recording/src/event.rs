//! [`Event`]: what happened to a stream, besides its scans. [`Events`] derives the events from the
//! items of a stream:
//!
//! ```no_run
//! # async fn run(mut scans: tokio_scip::ScanStream) {
//! use urg_recording::Events;
//!
//! let mut events = Events::new();
//! while let Some(item) = scans.next().await {
//!     for event in events.from_item(&item) {
//!         println!("{event}"); // such as {"event":"missed","scans":3}
//!     }
//! }
//! # }
//! ```

use std::collections::VecDeque;
use std::fmt;

use serde::{Deserialize, Serialize};
use tokio_scip::{Error, ErrorChain, ErrorKind, Scan, Window};

/// Event in the life of a stream. `Display` writes a JSON object, such as
/// `{"event":"disconnected","error":"..."}`, as in recordings. `From<&str>` reads it.
///
/// ```
/// use urg_recording::Event;
///
/// assert_eq!(Event::from(r#"{"event":"missed","scans":3}"#), Event::Missed { scans: 3 });
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "lowercase", deny_unknown_fields)]
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
    /// Scans were overwritten before their consumer read them. A recording still has their replies.
    Missed {
        /// Number of scans.
        scans: u64,
    },
    /// Text of no known event: from a later version, or from another program.
    #[serde(skip)]
    Unknown {
        /// Unchanged text.
        text: String,
    },
}

/// Converts a lost link to [`Event::Disconnected`] and any other error to [`Event::Error`],
/// with the error and its causes on one line.
impl From<&Error> for Event {
    fn from(error: &Error) -> Self {
        let text = ErrorChain(&error).to_string();
        match error.kind() {
            ErrorKind::Disconnected { .. } => Self::Disconnected { error: text },
            _ => Self::Error { error: text },
        }
    }
}

/// Largest number of streams to tell apart.
const MAX_STREAMS: usize = 16;

/// Derives the events of streams from their items. Tells streams apart by the windows and numbers of their scans.
#[derive(Debug, Clone, Default)]
pub struct Events {
    /// Window of each stream, and the number of its next scan if none is missed.
    expected: VecDeque<(Window, u64)>,
    is_disconnected: bool,
}

impl Events {
    /// Starts before the first item of a stream.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the events of the stream's next item. An error is an event itself. Before a scan, the sensor
    /// may have come [back](Event::Reconnected), and scans may have been [missed](Event::Missed).
    pub fn from_item(&mut self, item: &Result<Scan, Error>) -> impl Iterator<Item = Event> + use<> {
        let events = match item {
            Ok(scan) => {
                let scans = self.count_missed(scan);
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

    fn count_missed(&mut self, scan: &Scan) -> u64 {
        let (window, number) = (scan.window(), scan.sequence());
        let streams = self.expected.iter_mut();
        let before = streams.filter(|(known, expected)| *known == window && *expected <= number);
        let next = number.saturating_add(1);
        if let Some((_, expected)) = before.max_by_key(|(_, expected)| *expected) {
            return number - std::mem::replace(expected, next);
        }
        // The first scan of another stream.
        if self.expected.len() == MAX_STREAMS {
            self.expected.pop_front();
        }
        self.expected.push_back((window, next));
        0
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown { text } => f.write_str(text),
            event => f.write_str(&serde_json::to_string(event).map_err(|_| fmt::Error)?),
        }
    }
}

/// Reads what `Display` writes. Any other text is [`Event::Unknown`].
impl From<&str> for Event {
    fn from(text: &str) -> Self {
        let unknown = |_| Self::Unknown { text: text.to_owned() };
        serde_json::from_str(text).unwrap_or_else(unknown)
    }
}
