//! An async driver for Hokuyo URG laser range sensors that speak SCIP 1.1.
//!
//! A URG is a small spinning laser scanner: ten times a second it measures the
//! distance, 20 mm to 4 m, in each of 682 directions around it. This crate lets
//! an async service await its scans, day and night, unattended: every scan is
//! whole and is the answer to the request it is attached to, and scans keep
//! coming after a cable is pulled and put back.
//!
//! # Which sensors
//!
//! Those that speak SCIP 1.1, the protocol of Hokuyo's document C-42-3320-A: the
//! URG-04LX and its like, over USB or RS-232. Later models (UTM-30LX, UST-10LX)
//! know only SCIP 2 and are told apart when they are opened. A URG-04LX that some
//! other program has switched to SCIP 2 is back in SCIP 1.1 after a power-cycle.
//!
//! # A first program
//!
//! ```no_run
//! use tokio_scip::{Rate, Sensor, Window};
//!
//! # #[tokio::main(flavor = "current_thread")]
//! # async fn main() -> Result<(), tokio_scip::Error> {
//! let sensor = Sensor::open("/dev/ttyACM0").await?;
//! println!("{}", sensor.version().await?.product);
//!
//! let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
//! while let Some(scan) = scans.next().await {
//!     match scan {
//!         Ok(scan) => {
//!             for point in scan.points() {
//!                 println!("{:.3} {:.3}", point.x, point.y); // metres; x forward, y left
//!             }
//!         }
//!         Err(error) => eprintln!("no scan: {error}"), // and the stream goes on
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! No sensor at hand? With feature `emulator` the same program runs on one in
//! software, [`emulator::Emulator`]:
//!
//! ```
//! # #[cfg(feature = "emulator")] {
//! use tokio_scip::emulator::Emulator;
//! use tokio_scip::{Rate, Sensor, Window};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), tokio_scip::Error> {
//! let sensor = Sensor::builder().connect(Emulator::default()).await?;
//! let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
//! if let Some(scan) = scans.next().await {
//!     assert_eq!(scan?.len(), 682);
//! }
//! # Ok(())
//! # }
//! # main().unwrap();
//! # }
//! ```
//!
//! # Where to find what
//!
//! - [`Sensor`] opens a sensor and asks it things; [`SensorBuilder`] for all that
//!   `open` takes for granted.
//! - [`ScanStream`] is a `Stream` of [`Scan`]s of a [`Window`] at a [`Rate`].
//! - [`Scan`] has values, measurements, ranges and points, with the fields of
//!   ROS's `sensor_msgs/LaserScan` by name.
//! - [`State`] and [`Stats`] tell how it goes; [`Error`] what went wrong and what
//!   to do about it.
//! - [`port`] has the ways to reach a sensor, [`protocol`] and [`codec`] the
//!   protocol itself, for those who want to speak it on their own.
//! - The [`guide`] explains polling and freshness, why a scan can be trusted,
//!   recovery, baud rates, geometry, testing, operating, logging, has
//!   [recipes](guide::recipes), and tells [how the crate is built](guide::design).
//!
//! # Features
//!
//! | feature | brings |
//! |---|---|
//! | `serial` (default) | serial ports: RS-232 and USB |
//! | `serde` | scans, windows, versions, states and counters as data |
//! | `emulator` | a sensor in software, to test a service without hardware |
//! | `mcap` | recordings that ROS 2's tools open, and replaying them |
//! | `cli` | the program `urg` |
//! | `web` | `urg serve`: a live page for any browser, and scans over HTTP |
//!
//! Without default features only `serial` is gone: TCP, [`Sensor::attach`] and
//! one's own [`Connect`] are always there.
//!
//! # Cancel safety
//!
//! A future is *cancel-safe* if it can be dropped at any await with nothing lost
//! and nothing disturbed. All futures of this crate are, but for
//! [`Driver`], whose dropping ends it, as its docs say.
//!
//! # Runtime
//!
//! Tokio with its timer, and I/O for serial ports and TCP. One task for each
//! sensor, no thread of its own; opening a serial port uses the runtime's
//! blocking threads for a moment.
//!
//! # Versions
//!
//! Semantic versioning: before 1.0 a change that breaks code raises the second
//! number, any other the third. What counts is the public API with its documented
//! behaviour, the options and output formats of `urg`, and the serialised forms;
//! texts of errors and lines of log may change at any time. Enums and structs that
//! may grow are `#[non_exhaustive]`. The types of `tokio`, `tokio-util`, `futures`,
//! `bytes` and `serde` in the API are part of it.
//!
//! The minimum Rust is 1.88. It is at least half a year old whenever it is raised,
//! and raising it raises the second number before 1.0, the minor one after.
#![cfg_attr(not(feature = "emulator"), allow(rustdoc::broken_intra_doc_links))]
// docs.rs builds with nightly and this cfg: each item shows the feature that it needs.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod codec;
mod driver;
#[cfg(feature = "emulator")]
pub mod emulator;
mod error;
#[cfg(any(doc, doctest))]
pub mod guide;
mod observer;
pub mod port;
pub mod protocol;
mod rate;
#[cfg(feature = "mcap")]
pub mod recording;
mod ring;
mod scan;
mod sensor;
mod state;
mod stream;

pub use driver::Driver;
pub use error::{Error, ErrorChain};
pub use observer::RawReply;
pub use port::{Connect, Endpoint, Port};
pub use protocol::{BaudRate, ErrorCode, Measurement, Version, Window, WindowError};
pub use rate::{InvalidRate, Rate};
pub use scan::{Point, Scan};
pub use sensor::{Sensor, SensorBuilder};
pub use state::{LatencyStats, MalformedCounts, ScheduleStats, State, Stats};
pub use stream::{OnlyScans, ScanStream};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
