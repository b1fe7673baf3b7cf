//! Recordings in this program: a recording as PORT, its contents, and its rewriting.

pub(crate) mod clock;
pub(crate) mod contents;
pub(crate) mod recorded;
pub(crate) mod reel;
pub(crate) mod rewrite;
mod sensor_clock;
pub(crate) mod span;
