//! An async driver for Hokuyo URG laser range sensors that speak SCIP 1.1.

#[cfg(feature = "emulator")]
pub mod emulator;
mod error;
pub mod port;
pub mod protocol;

pub use error::Error;
pub use port::{Connect, Port};
pub use protocol::{BaudRate, ErrorCode, Measurement, Version, Window};
