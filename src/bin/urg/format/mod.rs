//! A scan as text: for eyes, and for programs.

pub(crate) mod csv;
pub(crate) mod json;
pub(crate) mod svg;
pub(crate) mod table;
pub(crate) mod time;
