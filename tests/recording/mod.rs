//! Recordings: what was delivered is in the file, whatever became of the file,
//! and comes out of it again byte for byte.

mod crash_and_full_disk;
mod events;
mod file;
mod hostile;
mod repair;
mod replay;
mod scans;
mod sink;
mod split;
