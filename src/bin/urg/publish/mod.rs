//! `urg publish`: scans as ROS 2 messages on a network. `engine` carries
//! messages, over `dds` or `zenoh`; `source` brings the scans of one sensor to
//! it, and `diagnostics` its condition; `names` names nodes and topics.
//!
//! The messages themselves are the library's (`tokio_scip::ros`). Nothing outside
//! of this module knows an engine.

#[cfg(feature = "ros2")]
mod dds;
mod diagnostics;
mod engine;
mod names;
mod source;
#[cfg(feature = "zenoh")]
mod zenoh;

pub(crate) use self::engine::{
    EngineName, EngineSettings, Mode, NodeSpec, ParameterValue, Qos, RunningEngine,
};
pub(crate) use self::names::{NamedPort, NodeNames};
pub(crate) use self::source::Source;
