//! Counters of everything that the driver does, for a log or an exporter of metrics. Get a
//! copy from [`Sensor::stats`](crate::Sensor::stats).
//!
//! ```
//! # use urg_emulator::Emulator;
//! use tokio_scip::{Rate, Sensor, Window};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), tokio_scip::Error> {
//! # let sensor = Sensor::builder().connect(Emulator::default()).await?;
//! let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
//! for _ in 0..10 {
//!     scans.next().await;
//! }
//! let stats = sensor.stats();
//! println!("{} scans, {} malformed replies", stats.scans, stats.malformed.total());
//! println!("the slowest reply took {:?}", stats.reply_latency.max);
//! # assert_eq!((stats.scans, stats.malformed.total()), (10, 0));
//! # Ok(())
//! # }
//! ```

mod latency;
#[expect(clippy::module_inception, reason = "it is named after its type")]
mod stats;

pub use self::latency::LatencyStats;
#[doc(no_inline)]
pub use self::stats::Stats;
pub use self::stats::{MalformedCounts, MotorStats, ScheduleStats, Shortfall};
