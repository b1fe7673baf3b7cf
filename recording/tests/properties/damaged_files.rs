//! Recordings for the properties that hold for any bytes: small whole ones, and the changes
//! that a script makes to them.

#![allow(dead_code, reason = "each fuzz target uses a part of it")]

use std::sync::OnceLock;
use std::time::Duration;

use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::Emulator;
use urg_recording::Recorder;

use super::script::Script;

pub(crate) const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Size of a chunk's header before its checksum: kind, length, start, end.
const CHUNK_CRC: usize = 9 + 8 + 8 + 8;
/// Checksum of the index, and the magic after it.
const INDEX_CRC: usize = 4 + 8;
/// Lengths at and beyond the limits, which a careless reader would trust.
const LENGTHS: [u64; 8] = [0, 1, 40, 0xffff_ffff, 0x1_0000_0000, 1 << 63, u64::MAX, u64::MAX - 8];

/// Returns a recording of three scans in two chunks, with metadata between them. It is
/// small, so that a fuzzer runs many cases.
pub(crate) fn short() -> &'static [u8] {
    static FILE: OnceLock<Vec<u8>> = OnceLock::new();
    FILE.get_or_init(|| recorded(3, Rate::hz(10.0), &[0, 2]))
}

/// Returns a recording of eight scans, each in a chunk of its own, with metadata at the
/// beginning and before the sixth.
pub(crate) fn of_eight_chunks() -> &'static [u8] {
    static FILE: OnceLock<Vec<u8>> = OnceLock::new();
    FILE.get_or_init(|| recorded(8, Rate::every(Duration::from_secs(2)), &[0, 5]))
}

/// Records this many scans, with metadata before the scans of these numbers.
fn recorded(scans: usize, rate: Rate, described: &[usize]) -> Vec<u8> {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    runtime.block_on(async {
        let (out, file) = std::sync::mpsc::channel();
        let mut recorder = Recorder::builder().write_to(Pieces(out)).unwrap();
        fastrand::seed(7);
        let builder = Sensor::builder().on_reply(recorder.observer());
        let sensor = builder.connect(Emulator::default()).await.unwrap();
        let window = Window::new(380..=384).unwrap();
        let mut stream = sensor.scans(window, rate).await.unwrap();
        for number in 0..scans {
            if described.contains(&number) {
                recorder.describe(&sensor, &stream).await.unwrap();
            }
            recorder.record(&stream.next().await.unwrap()).unwrap();
        }
        recorder.finish().await.unwrap();
        file.try_iter().flatten().collect()
    })
}

struct Pieces(std::sync::mpsc::Sender<Vec<u8>>);

impl std::io::Write for Pieces {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let _ = self.0.send(bytes.to_vec());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Changes a file as the rest of a script says.
pub(crate) fn damaged(whole: &[u8], script: &mut Script<'_>) -> Vec<u8> {
    let mut file = whole.to_vec();
    while !script.is_over() {
        let kind = script.byte();
        let at = script.below(file.len().max(1));
        match kind % 8 {
            0 => {
                if let Some(byte) = file.get_mut(at) {
                    *byte ^= 1 << (kind >> 5);
                }
            }
            1 => {
                let length = LENGTHS[usize::from(script.byte()) % LENGTHS.len()].to_le_bytes();
                let place = file.iter_mut().skip(at);
                place.zip(length).for_each(|(byte, new)| *byte = new);
            }
            2 => {
                let new = u64::from(script.number()).to_le_bytes();
                file.iter_mut().skip(at).zip(new).for_each(|(byte, new)| *byte = new);
            }
            3 => file.truncate(at),
            4 => {
                let new = script.take(usize::from(kind >> 3)).to_vec();
                file.splice(at..at, new);
            }
            5 => {
                let end = (at + script.below(200)).min(file.len());
                file.drain(at..end);
            }
            6 => {
                let end = (at + script.below(600)).min(file.len());
                let again = file[at..end].to_vec();
                file.extend(again);
            }
            // Bytes that are missing in one place and too many in another: the file has its
            // length, and its index is whole.
            _ => {
                let end = (at + script.below(2000)).min(file.len());
                let moved = &mut file[at..end];
                moved.rotate_left(usize::from(kind >> 3).min(moved.len()));
            }
        }
    }
    file
}

/// Removes the checksum of each chunk, so that it does not reveal changes.
pub(crate) fn without_checksums(whole: &[u8]) -> Vec<u8> {
    let mut file = whole.to_vec();
    let mut at = MAGIC.len();
    while let Some((&kind, length)) = file.get(at..at + 9).and_then(<[u8]>::split_first) {
        let length = u64::from_le_bytes(length.try_into().unwrap()) as usize;
        if kind == 6 {
            file[at + CHUNK_CRC..at + CHUNK_CRC + 4].fill(0);
        }
        at += 9 + length;
    }
    file
}

/// Writes the checksum of the index anew, so that it does not reveal changes.
pub(crate) fn with_checksum_of_index(mut file: Vec<u8>) -> Vec<u8> {
    // Magic, checksum, and the places of the summary and of its offsets.
    let Some(crc) = file.len().checked_sub(INDEX_CRC) else { return file };
    let Some(start) = crc.checked_sub(16).and_then(|at| file.get(at..at + 8)) else { return file };
    let start = u64::from_le_bytes(start.try_into().unwrap());
    let covered = usize::try_from(start).ok().and_then(|start| file.get(start..crc));
    if let Some(hash) = covered.map(crc32fast::hash) {
        file[crc..crc + 4].copy_from_slice(&hash.to_le_bytes());
    }
    file
}
