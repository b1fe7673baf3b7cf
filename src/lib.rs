//! An async driver for Hokuyo URG laser range sensors that speak SCIP 1.1.
//!
//! A URG is a small laser scanner. Ten times a second it measures the distance, 20
//! mm to 4 m, in each of 682 directions around it. With this crate an async service
//! awaits its scans, day and night, unattended. Every scan is whole and is the answer
//! to the request it is attached to. Scans continue by themselves after a cable was
//! pulled and put back.
//!
//! # Which sensors
//!
//! Those that speak SCIP 1.1, the protocol of Hokuyo's document C-42-3320-A: the
//! URG-04LX and URGs of its time, over USB or RS-232. Later models (UTM-30LX,
//! UST-10LX) know only SCIP 2; opening one fails with [`Error::WrongProtocol`]. A
//! URG-04LX that another program has switched to SCIP 2 is back in SCIP 1.1 after a
//! power-cycle.
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
//!         Err(error) => eprintln!("no scan: {error}"), // the stream continues
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Without a sensor, the same program runs on one in software (feature `emulator`),
//! an [`emulator::Emulator`]:
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
//! - [`Sensor`] is the handle to a sensor: open it, send requests, make streams.
//!   [`SensorBuilder`] sets everything that `open` has a default for.
//! - [`ScanStream`] is a `Stream` of [`Scan`]s of a [`Window`] at a [`Rate`].
//! - [`Scan`] has values, measurements, ranges and points. Methods named after the
//!   fields of ROS's `sensor_msgs/LaserScan` return these fields.
//! - [`State`] is the state of the connection, [`Stats`] are its counters, and
//!   [`Freshness`] is the age of the last good scan, for a health check. [`Error`]
//!   states what failed and what to do about it.
//! - [`port`] has the ways to reach a sensor. [`protocol`] and [`codec`] are the
//!   protocol itself, for programs that speak it without this driver.
//! - The [`guide`] explains polling, trust, recovery, baud rates, geometry, testing,
//!   operating and logging. It has [recipes](guide::recipes), [how the crate is
//!   built](guide::design), and [why](guide::rationale).
//!
//! # Features
//!
//! | feature | adds |
//! |---|---|
//! | `serial` (default) | serial ports: RS-232 and USB |
//! | `serde` | scans, windows, versions, states and counters as data |
//! | `emulator` | a sensor in software, to test a service without hardware |
//! | `ros` | scans and diagnostics as ROS 2 messages (CDR) |
//! | `mcap` | recordings that ROS 2's tools open, and their replay |
//! | `cli` | the program `urg` |
//! | `web` | `urg serve`: a live page for any browser, and scans over HTTP |
//! | `ros2` | `urg publish`: scans and diagnostics in ROS 2, over DDS |
//! | `zenoh` | `urg publish --engine zenoh`: the same as `rmw_zenoh` carries them |
//!
//! `serial` is the only default feature. TCP, [`Sensor::attach`] and your own
//! [`Connect`] need no feature.
//!
//! # Cancel safety
//!
//! A future is *cancel-safe* if dropping it at any await loses nothing and disturbs
//! nothing. All futures of this crate are, except [`Driver`]: dropping it ends the
//! driver.
//!
//! # Runtime
//!
//! Tokio with its timer, and with I/O for serial ports and TCP. Each sensor has one
//! task and no thread. Opening a serial port, looking through the ports, and resolving
//! a host name each use one of the runtime's blocking threads meanwhile.
//!
//! # Versions
//!
//! Versions are semantic. Before 1.0 a breaking change raises the second number, any
//! other change the third. Covered are the public API with its documented behaviour,
//! the options and output formats of `urg`, and the serialised forms. Texts of errors
//! and log lines may change at any time.
//!
//! Types that may grow are `#[non_exhaustive]`: all errors, [`State`], [`Endpoint`], the
//! counters, [`Version`] and [`RawReply`]. Of their kinds those that only the driver
//! makes may get more fields: [`Error`] marks them, and [`State::Connected`]. The other
//! kinds are complete, so that a [`Connect`] or a test can make them. Complete as a whole
//! are [`protocol::Command`], [`BaudRate`] and [`Measurement`], which the protocol fixes,
//! and [`Point`].
//!
//! The types of `tokio`, `tokio-util`, `futures-core`, `bytes` and `serde` in the API
//! are part of it.
//!
//! The minimum Rust is 1.88. A new minimum is at least half a year old when it is
//! raised. Raising it raises the second number before 1.0, and the minor one after.
#![cfg_attr(not(feature = "emulator"), allow(rustdoc::broken_intra_doc_links))]
// docs.rs builds with nightly and this cfg: each item shows the feature that it needs.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod codec;
mod driver;
#[cfg(feature = "emulator")]
pub mod emulator;
mod error;
mod event;
#[cfg(any(doc, doctest))]
pub mod guide;
mod observer;
pub mod port;
pub mod protocol;
mod rate;
#[cfg(feature = "mcap")]
pub mod recording;
mod ring;
#[cfg(feature = "ros")]
pub mod ros;
mod scan;
mod sensor;
mod state;
mod stream;

pub use driver::Driver;
pub use error::{Error, ErrorChain};
pub use event::{Event, Events, InvalidEvent};
pub use observer::RawReply;
pub use port::{Connect, Endpoint, Port};
pub use protocol::{BaudRate, ErrorCode, Measurement, Version, Window, WindowError};
pub use rate::{InvalidRate, Rate};
pub use scan::{InvalidScan, Point, Scan, ScanBuilder};
pub use sensor::{Sensor, SensorBuilder};
pub use state::{Freshness, LatencyStats, MalformedCounts, ScheduleStats, Stale, State, Stats};
pub use stream::{OnlyScans, ScanStream, StreamBuilder};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
