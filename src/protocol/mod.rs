//! The SCIP 1.1 protocol as plain values and bytes: what a command looks like,
//! and whether a reply is a whole and right answer to it.
//!
//! Nothing here does I/O, reads a clock or writes a log. References such as
//! "p. 6" are to the pages of the protocol text, C-42-3320-A.

mod baud;
mod command;
mod measurement;
mod reply;
mod text;
mod version;
mod window;

pub use baud::{BaudRate, UnknownBaudRate};
pub use command::{Command, CommandBytes};
pub use measurement::{ErrorCode, Measurement, UnknownErrorCode};
pub use reply::{BLOCK, Malformed, Reply, ReplyError, Status};
pub use text::Text;
pub use version::{Specification, Version};
pub use window::{Step, Window, WindowError};
