//! The commands, one file each. A command that this build lacks is still known:
//! it names the feature that brings it.

pub(crate) mod baud;
pub(crate) mod check;
pub(crate) mod completions;
pub(crate) mod emulate;
pub(crate) mod info;
pub(crate) mod laser;
#[cfg(unix)]
mod link_claim;
pub(crate) mod list;
pub(crate) mod man;
#[cfg(not(all(feature = "mcap", feature = "web", any(feature = "ros2", feature = "zenoh"))))]
mod missing;
#[cfg(any(feature = "ros2", feature = "zenoh"))]
pub(crate) mod publish;
#[cfg(feature = "mcap")]
pub(crate) mod record;
#[cfg(feature = "mcap")]
pub(crate) mod repair;
pub(crate) mod scan;
#[cfg(feature = "web")]
pub(crate) mod serve;
pub(crate) mod stream;
pub(crate) mod view;

#[cfg(not(any(feature = "ros2", feature = "zenoh")))]
pub(crate) use self::missing::publish;
#[cfg(not(feature = "web"))]
pub(crate) use self::missing::serve;
#[cfg(not(feature = "mcap"))]
pub(crate) use self::missing::{record, repair};
