//! The models alone: `simulation` and `exhaustive`, which are part of `it`, too. They run for
//! hours in an optimized build, and this one takes a fifth of the time to build.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]
// The other tests need the rest of `common`.
#![allow(dead_code)]

mod common;
mod exhaustive;
mod simulation;
