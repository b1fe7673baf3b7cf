//! A part of a recording of any bytes: it is the same whether the file's index leads to it
//! or the file is read from its beginning.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use tokio_scip::protocol::Command;
use urg_recording::{Entry, Record, Recording, RecordingError};

use super::damaged_files::{damaged, of_eight_chunks, with_checksum_of_index, without_checksums};
use super::script::Script;

/// Returns the part that a script asks for, from the first scan of the file on. The file has 14 s.
fn range(script: &mut Script<'_>) -> std::ops::Range<Duration> {
    let tenths = |byte| Duration::from_millis(100 * u64::from(byte));
    let from = tenths(script.byte());
    let length =
        if script.byte().is_multiple_of(2) { Duration::MAX } else { tenths(script.byte()) };
    from..from.saturating_add(length)
}

/// Writes a file, as the index is used of files only. It is in memory where the system has a
/// folder for that.
fn write(bytes: &[u8]) -> PathBuf {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let thread = format!("{:?}", std::thread::current().id());
    let number = thread.replace(|letter: char| !letter.is_ascii_digit(), "");
    let path = folder.join(format!("tokio-scip-part-{}-{number}", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Reads a part to its end; `Err` if the file is none of a recording.
fn read(
    recording: Result<Recording, RecordingError>,
    range: Option<&std::ops::Range<Duration>>,
    most: usize,
) -> Result<Vec<Record>, RecordingError> {
    let recording = match range {
        Some(range) => recording?.range(range.clone()),
        None => recording?,
    };
    let mut records = Vec::new();
    for (number, item) in recording.enumerate() {
        assert!(number < most, "more than there are bytes");
        match item {
            Ok(record) => records.push(record),
            Err(RecordingError::Damaged { offset, .. }) => assert!(offset <= most as u64),
            Err(error) => return Err(error),
        }
    }
    Ok(records)
}

/// NaN is not equal to itself, but looks the same.
fn is_same(one: &Record, other: &Record) -> bool {
    one == other || format!("{one:?}") == format!("{other:?}")
}

/// Returns the number of the first scan, from whose time a range counts.
fn first_scan(records: &[Record]) -> Option<usize> {
    let is_scan = |record: &Record| match &record.entry {
        Entry::Scan(_) => true,
        Entry::Reply(reply) => matches!(reply.command, Some(Command::Distances(_))),
        _ => false,
    };
    records.iter().position(is_scan)
}

fn is_version(record: &Record) -> bool {
    matches!(&record.entry, Entry::Reply(reply) if reply.command == Some(Command::Version))
}

/// Whatever is in the file, a part of it is read to an end and has no record of another
/// time. Its time counts from the first scan that can be read in the file: definitions that
/// are damaged at its beginning are taken from its index. Unless the index itself was forged, or the chunks have no checksum, the part has
/// all that reading from the beginning finds, in the same order, and nothing that was not
/// recorded. It may have more: after what is left out, no damage is in the way.
pub(crate) fn the_index_leads_to_the_same_part(script: &[u8]) {
    let mut script = Script::new(script);
    let (kind, range) = (script.byte(), range(&mut script));
    let whole = of_eight_chunks();
    let (is_believable, file) = match kind % 4 {
        0 => (false, damaged(&without_checksums(whole), &mut script)),
        1 => (false, with_checksum_of_index(damaged(whole, &mut script))),
        _ => (true, damaged(whole, &mut script)),
    };
    let path = write(&file);
    let most = file.len();
    let searched = read(Recording::open(&path), Some(&range), most);
    let scans = Recording::open(&path).map(|recording| recording.range(range.clone()).scans());
    for scan in scans.into_iter().flatten().flatten() {
        assert_eq!(scan.len(), scan.window().points());
    }
    let all = read(Recording::open(&path), None, most);
    std::fs::remove_file(path).unwrap();
    let (Ok(searched), Ok(all)) = (searched, all) else { return };
    // What is before the first scan in the file is at its time.
    let (before, began) = match first_scan(&all) {
        Some(first) => (&all[..first], all[first].at),
        None => (&all[..], SystemTime::UNIX_EPOCH),
    };
    for record in &searched {
        let since = record.at.duration_since(began).unwrap_or_default();
        let is_inside = range.contains(&since) || before.iter().any(|known| is_same(known, record));
        assert!(is_inside || is_version(record), "{record:?} is not in {range:?}");
    }
    if !is_believable {
        return;
    }
    let from_its_beginning = Recording::read(Cursor::new(file.clone()));
    let expected = read(from_its_beginning, Some(&range), most).unwrap();
    let mut found = searched.iter();
    for record in &expected {
        assert!(found.any(|found| is_same(found, record)), "{record:?} is missing in {range:?}");
    }
    let recorded =
        read(Ok(Recording::read(Cursor::new(whole)).unwrap()), None, whole.len()).unwrap();
    for record in &searched {
        let is_known = expected.iter().chain(&recorded).any(|known| is_same(known, record));
        assert!(is_known, "{record:?} was not recorded");
    }
    if all.len() == recorded.len()
        && all.iter().zip(&recorded).all(|(one, other)| is_same(one, other))
    {
        assert_eq!(searched.len(), expected.len());
    }
}
