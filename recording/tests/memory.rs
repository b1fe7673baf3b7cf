//! Reading a recording takes the memory of one chunk, however long the file is.

use std::io::{self, Read};
use std::time::Duration;

use allocation_counter::measure;
use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::{Emulator, Model};
use urg_recording::{Compression, Recorder, Recording, RecordingError, cut, repair};

use super::sink::Sink;

use super::file::Folder;
use super::raw::{
    MAGIC, channel, channel_content, chunk_of, end, event, metadata, of_kind, read, record, text,
};

/// A file that consists of a beginning, and of one part many times.
struct Endless {
    beginning: Vec<u8>,
    part: Vec<u8>,
    times: usize,
    at: usize,
}

impl Endless {
    fn new(beginning: &[u8], part: Vec<u8>, times: usize) -> Self {
        Self { beginning: beginning.to_vec(), part, times, at: 0 }
    }
}

impl Read for Endless {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if self.at == self.beginning.len() {
            self.at = 0;
            self.beginning.clear();
            if self.times > 0 {
                self.times -= 1;
                self.beginning.extend_from_slice(&self.part);
            }
        }
        let mut rest = &self.beginning[self.at..];
        let count = rest.read(bytes)?;
        self.at += count;
        Ok(count)
    }
}

/// Makes a message of a topic that is none of a recording.
fn other_message(length: usize) -> Vec<u8> {
    of_kind(0x05, &[&[1][..], &[0; 21], &vec![0; length]].concat())
}

/// Makes the record of a channel of another topic.
fn other_channel() -> Vec<u8> {
    of_kind(0x04, &channel_content(1, "/camera"))
}

#[test]
fn a_long_recording_needs_two_chunks_of_memory() {
    let part = chunk_of(&[channel(), other_channel(), event(0), other_message(200_000)].concat());
    let file = Endless::new(MAGIC, part, 100);
    let counted = measure(|| assert_eq!(Recording::read(file).unwrap().count(), 100));
    assert!(counted.bytes_max < 900_000, "{} bytes in memory", counted.bytes_max);
}

#[test]
fn metadata_alone_do_not_fill_the_memory() {
    let value = [text("key"), text(&"v".repeat(1_000_000))].concat();
    let content = [&text("other")[..], &(value.len() as u32).to_le_bytes(), &value].concat();
    let file = Endless::new(MAGIC, of_kind(0x0c, &content), 40);
    let counted = measure(|| drop(repair(file, io::sink()).unwrap()));
    assert!(counted.bytes_max < 10_000_000, "{} bytes in memory", counted.bytes_max);
}

/// Makes a reply of a sensor of this length.
pub(super) fn reply(length: usize) -> Vec<u8> {
    let (command, length_field) = (text("\0"), (length as u32).to_le_bytes());
    // The encapsulation, a dimension, the padded label, size, stride, offset, the bytes.
    let layout = [&[0, 1, 0, 0, 1, 0, 0, 0][..], &command, &[0; 3], &[0; 12], &length_field];
    let data = [&layout.concat()[..], &vec![0; length]].concat();
    of_kind(0x05, &[&[0; 22][..], &data].concat())
}

fn reply_channel() -> Vec<u8> {
    of_kind(0x04, &channel_content(0, "/scip/replies"))
}

/// Everything that is read in the search for metadata is kept, so the search has a limit.
#[test]
fn long_messages_without_metadata_do_not_fill_the_memory() {
    let part = chunk_of(&[reply_channel(), reply(1_500_000)].concat());
    let file = Endless::new(MAGIC, part, 20);
    let counted = measure(|| {
        let recording = Recording::read(file).unwrap();
        assert_eq!(recording.map(Result::unwrap).count(), 20);
    });
    assert!(counted.bytes_max < 9_000_000, "{} bytes in memory", counted.bytes_max);
}

