//! The PORT argument, and the sensor behind it: `name` parses it, `open` opens
//! it, `missing` is the hint for a command line without one.

pub(crate) mod missing;
pub(crate) mod name;
pub(crate) mod open;
