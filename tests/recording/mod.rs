//! Recordings: everything delivered is in the file, even if the file is cut off or
//! damaged, and a replay delivers it again byte for byte.

mod crash_and_full_disk;
mod events;
mod file;
mod hostile;
mod memory;
mod parts;
mod raw;
mod repair;
mod replay;
mod scans;
mod sink;
mod split;
