//! SCIP 2 as plain values and bytes: encodes each command, and validates a reply against its request.
//!
//! Nothing here does I/O, reads a clock or writes a log. A frame is what lies between two
//! terminators of two LFs. "p. 6" and the like are pages of the protocol text, C-42-03320B. What
//! the text leaves open comes from captures of real sensors and from drivers that ran on them.
//!
//! ```
//! use tokio_scip::Window;
//! use tokio_scip::protocol::scip2::{Command, Content, Data, Label, Reply, Request};
//!
//! let window = Window::new(384..=385)?;
//! let command = Command::Latest { data: Data::Distances, window };
//! let request = Request::new(command, Label::numbered(0x5eed));
//! assert_eq!(request.bytes(), b"GD0384038501;00005xjj");
//!
//! let frame = b"GD0384038501;00005xjj\n00P\n01_2b\n0CB>ooA";
//! let Content::Scan(scan) = Reply::parse(&request, frame)?.content else { panic!() };
//! assert_eq!(scan.distances(), [1234, 61439]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What is not supported
//!
//! Commands for several echoes a step (`HD`, `HE`, `ND`, `NE`) and the frames of UAM safety scanners
//! (`AR`, `DL`, between STX and ETX). Replies of either kind are refused with an error that says so.
//!
//! # What a sum cannot see
//!
//! Each line after the echo ends with the low six bits of its sum. In a scan no single flipped bit
//! passes. But **two neighbours swapped always pass**, 2.2 % of two flipped bits do, and 0.09 % of two
//! random characters (3,872 lines of real sensors). In the texts of `VV`, `PP` and `II` bit 6 of a
//! character can change unseen, `H0706400` into `Hp706400`, but not in a status or a number of `PP`.
//!
//! The echo has no sum, so it must equal the request. Only the number of scans left, in the echo of a
//! [`Stream`] with an end, can change unseen. `II` may leave the text after `<-` out of its sums, and
//! may lose whole lines. Some URG-04LX send a wrong sum of the serial number, and a line more.

mod command;
mod data;
mod identity;
mod label;
mod lines;
mod reply;
mod status;

pub use command::{Command, Data, MotorSpeed, Request, Stream};
pub use data::{Scan, Stamp};
pub use identity::{Parameters, State};
pub use label::Label;
pub(crate) use lines::has_data;
pub use reply::{Content, Reply};
pub use status::Status;
