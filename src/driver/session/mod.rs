//! [`Session`]: one open port, and what the driver wants of the sensor behind it.
//!
//! This is the line between what the driver means and what a protocol says. Above it, the driver
//! has these intentions. Each returns an outcome that the protocol has confirmed:
//!
//! | intention | confirmed |
//! |---|---|
//! | [`find`](Session::find) | the sensor answers at the port's baud rate |
//! | [`identify`](Session::identify) | a flipped bit has not changed the identity |
//! | [`set_laser`](Session::set_laser) | the sensor measures, or refuses to |
//! | [`set_baud_rate`](Session::set_baud_rate) | the sensor answers at the new baud rate |
//! | [`probe`](Session::probe) | the sensor answers, and no older reply can follow |
//! | [`acquire`](Session::acquire) | the values answer this request |
//!
//! Below it, a protocol knows its commands, tells replies apart, and judges the bytes that nobody
//! asked for.

mod scip1;

use std::sync::Arc;

pub(crate) use self::scip1::{Leftovers, Session};
use super::transport::ReplyTimes;
use crate::state::VersionReply;

/// Values of a window.
#[derive(Debug)]
pub(crate) struct Acquired {
    pub(crate) values: Arc<[u16]>,
    /// Index of the window's first value. The protocol may have asked for extra values before or
    /// after the window.
    pub(crate) first: usize,
    pub(crate) times: ReplyTimes,
}

/// Identity of a sensor.
#[derive(Debug)]
pub(crate) struct Identity {
    pub(crate) reply: VersionReply,
    /// True if the serial number is not empty, and was known or is the same in two replies.
    pub(crate) is_serial_number_confirmed: bool,
    /// Motor speed, if it was known or is the same in two replies.
    pub(crate) motor_speed: Option<MotorSpeed>,
}

/// Motor speed of a sensor, as it tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MotorSpeed {
    RevolutionsPerMinute(u16),
    /// Older firmware does not tell it.
    Untold,
}
