//! The driver's reports to its handles: [`State`] to await, [`Stats`] to count, and
//! [`Freshness`] to check against a limit. `telemetry` is where the driver writes
//! them.

mod freshness;
mod latency;
mod stats;
mod telemetry;

use tokio::time::Instant;

pub use self::freshness::{Freshness, Stale};
pub use self::latency::LatencyStats;
pub use self::stats::{MalformedCounts, ScheduleStats, Stats};
pub(crate) use self::telemetry::{Audience, Telemetry};
use crate::protocol::Text;
use crate::{BaudRate, Error};

/// The state of the driver and its link. [`Sensor::state`](crate::Sensor::state)
/// returns a watch of it. [`Closed`](Self::Closed) is final.
///
/// `Connected` means that the sensor answers, not that its scans are whole:
/// [`Sensor::freshness`](crate::Sensor::freshness) reports whether good ones come.
///
/// As data (feature `serde`) it is an object with the name of the state in snake case
/// as `state`, beside its fields: `baud_rate` in baud, `since` as the seconds that have
/// passed, `error` as the text of the error and its causes. Such as
/// `{"state":"disconnected","since":1.5,"error":"..."}`.
///
/// Only `Connected` may get more fields; the other states can be made by others, to test
/// a service's reaction.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(tag = "state", rename_all = "snake_case"))]
#[non_exhaustive]
pub enum State {
    /// The driver opens the port for the first time, or searches for the sensor.
    Connecting {
        /// The reason why this failed so far, if the driver is to
        /// [wait for the sensor](crate::SensorBuilder::wait_for_sensor).
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain_if_any"))]
        error: Option<Error>,
    },
    /// The sensor answers.
    #[non_exhaustive]
    Connected {
        /// The baud rate of the line to it, or `None` where there is none (USB).
        baud_rate: Option<BaudRate>,
        /// True if scans are polled: a stream is open, and the laser is not switched
        /// off.
        streaming: bool,
        /// The sensor's serial number, as in its `SERI:` line. It changes when another
        /// sensor replaces the one before, which
        /// [`any_sensor`](crate::SensorBuilder::any_sensor) allows.
        serial_number: Text,
    },
    /// The sensor does not answer on a port that is still open; the driver searches
    /// for it at every baud rate.
    Recovering,
    /// The link is lost; the driver reconnects.
    Disconnected {
        /// The time when it was lost, on tokio's clock.
        #[cfg_attr(feature = "serde", serde(serialize_with = "elapsed"))]
        since: Instant,
        /// The latest reason.
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain"))]
        error: Error,
    },
    /// The driver has ended for good.
    Closed {
        /// The cause, or `None` if it was closed or its last handle was dropped.
        #[cfg_attr(feature = "serde", serde(serialize_with = "chain_if_any"))]
        error: Option<Error>,
    },
}

impl State {
    /// Returns the baud rate of the line to the sensor: `None` unless
    /// [connected](Self::Connected), and where the link has none (USB).
    pub fn baud_rate(&self) -> Option<BaudRate> {
        match self {
            Self::Connected { baud_rate, .. } => *baud_rate,
            _ => None,
        }
    }
}

/// Serialises an error and its causes as one text.
#[cfg(feature = "serde")]
fn chain<S: serde::Serializer>(error: &Error, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&error.chain())
}

#[cfg(feature = "serde")]
fn chain_if_any<S: serde::Serializer>(
    error: &Option<Error>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    match error {
        Some(error) => chain(error, serializer),
        None => serializer.serialize_none(),
    }
}

/// Serialises an instant as its age: instants mean nothing in another process.
#[cfg(feature = "serde")]
fn elapsed<S: serde::Serializer>(since: &Instant, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(since.elapsed().as_secs_f64())
}
