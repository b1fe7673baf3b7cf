//! Recordings in this program: a recording as PORT, its contents, and the options and totals
//! of `urg record`.

pub(crate) mod contents;
pub(crate) mod recorded;
pub(crate) mod reel;
pub(crate) mod rewrite;
pub(crate) mod span;
pub(crate) mod split;
pub(crate) mod totals;
