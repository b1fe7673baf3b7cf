//! Wall clock of the recordings. With the system's clock each run would make other bytes, and damage
//! would look different.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use tokio::time::Instant;
use tokio_scip::{RawReply, Scan};

use super::file::read;
use crate::raw::MAGIC;

/// Stamp of a reply that arrives when the clock is made, in nanoseconds since 1970.
const BEGAN: u64 = 1_760_000_000_123_456_789;
/// Time from the stamp of a message to its log time.
const LOG_DELAY: u64 = 3_000_000;

/// Clock that follows tokio's paused one.
#[derive(Clone)]
pub(super) struct Wall {
    began: Instant,
    /// Stamps of replies and of their scans, by the stamps of the system's clock.
    stamps: Arc<Mutex<BTreeMap<SystemTime, SystemTime>>>,
}

impl Wall {
    pub(super) fn new() -> Self {
        Self { began: Instant::now(), stamps: Arc::default() }
    }

    pub(super) fn reply<'a>(&self, mut reply: RawReply<'a>) -> RawReply<'a> {
        reply.stamp = self.stamp(reply.stamp, reply.received_at);
        reply
    }

    pub(super) fn scan(&self, scan: &Scan) -> Scan {
        let values: Vec<u32> = scan.raw_values().collect();
        let builder = Scan::builder(scan.window(), values).like(scan);
        let builder = builder.intensities(scan.intensities().unwrap_or_default());
        builder.stamp(self.stamp(scan.times().stamp, scan.received_at())).build().unwrap()
    }

    fn stamp(&self, system: SystemTime, received_at: Instant) -> SystemTime {
        let mut stamps = self.stamps.lock().unwrap();
        // No two replies arrive at once.
        let number = Duration::from_micros(stamps.len() as u64);
        let began = SystemTime::UNIX_EPOCH + Duration::from_nanos(BEGAN);
        *stamps.entry(system).or_insert(began + (received_at - self.began) + number)
    }
}

/// Sets the log times of a recording, which run from the system's clock. Its files must have no
/// compression.
pub(super) fn set_log(files: &mut [Vec<u8>]) {
    let Some(last) = files.iter().rev().find_map(|file| read(file).unwrap().pop()) else { return };
    let by = (last.publish_time + LOG_DELAY).wrapping_sub(last.log_time);
    files.iter_mut().for_each(|file| move_log(file, by));
}

fn move_log(file: &mut [u8], by: u64) {
    let (mut at, mut summary) = (MAGIC.len(), 0);
    while at + MAGIC.len() < file.len() {
        let (kind, begin) = (file[at], at + 9);
        at = begin + u64_at(file, at + 1) as usize;
        let content = &mut file[begin..at];
        match kind {
            0x06 => {
                move_times(content, &[0, 8], by);
                let records = &mut content[40..];
                let mut at = 0;
                while at < records.len() {
                    if records[at] == 0x05 {
                        move_times(records, &[at + 9 + 6], by);
                    }
                    at += 9 + u64_at(records, at + 1) as usize;
                }
                let crc = crc32fast::hash(records);
                content[24..28].copy_from_slice(&crc.to_le_bytes());
            }
            0x07 => {
                let entries: Vec<usize> = (6..content.len()).step_by(16).collect();
                move_times(content, &entries, by);
            }
            0x08 => move_times(content, &[0, 8], by),
            // Statistics.
            0x0b => move_times(content, &[26, 34], by),
            0x0f => summary = at,
            0x02 => {
                let crc = crc32fast::hash(&file[summary..begin + 16]);
                file[begin + 16..at].copy_from_slice(&crc.to_le_bytes());
            }
            _ => {}
        }
    }
}

fn move_times(bytes: &mut [u8], places: &[usize], by: u64) {
    for place in places {
        let time = u64_at(bytes, *place).wrapping_add(by);
        bytes[*place..place + 8].copy_from_slice(&time.to_le_bytes());
    }
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}
