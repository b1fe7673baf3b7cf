//! The PORT argument, and the sensor behind it: `name` parses it, `named` one with
//! a name before it, `placed` one with a place behind it; `open` opens it, `missing` is
//! the hint for a command line without one, and `sampled` shows what else a port sent.

pub(crate) mod missing;
pub(crate) mod name;
pub(crate) mod named;
pub(crate) mod open;
pub(crate) mod placed;
mod sampled;
