//! A Hokuyo URG laser range sensor in software, which speaks SCIP 1.1, to test a service without
//! hardware.
//!
//! [`Emulator`] behaves like a URG sensor, by the protocol text and by what is known of real
//! sensors. It answers `V`, `L`, `S` and `G`, keeps the state of its laser and its baud rate,
//! and needs as much time as a real sensor. It measures a [`Room`] with people in it, or your
//! own [`Scene`] or [`World`]. It injects [`Faults`] on demand. The same seed and the same
//! commands at the same times give the same bytes.
//!
//! ```
//! use tokio::io::{AsyncReadExt, AsyncWriteExt};
//! use urg_emulator::{Emulator, Fixed};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> std::io::Result<()> {
//! let emulator = Emulator::builder().world(Fixed::filled(1234)).build();
//! let mut link = emulator.link();
//! link.write_all(b"G38438401\n").await?;
//! let mut reply = [0; 16];
//! link.read_exact(&mut reply).await?;
//! assert_eq!(&reply, b"G38438401\n0\nCB\n\n");
//! # Ok(())
//! # }
//! ```
//!
//! # Ways to connect to it
//!
//! - [`Emulator::link`] opens a [`Link`] in memory, which is a
//!   [`Port`](tokio_scip::port::Port) with a baud rate.
//! - `Emulator` is a [`Connect`](tokio_scip::port::Connect): each connection is a new link to the
//!   same sensor. You can unplug it and plug it in again.
//! - To serve it to other programs, use [`Emulator::serve`] on any stream,
//!   [`Emulator::serve_tcp`] on TCP, or `Pty` on a pseudo-terminal (Unix, with feature
//!   `pty`).
//!
//! # Answers that the protocol text leaves open
//!
//! | command | status |
//! |---|---|
//! | `L` for the state that the laser is in already | `0`, or `2` ([`RepeatedLaser`]) |
//! | `S` for the baud rate that is set already, or on USB ([`Firmware::V3`]) | `3` |
//! | `G` while the laser is off | `6` |
//! | `SCIP2.0` ([`Firmware::V3`]; no answer from [`Firmware::Text`]) | `C` |
//! | another undefined command (the same) | `E` |
//! | a wrong number of bytes, also `VV` and `GD` of SCIP 2 | `1` |
//! | a control code, baud rate, step or cluster that does not exist | `4` |
//! | starting point greater than end point | `5` |
//!
//! The first five come from drivers that ran on real sensors. The other three are this
//! emulator's choice, because the text only demands "an error status". It plays a sensor that
//! knows only SCIP 1.1. A client that tries SCIP 2 first sees its commands refused and falls
//! back; the URG driver of Player does, and then reads all scans. A cluster count of `00`
//! works as `01`. Lines of more than 64 bytes are cut and refused.

mod body;
mod builder;
mod clock;
mod device;
mod faults;
mod handle;
mod journal;
mod line_buffer;
mod link;
mod models;
mod motor;
mod playback;
mod random;
mod reply;
mod scip1;
mod scip2;
mod serve;
mod shared;
mod source;
mod timed_device;
mod timing;
mod wire;
mod world;

pub use self::builder::EmulatorBuilder;
pub use self::device::Mode;
pub use self::faults::{Fault, Faults, FaultsError};
pub use self::handle::Emulator;
pub use self::journal::{Counts, Received, SentScan, Verdict};
pub use self::link::Link;
pub use self::models::Model;
pub use self::playback::{ReplayPace, Script};
pub use self::scip1::{EmptyCommand, Firmware, RepeatedLaser};
pub use self::scip2::Quirk;
#[cfg(all(unix, feature = "pty"))]
pub use self::serve::Pty;
pub use self::timing::Pace;
pub use self::world::{Fixed, Path, Room, STEPS, Scene, Sparse, Values, Walk, World, WorldTime};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
