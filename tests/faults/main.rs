//! Every row of the list of faults ([`list.txt`](list.txt)): what the driver
//! makes of it, on an emulated sensor that has the fault. Tests are named after
//! their rows; `coverage` fails where a row has none.
#![cfg(feature = "emulator")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod bytes;
#[path = "../common/mod.rs"]
mod common;
mod coverage;
mod device;
mod hostile;
mod rig;
mod system;
mod tasks;
mod terminal;
mod timing;
mod wire;
