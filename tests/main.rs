//! All tests that use the crate and its program from outside, one module for each concern.
//! README.md lists them. They are one executable, because linking takes longer than
//! compiling. `cargo test --features mcap,web polling::` runs the tests of one module.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod allocations;
mod auto_traits;
mod cancel;
mod codec;
mod common;
mod emulator;
mod exhaustive;
mod faults;
mod flood;
mod fresh;
mod grid;
mod identity;
mod idle_probe;
mod layering;
mod memory;
mod nth_failure;
mod observer;
mod opening;
mod pauses;
mod pending_input;
mod polling;
mod ports;
#[cfg(all(unix, feature = "serial"))]
mod ports_serial;
mod properties;
mod protocol;
mod rate;
mod reconnect;
#[cfg(feature = "mcap")]
mod recording;
#[cfg(all(feature = "serde", feature = "cli"))]
mod serde;
mod settings;
mod simulation;
#[cfg(all(unix, feature = "serial"))]
mod terminal;
mod unique_polls;
#[cfg(feature = "cli")]
mod urg;
mod wire;
