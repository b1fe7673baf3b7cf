//! The forms in which scans, times and other data are written: for people, and
//! for programs.

pub(crate) mod csv;
pub(crate) mod json;
pub(crate) mod summary;
pub(crate) mod svg;
pub(crate) mod table;
pub(crate) mod time;
