//! Recordings as the program uses them: as a PORT, as a file to write, and
//! their contents. A build without the feature `mcap` has `absent` in place of
//! all that, and no other module needs to know.

#[cfg(not(feature = "mcap"))]
pub(crate) mod absent;
#[cfg(feature = "mcap")]
pub(crate) mod contents;
#[cfg(feature = "mcap")]
pub(crate) mod file;
#[cfg(feature = "mcap")]
pub(crate) mod progress;
#[cfg(feature = "mcap")]
pub(crate) mod recorded;
#[cfg(feature = "mcap")]
pub(crate) mod reel;
pub(crate) mod span;
#[cfg(feature = "mcap")]
pub(crate) mod split;

#[cfg(not(feature = "mcap"))]
pub(crate) use self::{absent as recorded, absent as reel};

/// Set if this build reads and writes recordings.
pub(crate) const AVAILABLE: bool = cfg!(feature = "mcap");
