//! The program's two outputs: data on standard output, all other text on standard error.
//! A slow reader of either never blocks the driver.

#[cfg(feature = "dds")]
pub(crate) mod capture;
pub(crate) mod notice;
pub(crate) mod stderr;
pub(crate) mod stdout;