#[test]
fn metadata_is_known_at_once_near_the_start() {
    let has_metadata = |parts: &[Vec<u8>]| {
        let file = [MAGIC, &parts.concat()].concat();
        let mut recording = Recording::read(io::Cursor::new(file)).unwrap();
        let is_known = recording.rate().is_some();
        // Later it is known after its place.
        recording.by_ref().for_each(|record| drop(record.unwrap()));
        assert!(recording.rate().is_some());
        is_known
    };
    let events = |count| event(0).repeat(count);
    assert!(has_metadata(&[channel(), events(255), metadata(), events(1)]));
    assert!(!has_metadata(&[channel(), events(256), metadata(), events(1)]));
    // The records before the metadata have this many bytes less than a mebibyte.
    for (less, is_known) in [(1, true), (0, false)] {
        let heads = reply_channel().len() + reply(0).len() - 2 * 9;
        let long = reply((1 << 20) - heads - less);
        let parts = [reply_channel(), long, metadata(), reply(0)];
        assert_eq!(has_metadata(&parts), is_known, "{less}");
    }
}

#[test]
fn the_search_for_metadata_ends_after_256_messages_or_damages() {
    let mut damaged = chunk_of(&event(0));
    // The checksum.
    damaged[33] = 1;
    for part in [event(0), other_message(1), damaged] {
        for (count, is_known) in [(255, true), (256, false)] {
            let start = [MAGIC, &channel(), &other_channel(), &part.repeat(count)].concat();
            let file = [start, metadata(), event(0)].concat();
            let recording = Recording::read(io::Cursor::new(file)).unwrap();
            assert_eq!(recording.rate().is_some(), is_known, "{count} of {part:?}");
        }
    }
}

/// Metadata of long names: the index repeats the name.
#[test]
fn a_copy_of_100_mb_of_names_takes_64_mib() {
    let name = [&text(&"x".repeat(500_000))[..], &[0; 4]].concat();
    let part = [of_kind(0x0c, &name), chunk_of(&[channel(), event(0)].concat())].concat();
    let file = |times| Endless::new(MAGIC, part.clone(), times);
    let counted = measure(|| assert_eq!(repair(file(200), io::sink()).unwrap().messages, 200));
    assert!(counted.bytes_max < 64 << 20, "{} bytes in memory", counted.bytes_max);
    // The index of a copy has up to 16 MiB.
    for (times, has_index) in [(33, true), (34, false)] {
        let mut copy = Vec::new();
        repair(file(times), &mut copy).unwrap();
        assert_eq!(mcap::Summary::read(&copy).unwrap().is_some(), has_index);
        assert_eq!(mcap::MessageStream::new(&copy).unwrap().count(), times);
    }
}

/// The checksum is right, but the memory for it is limited all the same.
#[test]
fn an_index_of_16_mib_is_read() {
    let folder = Folder::new("long-index");
    for (length, is_read) in [(16 << 20, true), ((16 << 20) + 1, false)] {
        // After damage, the index is asked for definitions.
        let data = [MAGIC, &channel(), &event(0), &[0; 9], &event(0).repeat(3)].concat();
        let data = [data, of_kind(0x0f, &[0; 4])].concat();
        let footer = record(0x02, 20, &[&data.len().to_le_bytes()[..], &[0; 8]].concat());
        let index = [vec![0; length], footer].concat();
        let crc = crc32fast::hash(&index).to_le_bytes();
        let path = folder.write(&[&data[..], &index, &crc, MAGIC].concat());
        drop((data, index));
        let counted = measure(|| {
            let recording = Recording::open(&path).unwrap();
            assert_eq!(recording.filter(Result::is_ok).count(), 4);
        });
        assert_eq!(counted.bytes_max > 16 << 20, is_read, "{}", counted.bytes_max);
    }
}

/// Makes a schema whose content has this many bytes after its number.
fn schema(number: u8, length: usize) -> Vec<u8> {
    let data = vec![number; length - 13];
    let fields = [&text("x")[..], &text(""), &(data.len() as u32).to_le_bytes(), &data].concat();
    of_kind(0x03, &[&[number, 0], &fields[..]].concat())
}

