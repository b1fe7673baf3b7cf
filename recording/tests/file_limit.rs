//! A file that may not grow, because of its file system or a limit of the process (EFBIG): the
//! recording continues in a further file.

use std::io;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use rustix::process::{Resource, Rlimit, setrlimit};
use tokio::time::Instant;
use tokio_scip::{Rate, Scan, Window};
use urg_recording::{Entry, Progress, Recorder, Recording, RecordingError};

use super::sink::{observed, polls, sensor};
use super::split::{folder, parts};

const SCANS: u32 = 350;
/// Length of the end of a file without an index.
const END_BYTES: u64 = 50;
/// More than its index needs here.
const INDEX_BYTES: u64 = 20_000;
/// Set in the process that has the limit.
const IN_CHILD: &str = "SCIP_FILE_LIMIT";

/// Records 35 s into files of at most this length.
async fn record(path: &Path, limit: Option<u64>) -> Result<Progress, RecordingError> {
    setrlimit(Resource::Fsize, Rlimit { current: limit, maximum: None }).unwrap();
    let mut recorder = Recorder::create(path)?;
    let (sensor, mut scans) =
        observed(&recorder, sensor(), Window::DETECTION, Rate::hz(10.0)).await;
    recorder.describe(&sensor, &scans).await.unwrap();
    for _ in 0..SCANS {
        recorder.record(&scans.next().await.unwrap())?;
    }
    drop(scans);
    recorder.finish().await
}

/// What other programs and this one find in a file.
struct Part {
    bytes: u64,
    scans: Vec<u32>,
    polls: usize,
    is_complete: bool,
    summary: Option<mcap::Summary>,
}

fn read(path: &Path) -> Part {
    let mut recording = Recording::open(path).unwrap();
    let records: Vec<_> = recording.by_ref().collect::<Result<_, _>>().unwrap();
    let scans = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_)));
    let bytes = std::fs::read(path).unwrap();
    Part {
        bytes: bytes.len() as u64,
        scans: scans.map(|record| record.sequence).collect(),
        polls: polls(&records).len(),
        is_complete: !recording.is_truncated(),
        summary: mcap::Summary::read(&bytes).unwrap_or_default(),
    }
}

#[tokio::test(start_paused = true)]
async fn a_recording_continues_after_a_file_that_may_not_grow() {
    if std::env::var_os(IN_CHILD).is_none() {
        // The limit holds for a whole process, and other tests write files in this one.
        let name = "file_limit::a_recording_continues_after_a_file_that_may_not_grow";
        let child = Command::new("sh")
            .args(["-c", "trap '' XFSZ; exec \"$0\" --exact \"$1\""])
            .arg(std::env::current_exe().unwrap())
            .args([name])
            .env(IN_CHILD, "1")
            .output()
            .unwrap();
        assert!(child.status.success(), "{}", String::from_utf8_lossy(&child.stdout));
        return;
    }
    let whole = folder("file-limit").join("whole.mcap");
    let progress = record(&whole, None).await.unwrap();
    assert!(!progress.has_outgrown_file);
    let whole = read(&whole);
    let chunks = whole.summary.unwrap().chunk_indexes;
    let end = |chunk: usize| {
        let chunk = &chunks[chunk];
        chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
    };
    // Room after a chunk: for less than the end of a file, for the end alone, for the index too.
    let rooms =
        [5, 25].into_iter().flat_map(|after| [20, 60, 30_000].map(|room| end(after) + room));
    // No room for the last chunk, which `finish` writes.
    for limit in rooms.chain([end(chunks.len() - 1) - 1]) {
        let path = folder("file-limit").join("run.mcap");
        let progress = record(&path, Some(limit)).await.unwrap();
        assert!(progress.has_outgrown_file);
        assert_eq!((progress.lost, progress.lost_replies), (0, 0));
        let parts: Vec<_> = parts(&path).iter().map(|path| read(path)).collect();
        assert_eq!(progress.files, parts.len() as u64);
        assert_eq!(progress.bytes, parts.iter().map(|part| part.bytes).sum::<u64>());
        let scans: Vec<_> = parts.iter().flat_map(|part| part.scans.clone()).collect();
        assert_eq!(scans, (0..SCANS).collect::<Vec<_>>());
        assert_eq!(parts.iter().map(|part| part.polls).sum::<usize>(), SCANS as usize);
        for (number, part) in parts.iter().enumerate() {
            let room = limit - part.bytes;
            assert!(part.is_complete || number == 0 && room < END_BYTES, "{limit}: {room}");
            assert!(part.summary.is_some() || number == 0 && room < INDEX_BYTES, "{limit}: {room}");
        }
    }

    // Without a reply and metadata, further files have the definitions of their messages, too.
    let path = folder("file-limit").join("run.mcap");
    setrlimit(Resource::Fsize, Rlimit { current: Some(100_000), maximum: None }).unwrap();
    let mut recorder = Recorder::create(&path).unwrap();
    for sequence in 0..SCANS.into() {
        tokio::time::advance(Duration::from_millis(100)).await;
        let scan = Scan::builder(Window::DETECTION, vec![500; 682]).sequence(sequence);
        let scan = scan.received_at(Instant::now()).build();
        recorder.record(&Ok(scan.unwrap())).unwrap();
    }
    assert!(recorder.finish().await.unwrap().has_outgrown_file);
    for path in parts(&path).into_iter().skip(1) {
        let file = std::fs::read(path).unwrap();
        let mut messages = mcap::MessageStream::new(&file).unwrap();
        assert!(messages.all(|message| message.unwrap().channel.schema.is_some()));
        let summary = mcap::Summary::read(&file).unwrap().unwrap();
        for chunk in &summary.chunk_indexes {
            let entries = summary.read_message_indexes(&file, chunk).unwrap();
            for entry in entries.values().flatten() {
                let message = summary.seek_message(&file, chunk, entry).unwrap();
                assert_eq!(message.log_time, entry.log_time);
            }
        }
    }

    // The last file may not grow by its index.
    let path = folder("file-limit").join("run.mcap");
    record(&path, Some(whole.bytes - 1)).await.unwrap();
    let part = read(&path);
    assert_eq!((part.scans.len() as u32, part.is_complete), (SCANS, true));
    assert!(part.summary.is_none() && parts(&path).len() == 1);

    // No file has room for a chunk.
    let path = folder("file-limit").join("run.mcap");
    match record(&path, Some(end(1) + 20)).await.unwrap_err() {
        RecordingError::Write { source } => assert_eq!(source.kind(), io::ErrorKind::FileTooLarge),
        other => panic!("{other:?}"),
    }
    assert!(Recording::open(&path).unwrap().all(|record| record.is_ok()));
}
