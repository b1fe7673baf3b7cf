//! The `urg` program, run as a user runs it: in real time, and without sleeping. Each wait
//! is for a line that the program writes, or for its end.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod check;
mod ends;
mod foreign;
mod formats;
mod http;
#[path = "../../tests/common/instant_sensor.rs"]
mod instant_sensor;
#[path = "../../tests/common/limit.rs"]
mod limit;
mod models;
mod packaging;
mod picture;
mod pipes;
mod playback;
mod program;
#[cfg(any(feature = "dds", feature = "zenoh", feature = "foxglove"))]
mod publish_arguments;
mod recorded;
mod repaired;
#[cfg(unix)]
mod screen;
mod served;
mod several;
mod slow_clients;
mod usage;
mod web;
