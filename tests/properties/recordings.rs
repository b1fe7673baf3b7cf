//! Recordings of any bytes, and whole ones with changes: reading them ends, does no harm,
//! and finds the same records in the repaired file.

use std::io::Cursor;
use std::sync::OnceLock;

use tokio_scip::emulator::Emulator;
use tokio_scip::recording::{Record, Recorder, Recording, RecordingError, ReplayPace, repair};
use tokio_scip::{Rate, Sensor, Window};

use super::script::Script;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// The size of a chunk's header before its checksum: kind, length, start, end.
const CHUNK_CRC: usize = 9 + 8 + 8 + 8;
/// Lengths at and beyond the limits, which a careless reader would trust.
const LENGTHS: [u64; 8] = [0, 1, 40, 0xffff_ffff, 0x1_0000_0000, 1 << 63, u64::MAX, u64::MAX - 8];

/// A recording of three scans in two chunks, with metadata between them. It is small, so
/// that a fuzzer runs many cases.
fn whole() -> &'static [u8] {
    static WHOLE: OnceLock<Vec<u8>> = OnceLock::new();
    WHOLE.get_or_init(|| {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_time().start_paused(true).build().unwrap();
        runtime.block_on(async {
            let (out, file) = std::sync::mpsc::channel();
            let mut recorder = Recorder::builder().write_to(Pieces(out)).unwrap();
            let builder = Sensor::builder().on_reply(recorder.observer()).jitter_seed(7);
            let sensor = builder.connect(Emulator::default()).await.unwrap();
            let window = Window::new(380..=384).unwrap();
            let mut scans = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
            for scan in 0..3 {
                if scan != 1 {
                    recorder.describe(&sensor, &scans).await.unwrap();
                }
                recorder.record(&scans.next().await.unwrap()).unwrap();
            }
            recorder.finish().await.unwrap();
            file.try_iter().flatten().collect()
        })
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

/// Makes the file that a script describes.
fn file(script: &mut Script<'_>) -> Vec<u8> {
    let mut file = match script.byte() % 4 {
        0 => return script.take(usize::MAX).to_vec(),
        1 => return [MAGIC, script.take(usize::MAX)].concat(),
        2 => whole().to_vec(),
        _ => without_checksums(whole()),
    };
    while !script.is_over() {
        let kind = script.byte();
        let at = script.below(file.len().max(1));
        match kind % 7 {
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
            _ => {
                let end = (at + script.below(600)).min(file.len());
                let again = file[at..end].to_vec();
                file.extend(again);
            }
        }
    }
    file
}

/// Removes the checksum of each chunk, so that it does not reveal changes.
fn without_checksums(whole: &[u8]) -> Vec<u8> {
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

/// Returns all records of a file, the number of errors, and whether its end is missing.
fn read(file: &[u8]) -> Result<(Vec<Record>, usize, bool), RecordingError> {
    let mut recording = Recording::read(Cursor::new(file.to_vec()))?;
    let (mut records, mut errors) = (Vec::new(), 0);
    for item in recording.by_ref() {
        match item {
            Ok(record) => records.push(record),
            Err(RecordingError::Damaged { offset, .. }) => {
                assert!(offset <= file.len() as u64);
                errors += 1;
            }
            Err(error) => return Err(error),
        }
        assert!(records.len() + errors <= file.len(), "more than there are bytes");
    }
    assert!(recording.next().is_none());
    Ok((records, errors, recording.is_truncated()))
}

/// Any file is read to an end; every record read from it is also in the repaired file,
/// which is complete; and its scans have as many points as they must.
pub(crate) fn any_file_is_read_and_repaired(script: &[u8]) {
    let file = file(&mut Script::new(script));
    let mut repaired = Vec::new();
    let repair = repair(Cursor::new(file.clone()), &mut repaired);
    let Ok((records, errors, is_truncated)) = read(&file) else {
        assert!(repair.is_err());
        return;
    };
    let repair = repair.unwrap();
    assert_eq!(repair.was_truncated, is_truncated);
    assert!(errors > 0 || repair.damaged_parts == 0);
    let (again, _, is_truncated) = read(&repaired).unwrap();
    assert!(!is_truncated);
    // NaN is not equal to itself, but looks the same.
    let is_same = |(record, again): (&Record, &Record)| {
        record == again || format!("{record:?}") == format!("{again:?}")
    };
    assert_eq!(again.len(), records.len());
    assert!(records.iter().zip(&again).all(is_same), "{records:?} became {again:?}");

    let recording = Recording::read(Cursor::new(file.clone())).unwrap();
    for scan in recording.scans().flatten() {
        assert_eq!(scan.values().len(), scan.window().points());
    }
    // It may fail but not panic. Not in all cases, because it takes longer than the rest.
    if script.first().is_some_and(|first| first % 8 == 7) {
        let _ = Recording::read(Cursor::new(file)).unwrap().replay(ReplayPace::Max);
    }
}
