//! SCIP 2 as sensors speak it, written from the protocol text C-42-03320B and from what is known of
//! real sensors.
//!
//! `command` parses what the host sends, `session` executes it, `texts` has what each model says
//! about itself, `encode` writes the reply. Like `scip1`, they use only the type `BaudRate` of the
//! driver.

mod command;
mod encode;
mod session;
mod texts;

pub(super) use self::command::Command;
pub use self::session::Quirk;
pub(super) use self::session::{Session, Times, status};
