//! Polls on their grid, and the scans that streams deliver from them.

pub(crate) mod fresh;
mod grid;
mod pauses;
mod pending_input;
mod rate;
mod ray_order;
mod reached_rate;
mod ready;
mod schedule;
mod stamps;
mod unique_polls;
mod wire;
