//! The `urg` program, run as a user runs it. In real time, and without
//! sleeping: every wait is for a line that the program writes, or for its end.
#![cfg(all(unix, feature = "cli"))]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod check;
mod ends;
mod formats;
mod http;
mod packaging;
mod picture;
mod program;
mod recorded;
mod screen;
mod served;
mod usage;
mod web;
