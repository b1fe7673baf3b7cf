//! An async driver for Hokuyo's laser range scanners, in SCIP 1.1 and SCIP 2.
//!
//! A URG-04LX turns ten times a second, a UST-10LX 40 times. In each revolution it measures the
//! distances in 682 or 1,081 directions. Your service awaits a stream of its scans. The driver polls
//! the sensor, checks each scan against its request, and reconnects after a lost link.
//!
//! ```
//! use urg_emulator::Emulator;
//! use tokio_scip::{Rate, Sensor, Window};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), tokio_scip::Error> {
//! // With a sensor: Sensor::open("/dev/ttyACM0").await?
//! let sensor = Sensor::builder().connect(Emulator::default()).await?;
//! let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
//! # let mut count = 0;
//! while let Some(scan) = scans.next().await {
//!     match scan {
//!         Ok(scan) => {
//!             for point in scan.points() {
//!                 println!("{:.3} {:.3}", point.x, point.y); // metres; x forward, y left
//!             }
//!         }
//!         Err(error) => eprintln!("no scan: {error}"), // the stream continues
//!     }
//! #   count += 1;
//! #   if count == 3 { return Ok(()) }
//! }
//! # unreachable!("the stream ended");
//! # }
//! ```
//!
//! This runs without hardware, on the emulated sensor of the crate `urg-emulator`. The driver finds out
//! which protocol a sensor speaks: the URG-04LX and its contemporaries SCIP 1.1, later models
//! (UTM-30LX, UST-10LX) SCIP 2. [`Sensor::geometry`] tells what it measures, and
//! [`Scan::intensities`] are for a UTM or UST, on request.
//!
//! # Where to find what
//!
//! - [`Sensor`] is the handle: open it, send requests, make streams. [`SensorBuilder`] has all
//!   settings.
//! - [`ScanStream`] is a `Stream` of [`Scan`]s of a [`Window`] at a [`Rate`].
//! - [`Scan`] has values, measurements, ranges, rays and points. Methods named after the fields of
//!   ROS's `sensor_msgs/LaserScan` return these fields. [`scan`] also has poses.
//! - [`State`] is the state of the connection, [`Stats`] counts what happens on it, and
//!   [`Freshness`] is the age of the last good scan, for a health check. [`Error`] states what
//!   failed and what to do about it.
//! - [`port`] has the ways to reach a sensor. [`protocol`] and [`codec`] are the protocol itself,
//!   for programs that speak it without this driver.
//! - The [`guide`] explains how to use the driver well, what SCIP 1.1 [cannot
//!   promise](guide::trust), and [how the crate is built](guide::design). It has
//!   [recipes](guide::recipes) and a list of [common issues](guide::common_issues).
//!
//! # Features
//!
//! | feature | adds |
//! |---|---|
//! | `serial` (default) | serial ports: RS-232 and USB |
//! | `tcp` (default) | sensors on Ethernet, and serial servers such as ser2net |
//! | `simd` (default) | on x86, decodes SCIP 2 in half the time |
//! | `serde` | `Serialize` for scans, windows, versions, states and counters |
//!
//! [`SensorBuilder::attach`] and your own [`Connect`](port::Connect) need no feature.
//!
//! # Other crates
//!
//! `urg-emulator` is the sensor in software, `urg-recording` records into MCAP files and replays
//! them, and `urg` is the program: live view, recordings, a web page, ROS 2.
//!
//! # Cancel safety
//!
//! Dropping a cancel-safe future at any `.await` loses no data. All futures of this crate are
//! cancel-safe, except [`Driver`]: dropping it ends the driver.
//!
//! # Runtime
//!
//! You need tokio with its timer, and with I/O for serial ports and TCP. Each sensor has one
//! task. Calls that may wait in the system run on a thread of their own until they end: opening a
//! serial port, setting its baud rate, closing it, listing the ports, resolving a host name.
//!
//! # Versions
//!
//! The crate follows semantic versioning. Before 1.0 a breaking change raises the second number, any
//! other change the third. This covers the public API with its documented behaviour, the options and
//! output formats of `urg`, and the serialised forms. Texts of errors and log lines may change.
//!
//! Types that may grow are `#[non_exhaustive]`: all errors, [`State`], [`Endpoint`], the
//! counters, [`Operation`], [`Version`], [`RawReply`] and [`scan::Ray`]. So are the variants that only the crate
//! constructs. You can construct the other variants, for a [`Connect`](port::Connect) or a test.
//! [`protocol::Command`], [`BaudRate`] and [`Measurement`], which the protocol fixes, [`Point`] and
//! [`scan::Pose`] are exhaustive.
//!
//! Types of `tokio`, `tokio-util`, `futures-core`, `bytes` and `serde` in the API are part of it.
//!
//! The minimum Rust version is 1.88. A Rust release becomes the minimum at the earliest half a
//! year after it came out. That raises the second number of this crate's version.
// docs.rs builds with nightly and this cfg: each item shows the feature that it needs.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod codec;
mod driver;
mod error;
#[cfg(any(doc, doctest))]
pub mod guide;
pub mod port;
pub mod protocol;
mod rate;
mod ring;
pub mod scan;
mod sensor;
pub mod state;
pub mod stats;
pub mod stream;

pub use driver::{Driver, RawReply, ReplyObservation};
pub use error::{Error, ErrorChain, ErrorKind, Operation};
#[doc(inline)]
pub use port::Endpoint;
#[doc(inline)]
pub use protocol::{BaudRate, ErrorCode, Geometry, Measurement, Version, Window};
pub use rate::Rate;
#[doc(inline)]
pub use scan::{Point, Scan};
pub use sensor::{Sensor, SensorBuilder};
#[doc(inline)]
pub use state::{Freshness, State};
#[doc(inline)]
pub use stats::Stats;
#[doc(inline)]
pub use stream::ScanStream;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
