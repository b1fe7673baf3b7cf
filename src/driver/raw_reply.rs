//! [`RawReply`]: a frame as the sensor sent it.

use std::time::SystemTime;

use tokio::time::Instant;

use crate::protocol::{Command, Protocol, scip2};

/// Frame that the sensor sent after a command. The observers of
/// [`SensorBuilder::on_reply`](crate::SensorBuilder::on_reply) and
/// [`Sensor::observe_replies`](crate::Sensor::observe_replies) receive it. Bytes that
/// arrive at other times are dropped and form no frame.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct RawReply<'a> {
    /// Protocol that the sensor speaks.
    pub protocol: Protocol,
    /// Command of SCIP 1.1 that the frame answers, even if the reply is malformed. `None` for the
    /// reply to a fence and for a frame with another echo.
    pub command: Option<Command>,
    /// Request of SCIP 2 that the frame answers, even if the reply is malformed. The frame begins with
    /// it, unless an earlier reply was cut short. `None` for the reply to a probe or another request.
    pub request: Option<scip2::Request>,
    /// Bytes as received, without the two LFs at the end and without NULs at the front.
    pub bytes: &'a [u8],
    /// When the last byte was read, on tokio's clock. Equal to the time of its [`Scan`](crate::Scan) to
    /// within microseconds.
    pub received_at: Instant,
    /// Wall clock when the first byte arrived, the same as
    /// [`stamp`](crate::scan::ScanTimes::stamp) of its scan.
    pub stamp: SystemTime,
}
