//! The program's two outputs: data on standard output, all other text on
//! standard error. Neither blocks the driver, however slow its reader is.

pub(crate) mod notice;
pub(crate) mod stderr;
pub(crate) mod stdout;
