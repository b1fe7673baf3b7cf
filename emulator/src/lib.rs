//! A Hokuyo laser range sensor in software, which speaks SCIP 1.1 or SCIP 2, to test a service
//! without hardware.
//!
//! [`Emulator`] behaves like a sensor of one [`Model`], by the protocol texts and by what is known
//! of real sensors. It answers their commands, keeps the state of its laser, its clock and its
//! baud rate, and needs as much time as a real sensor. It measures a [`Room`] with people in it, or
//! your own [`Scene`] or [`World`]. It injects [`Faults`] on demand. The same seed and the same
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
//! # Answers that the protocol texts leave open
//!
//! In SCIP 1.1:
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
//! emulator's choice, because the text only demands "an error status". A client that tries SCIP 2
//! first sees its commands refused and falls back, or sends `SCIP2.0` to a sensor that knows it
//! ([`Firmware::V31`]). A cluster count of `00` works as `01`. Lines of more than 64 bytes are cut
//! and refused.
//!
//! In SCIP 2, a model does what is known of it: `II` during a stream makes a UTM send halves of
//! scans, and the answer of a UST comes within a scan; after its echo a UST repeats the terminator of
//! the command, LF or CR; a command for intensities or several echoes locks a URG-04LX until its
//! power is cut. This emulator's choices are `0E` for an unknown command, `0C` for a short and `0D` for
//! a long one; a second stream replaces the first; in clock mode other commands are refused with `0E`,
//! by a UST with `10`; `GS` and `MS` send 4095 for what does not fit; `CR01` to `CR10` slow the motor
//! down by as many percent; after `BM`, a UTM or UST answers `GD` after a turn with the laser on.

mod body;
mod builder;
mod clock;
mod device;
mod faults;
mod format;
mod handle;
mod journal;
mod line_buffer;
mod link;
mod models;
mod motor;
mod playback;
mod random;
mod scip1;
mod scip2;
mod serve;
mod shared;
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
