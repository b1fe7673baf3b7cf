//! SCIP 1.1 as a sensor speaks it, written from the protocol text alone.
//!
//! `command` parses what the host sends, `dialect` executes it and writes the reply.
//! They use only the type `BaudRate` of the driver, so that the driver
//! and the emulated sensor check each other: a misreading of the text in either of them
//! fails a test.

mod command;
mod dialect;

pub(super) use self::command::Command;
pub(super) use self::dialect::{Dialect, status};
pub use self::dialect::{EmptyCommand, Firmware, RepeatedLaser};
