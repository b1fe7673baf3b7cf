//! `urg publish`: publishes scans as ROS 2 messages. The library encodes the messages
//! (`urg_recording::ros`); no other module knows the engines.
//!
//! - `engine` defines what `dds`, `zenoh` and `foxglove` implement; `topic` has topics and counters.
//! - `running` keeps an engine open, and reopens it after errors.
//! - `backoff` limits how often an engine is reopened.
//! - `send_queue` buffers messages for slow links, and detects links that are stuck.
//! - `source` publishes one sensor, and `diagnostics` describes its condition.
//! - `names` are nodes, topics and frames.
//! - `ros_args` and `discovery` read the arguments and environment variables of ROS 2, and
//!   `urg_node` the parameters of Hokuyo's node.
#![cfg_attr(
    not(all(feature = "dds", feature = "zenoh", feature = "foxglove")),
    expect(dead_code, reason = "some settings and counters are for one engine only")
)]

mod backoff;
#[cfg(feature = "dds")]
mod dds;
mod diagnostics;
mod discovery;
mod engine;
#[cfg(feature = "foxglove")]
mod foxglove;
mod names;
pub(crate) mod ros_args;
mod running;
mod send_queue;
mod source;
mod topic;
mod urg_node;
#[cfg(feature = "zenoh")]
mod zenoh;

pub(crate) use self::discovery::Discovery;
pub(crate) use self::engine::{EngineName, EngineSettings, Mode};
pub(crate) use self::names::{NameArgs, NodeNames};
pub(crate) use self::running::RunningEngine;
pub(crate) use self::source::Source;
pub(crate) use self::topic::Qos;
