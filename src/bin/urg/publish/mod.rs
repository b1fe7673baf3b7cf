//! `urg publish`: scans as ROS 2 messages on a network. `engine` defines what
//! carries messages; `dds` and `zenoh` do, `running` keeps one of them open, and `counts`
//! counts the scans that were published, dropped or lost.
//! `source` brings the scans of one sensor to it, and `diagnostics` its condition;
//! `names` names nodes and topics.
//!
//! The messages themselves are the library's (`tokio_scip::ros`). Nothing outside
//! of this module knows an engine.

mod counts;
#[cfg(feature = "ros2")]
mod dds;
mod diagnostics;
mod engine;
mod names;
#[cfg(feature = "ros2")]
mod newcomers;
mod running;
mod source;
#[cfg(feature = "zenoh")]
mod zenoh;

pub(crate) use self::engine::{EngineName, EngineSettings, Mode, NodeSpec, ParameterValue, Qos};
pub(crate) use self::names::NodeNames;
pub(crate) use self::running::RunningEngine;
pub(crate) use self::source::Source;
