//! Streams of scans: [`ScanStream`], its settings, and the scans without the errors.
//!
//! ```
//! # use urg_emulator::Emulator;
//! use tokio_scip::{Rate, Sensor, Window};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), tokio_scip::Error> {
//! # let sensor = Sensor::builder().connect(Emulator::default()).await?;
//! let mut scans = sensor.scans(Window::DETECTION, Rate::hz(5.0)).await?.only_scans();
//! while let Some(scan) = scans.next().await {
//!     println!("{} points", scan.len());
//! #   sensor.close().await;
//! }
//! # Ok(())
//! # }
//! ```

mod builder;
mod only_scans;
mod scan_stream;

pub use self::builder::StreamBuilder;
pub use self::only_scans::OnlyScans;
#[doc(no_inline)]
pub use self::scan_stream::ScanStream;
pub use crate::rate::RateError;
