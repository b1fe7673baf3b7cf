//! Recordings of any bytes, and whole ones with changes: reading them ends, does no harm,
//! and finds the same records in the repaired file.

use std::io::Cursor;

use urg_recording::{Record, Recording, RecordingError, ReplayPace, repair};

use super::damaged_files::{MAGIC, damaged, short, without_checksums};
use super::script::Script;

/// Makes the file that a script describes.
fn file(script: &mut Script<'_>) -> Vec<u8> {
    match script.byte() % 4 {
        0 => script.take(usize::MAX).to_vec(),
        1 => [MAGIC, script.take(usize::MAX)].concat(),
        2 => damaged(short(), script),
        _ => damaged(&without_checksums(short()), script),
    }
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
        assert_eq!(scan.len(), scan.window().points());
    }
    // It may fail but not panic. Not in all cases, because it takes longer than the rest.
    if script.first().is_some_and(|first| first % 8 == 7) {
        let _ = Recording::read(Cursor::new(file)).unwrap().replay(ReplayPace::Max);
    }
}