#[test]
fn definitions_have_64_mib() {
    let most = (1 << 20) - 2;
    let long: Vec<u8> = (1..=64).flat_map(|number| schema(number, most)).collect();
    let rest = (64 << 20) - 64 * most - (channel().len() - 9 - 2);
    let file = |last: &[u8]| [MAGIC, &channel(), &long, last, &event(0), &end()].concat();
    for (more, damaged) in [(0, 0), (1, 1)] {
        // The first one is known.
        let file = file(&[schema(65, rest + more), schema(1, most)].concat());
        let counted = measure(|| assert_eq!(read(&file).0.len(), damaged, "{more}"));
        assert!(counted.bytes_max < 140 << 20, "{} bytes in memory", counted.bytes_max);
    }
    // Alone, each of two files fits.
    let inputs = [file(&schema(65, rest)), [MAGIC, &schema(66, 99), &end()].concat()];
    let outcome = cut(inputs.map(io::Cursor::new), .., None, io::sink()).unwrap();
    assert_eq!((outcome.messages, outcome.damaged_parts), (1, 1));
}

/// A message each second, as of a sensor that is polled rarely.
#[test]
fn a_copy_of_days_has_longer_chunks_and_an_index() {
    let seconds = 110_000;
    let message = |second: u64| {
        let times = (second * 1_000_000_000).to_le_bytes().repeat(2);
        of_kind(0x05, &[&[0; 6][..], &times].concat())
    };
    let parts = (0..seconds).map(message).collect::<Vec<_>>().concat();
    let (file, mut copy) = ([MAGIC, &channel(), &chunk_of(&parts)].concat(), Vec::new());
    repair(io::Cursor::new(file), &mut copy).unwrap();
    let summary = mcap::Summary::read(&copy).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, seconds);
    assert!(summary.chunk_indexes.len() < seconds as usize, "{}", summary.chunk_indexes.len());
}

/// A file that cannot be read.
struct Unreadable;

impl Read for Unreadable {
    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        Err(io::ErrorKind::Other.into())
    }
}

#[test]
fn opening_a_recording_reads_no_further_than_its_metadata() {
    let others = other_message(2000).repeat(100);
    let beginning = [MAGIC, &channel(), &other_channel(), &event(0), &metadata(), &others];
    let file = io::Cursor::new(beginning.concat()).chain(Unreadable);
    let mut recording = Recording::read(file).unwrap();
    assert_eq!(recording.rate(), Some(Rate::hz(10.0)));
    assert!(recording.next().unwrap().is_ok());
    let error = recording.next().unwrap().unwrap_err();
    assert!(matches!(error, RecordingError::Read { .. }), "{error:?}");
    assert!(recording.next().is_none());
}

/// 40 scans a second of 1,081 points, in a room. `-- --nocapture` shows the bytes of an hour.
#[tokio::test(start_paused = true)]
async fn a_minute_of_a_ust_is_cut_and_repaired_in_little_memory() {
    for compression in [Compression::Plain, Compression::Zstd] {
        if !compression.is_written() {
            continue;
        }
        let (sink, seconds) = (Sink::new(), 60);
        let builder = Recorder::builder().compression(compression);
        let mut recorder = builder.write_to(sink.clone()).unwrap();
        let emulator = Emulator::builder().model(Model::Ust10lx).build();
        let sensor = Sensor::builder().connect(emulator).await.unwrap();
        recorder.observe(&sensor);
        let mut scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        for _ in 0..40 * seconds {
            recorder.record(&scans.next().await.unwrap()).unwrap();
            recorder.ready().await;
        }
        assert_eq!(recorder.finish().await.unwrap().lost, 0);
        let file = sink.bytes();
        println!("{compression}: {} MB an hour", file.len() * 3600 / seconds / 1_000_000);
        let open = || io::Cursor::new(file.clone());
        let (whole, part) = (open(), open());
        let repaired = measure(|| {
            let scans = repair(whole, io::sink()).unwrap().scans;
            // The sensor sends further ones while the disk is awaited.
            assert!(scans >= 40 * seconds as u64, "{scans}");
        });
        let range = Duration::from_secs(20)..Duration::from_secs(40);
        let copied = measure(|| {
            let scans = cut([part], range, None, io::sink()).unwrap().scans;
            assert!((799..=801).contains(&scans), "{scans}");
        });
        for counted in [repaired, copied] {
            println!("{compression}: {} bytes in memory", counted.bytes_max);
            assert!(counted.bytes_max < 4 << 20, "{} bytes in memory", counted.bytes_max);
        }
    }
}
