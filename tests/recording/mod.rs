//! Recordings: everything delivered is in the file, even if the file is cut off or
//! damaged, and a replay delivers it again byte for byte.

mod any_time;
#[cfg(feature = "compression")]
mod compressed;
mod crash_and_full_disk;
mod events;
mod field;
mod file;
mod foreign;
mod hostile;
mod index;
mod memory;
mod parts;
mod pieces;
mod raw;
mod repair;
mod replay;
mod scans;
mod sink;
mod split;
