//! Streams of scans: [`ScanStream`], and the builder that opens one.
//!
//! ```
//! # use urg_emulator::Emulator;
//! use tokio_scip::{Rate, Sensor, Window};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), tokio_scip::Error> {
//! # let sensor = Sensor::builder().connect(Emulator::default()).await?;
//! // Without the errors, for a consumer that handles them elsewhere:
//! use futures::StreamExt;
//!
//! let scans = sensor.scans(Window::DETECTION, Rate::hz(5.0)).await?;
//! let mut scans = scans.filter_map(|item| std::future::ready(item.ok()));
//! while let Some(scan) = scans.next().await {
//!     println!("{} points", scan.len());
//! #   sensor.close().await;
//! }
//! # Ok(())
//! # }
//! ```

mod builder;
mod scan_stream;

pub use self::builder::StreamBuilder;
#[doc(no_inline)]
pub use self::scan_stream::ScanStream;
