//! All tests that use the crate from outside, one module for each concern.
//! README.md lists them. They are one executable, because linking takes longer than
//! compiling. `cargo test --workspace polling::` runs the tests of one module.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;
mod desired_settings;
mod documents;
mod examples;
mod exhaustive;
mod faults;
mod handle;
mod layering;
mod limits;
mod lines;
mod link;
mod polling;
mod ports;
mod poses;
mod properties;
mod protocol;
mod scans;
mod scip2;
mod simulation;
