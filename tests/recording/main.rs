//! Recordings: what was delivered is in the file, whatever became of the file,
//! and comes out of it again byte for byte.

#![cfg(feature = "mcap")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod events;
mod file;
mod hardship;
mod replay;
mod sink;
