//! An async driver for Hokuyo URG laser range sensors that speak SCIP 1.1.

mod error;
pub mod port;
pub mod protocol;

pub use error::Error;
pub use port::{Connect, Endpoint, Port};
pub use protocol::{BaudRate, ErrorCode, Measurement, Version, Window};
