//! The examples, included as they are, for tests that call parts of them.

#![allow(dead_code, reason = "their main functions are those of programs")]
#![allow(clippy::duplicate_mod, reason = "each has the same module `port`")]

#[path = "../../examples/count_people.rs"]
pub(super) mod count_people;
#[path = "../../examples/fleet.rs"]
pub(super) mod fleet;
#[path = "../../examples/graceful_shutdown.rs"]
pub(super) mod graceful_shutdown;
#[path = "../../examples/interactive_wall/main.rs"]
pub(super) mod interactive_wall;
#[path = "../../examples/merged.rs"]
pub(super) mod merged;
#[path = "../../examples/odometry.rs"]
pub(super) mod odometry;
#[cfg(unix)]
#[path = "../../examples/own_transport.rs"]
pub(super) mod own_transport;
#[path = "../../examples/safety_stop/main.rs"]
pub(super) mod safety_stop;
