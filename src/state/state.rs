//! [`State`]: the state of the driver and its link.

use tokio::time::Instant;

use crate::protocol::Text;
use crate::{BaudRate, Error};

/// State of the driver and its link. Watch it with
/// [`Sensor::watch_state`](crate::Sensor::watch_state). [`Closed`](Self::Closed) is final.
///
/// `Connected` means that the sensor answers, not that its scans are whole: check
/// [`Sensor::freshness`](crate::Sensor::freshness) for that.
///
/// Serialises (feature `serde`) as an object such as
/// `{"state":"disconnected","since":1.5,"error":"..."}`. `state` is the name of the state
/// in snake case. The other fields follow: `baud_rate` in baud, `since` as seconds
/// before now, `error` as the text of the error and its causes.
///
/// Only `Connected` may get more fields. You can construct the others, to test your service.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(tag = "state", rename_all = "snake_case"))]
#[non_exhaustive]
pub enum State {
    /// The driver opens the port for the first time, or searches for the sensor.
    Connecting {
        /// Why this has failed so far, if you let the driver [wait for the
        /// sensor](crate::SensorBuilder::wait_for_sensor).
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain"))]
        error: Option<Error>,
    },
    /// The sensor answers.
    #[non_exhaustive]
    Connected {
        /// Baud rate of the line to the sensor, or `None` without a serial line (USB, Ethernet).
        baud_rate: Option<BaudRate>,
        /// True if scans are polled: a stream is open, and the laser is not switched off.
        streaming: bool,
        /// Serial number, as in the sensor's `SERI:` line. It changes when another sensor replaces this
        /// one, if you allow that with [`any_sensor`](crate::SensorBuilder::any_sensor).
        serial_number: Text,
    },
    /// The sensor does not answer, but its port is still open. The driver searches for it
    /// at every baud rate that the port can set.
    Recovering,
    /// The link is lost; the driver reconnects.
    Disconnected {
        /// When the link was lost, on tokio's clock.
        #[cfg_attr(feature = "serde", serde(serialize_with = "age"))]
        since: Instant,
        /// Latest reason.
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain"))]
        error: Error,
    },
    /// The driver has ended permanently.
    Closed {
        /// Cause, or `None` if you closed the driver or dropped its last handle.
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain"))]
        error: Option<Error>,
    },
}

impl State {
    /// Baud rate of the line. `None` on USB and Ethernet, and unless [connected](Self::Connected).
    pub fn baud_rate(&self) -> Option<BaudRate> {
        match self {
            Self::Connected { baud_rate, .. } => *baud_rate,
            _ => None,
        }
    }
}

/// Serialises an error and its causes as one text, if there is one.
#[cfg(feature = "serde")]
pub(super) fn chain<'a, S: serde::Serializer>(
    error: impl Into<Option<&'a Error>>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let text = error.into().map(|error| crate::ErrorChain(error).to_string());
    serde::Serialize::serialize(&text, serializer)
}

/// Serialises an instant, if there is one, as its age: instants mean nothing in another process.
#[cfg(feature = "serde")]
pub(super) fn age<'a, S: serde::Serializer>(
    at: impl Into<Option<&'a Instant>>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serde::Serialize::serialize(&at.into().map(|at| at.elapsed().as_secs_f64()), serializer)
}
