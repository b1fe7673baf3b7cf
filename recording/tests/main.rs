//! Recordings: everything delivered is in the file, even if the file is cut off or
//! damaged, and a replay delivers it again byte for byte.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod any_time;
mod before;
mod common;
#[cfg(feature = "zstd")]
mod compress;
#[cfg(feature = "compression")]
mod compressed;
mod crash_and_full_disk;
mod drawn_parts;
mod events;
#[path = "../../tests/examples/example.rs"]
mod example;
mod examples;
mod field;
mod file;
#[cfg(unix)]
mod file_limit;
mod folder;
mod foreign;
mod foreign_scans;
mod histories;
mod hostile;
mod index;
mod latched;
mod memory;
mod models;
mod nine_sensors;
mod parts;
mod pieces;
mod properties;
mod raw;
#[cfg(feature = "compression")]
mod recompress;
mod repair;
mod replay;
mod requests;
mod ros;
mod scans;
mod sink;
mod split;
