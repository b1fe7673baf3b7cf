//! SCIP 1.1 as plain values and bytes: encodes each command, and validates a reply
//! against its command. [`scip2`] does the same for SCIP 2.
//!
//! Nothing here does I/O, reads a clock or writes a log. "p. 6" is a page of C-42-3320-A.
//!
//! ```
//! use tokio_scip::protocol::{Command, Geometry, Measurement, Reply, Window};
//!
//! let command = Command::Distances(Window::new(384..=385)?);
//! let frame = b"G38438501\n0\nCB06"; // as received, without the two LFs at its end
//! let reply = Reply::parse(&command, frame)?;
//!
//! let meanings = reply.values().iter().map(|value| Geometry::URG_04LX.measurement((*value).into()));
//! let ranges: Vec<f32> = meanings.map(Measurement::range).collect();
//! assert_eq!(ranges, [1.234, f32::INFINITY]); // 1,234 mm, and error code 6
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod baud;
mod bytes;
mod codes;
mod command;
mod generation;
mod geometry;
mod malformed;
mod measurement;
mod parameter;
mod reply;
pub mod scip2;
mod status;
mod text;
mod version;
mod window;
mod wire_time;

#[doc(no_inline)]
pub use baud::BaudRate;
use bytes::Bytes;
use codes::Codes;
pub use command::Command;
pub use generation::Protocol;
#[doc(no_inline)]
pub use geometry::Geometry;
pub use malformed::{MalformedError, ReplyError};
#[doc(no_inline)]
pub use measurement::{ErrorCode, Measurement};
pub use parameter::ParameterError;
pub use reply::Reply;
pub use status::Status;
pub use text::Text;
pub use version::Specification;
#[doc(no_inline)]
pub use version::Version;
#[doc(no_inline)]
pub use window::Window;
pub use window::WindowError;
