//! An async driver for Hokuyo URG laser range sensors that speak SCIP 1.1.

pub mod codec;
mod driver;
#[cfg(feature = "emulator")]
pub mod emulator;
mod error;
pub mod port;
pub mod protocol;
mod rate;
mod ring;
mod scan;
mod sensor;
mod state;
mod stream;

pub use driver::Driver;
pub use error::Error;
pub use port::{Connect, Endpoint, Port};
pub use protocol::{BaudRate, ErrorCode, Measurement, Version, Window};
pub use rate::{InvalidRate, Rate};
pub use scan::{Point, Scan};
pub use sensor::{Sensor, SensorBuilder};
pub use state::{Latency, MalformedCounts, ScheduleStats, State, Stats};
pub use stream::{OnlyScans, ScanStream};
