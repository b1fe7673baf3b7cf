//! The index at the end of a file, compared with the records before it.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{ChunkIndex, Footer, MetadataIndex, Record, Statistics, SummaryOffset};
use tokio_scip::{Rate, Sensor, Window};
use urg_recording::{Recorder, repair};

use super::raw::{MAGIC, channel, end, of_kind};
use super::sink::{Sink, observed, sensor};

/// A record, and where it begins in the file.
type Placed<'a> = (u64, Record<'a>);

/// Splits a file into its records, without its magic at both ends.
fn records(file: &[u8]) -> Vec<Placed<'_>> {
    let (mut at, mut records) = (8, Vec::new());
    while at < file.len() - 8 {
        let (kind, length) = (file[at], file[at + 1..at + 9].try_into().unwrap());
        let end = at + 9 + u64::from_le_bytes(length) as usize;
        records.push((at as u64, mcap::parse_record(kind, &file[at + 9..end]).unwrap()));
        at = end;
    }
    records
}

/// Returns the number and the log time of each message in a chunk, by its channel.
fn messages(data: &[u8]) -> Vec<(u16, u64)> {
    let (mut rest, mut messages) = (data, Vec::new());
    while let [kind, length @ ..] = rest {
        let (length, behind) = length.split_first_chunk::<8>().unwrap();
        let (content, behind) = behind.split_at(u64::from_le_bytes(*length) as usize);
        if let Record::Message { header, .. } = mcap::parse_record(*kind, content).unwrap() {
            messages.push((header.channel_id, header.log_time));
        }
        rest = behind;
    }
    messages
}

/// Content that an index must have, found by reading the file in front of it.
#[derive(Default)]
struct Expected {
    statistics: Statistics,
    chunks: Vec<ChunkIndex>,
    metadata: Vec<MetadataIndex>,
}

fn expected(records: &[Placed<'_>]) -> Expected {
    let mut found = Expected::default();
    let end = |number: usize| records[number + 1].0;
    for (number, (start, record)) in records.iter().enumerate() {
        match record {
            Record::Chunk { header, data } => {
                let messages = messages(data);
                let times = || messages.iter().map(|(_, time)| *time);
                // Viewers begin and end a file with the times of its chunks, and one without messages has 0.
                let span = (times().min().unwrap(), times().max().unwrap());
                assert_eq!(span, (header.message_start_time, header.message_end_time));
                assert_eq!(header.uncompressed_size, data.len() as u64);
                for (channel, time) in messages {
                    let statistics = &mut found.statistics;
                    if statistics.message_count == 0 {
                        statistics.message_start_time = time;
                    }
                    statistics.message_start_time = statistics.message_start_time.min(time);
                    statistics.message_end_time = statistics.message_end_time.max(time);
                    statistics.message_count += 1;
                    *statistics.channel_message_counts.entry(channel).or_default() += 1;
                }
                found.statistics.chunk_count += 1;
                found.chunks.push(ChunkIndex {
                    message_start_time: span.0,
                    message_end_time: span.1,
                    chunk_start_offset: *start,
                    chunk_length: end(number) - start,
                    message_index_offsets: BTreeMap::new(),
                    message_index_length: 0,
                    compression: String::new(),
                    compressed_size: data.len() as u64,
                    uncompressed_size: data.len() as u64,
                });
            }
            Record::MessageIndex(index) => {
                let chunk = found.chunks.last_mut().unwrap();
                chunk.message_index_offsets.insert(index.channel_id, *start);
                chunk.message_index_length += end(number) - start;
            }
            Record::Metadata(metadata) => {
                found.statistics.metadata_count += 1;
                found.metadata.push(MetadataIndex {
                    offset: *start,
                    length: end(number) - start,
                    name: metadata.name.clone(),
                });
            }
            Record::DataEnd(_) => break,
            _ => {}
        }
    }
    found
}

/// Checks the index of a file, and returns what it has.
fn check(file: &[u8]) -> Expected {
    let records = records(file);
    let mut expected = expected(&records);
    let (_, Record::Footer(Footer { summary_start, summary_offset_start, .. })) =
        records.last().unwrap()
    else {
        panic!("no footer")
    };
    let mut offsets: Vec<SummaryOffset> = Vec::new();
    let (mut chunks, mut metadata, mut statistics) = (Vec::new(), Vec::new(), None);
    for (start, record) in &records {
        if start < summary_start {
            continue;
        }
        match record {
            Record::Schema { .. } => expected.statistics.schema_count += 1,
            Record::Channel(_) => expected.statistics.channel_count += 1,
            Record::ChunkIndex(index) => chunks.push(index.clone()),
            Record::MetadataIndex(index) => metadata.push(index.clone()),
            Record::Statistics(found) => statistics = Some(found.clone()),
            Record::SummaryOffset(offset) => {
                assert!(start >= summary_offset_start);
                offsets.push(*offset);
                continue;
            }
            Record::Footer(_) => continue,
            other => panic!("{other:?} in the index"),
        }
        assert!(start < summary_offset_start);
    }
    assert_eq!(chunks, expected.chunks);
    assert_eq!(metadata, expected.metadata);
    assert_eq!(statistics.as_ref(), Some(&expected.statistics));
    // The groups follow each other, and each has the records of its kind.
    let mut place = *summary_start;
    for offset in &offsets {
        assert_eq!(offset.group_start, place);
        place += offset.group_length;
        let group = offset.group_start..place;
        let of_group = records.iter().filter(|(start, _)| group.contains(start));
        assert!(of_group.clone().count() > 0);
        assert!(of_group.clone().all(|(_, record)| record.opcode() == offset.group_opcode));
    }
    assert_eq!(place, *summary_offset_start);
    expected
}

#[tokio::test(start_paused = true)]
async fn each_topic_has_its_ros_2_type() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let emulator = sensor();
    let (_sensor, mut scans) =
        observed(&recorder, emulator.clone(), Window::DETECTION, Rate::hz(10.0)).await;
    recorder.record(&scans.next().await.unwrap()).unwrap();
    emulator.unplug();
    recorder.record(&scans.next().await.unwrap()).unwrap();
    recorder.finish().await.unwrap();
    let file = sink.bytes();
    let channels = mcap::Summary::read(&file).unwrap().unwrap().channels;
    for (number, topic, name, definition) in [
        (0, "/scan", "sensor_msgs/msg/LaserScan", "std_msgs/Header header\nfloat32 angle_min\n"),
        (1, "/scip/replies", "std_msgs/msg/UInt8MultiArray", "std_msgs/MultiArrayLayout layout\n"),
        (2, "/scip/events", "std_msgs/msg/String", "string data\n"),
    ] {
        let channel = &channels[&number];
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!((&*channel.topic, &*channel.message_encoding), (topic, "cdr"));
        assert_eq!((&*schema.name, &*schema.encoding), (name, "ros2msg"));
        assert!(schema.data.starts_with(definition.as_bytes()), "{name}");
    }
    assert_eq!(channels.len(), 3);
}

#[tokio::test(start_paused = true)]
async fn the_index_describes_the_whole_file() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let sensor = Sensor::builder().on_reply(recorder.observer()).connect(sensor()).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    for number in 0..40 {
        if number % 20 == 0 {
            recorder.describe(&sensor, &scans).await.unwrap();
        }
        recorder.record(&scans.next().await.unwrap()).unwrap();
    }
    recorder.finish().await.unwrap();
    let found = check(&sink.bytes());
    // Checkers of recordings refuse a topic without messages: nothing happened, so there is none of events.
    let topics = (found.statistics.channel_count, found.statistics.channel_message_counts.len());
    assert_eq!((found.metadata.len(), topics), (2, (2, 2)));
    assert!(found.chunks.len() > 4 && found.statistics.message_count > 80);

    // The repaired file has an index of its own.
    let mut cut = sink.bytes();
    cut.truncate(cut.len() * 3 / 4);
    let mut repaired = Vec::new();
    repair(Cursor::new(cut), &mut repaired).unwrap();
    let repaired = check(&repaired);
    // Each chunk repeats its channels, which the index has once.
    assert_eq!((repaired.metadata.len(), repaired.statistics.channel_count), (2, 2));
    assert!(repaired.statistics.message_count > 50);
}

#[test]
fn a_chunk_is_limited_to_768_kib() {
    const CHUNK_HEAD: usize = 49;
    let message = |length| of_kind(0x05, &vec![0; 22 + length]);
    let first = message(400 << 10);
    let rest = (768 << 10) - CHUNK_HEAD - channel().len() - first.len();
    for (length, chunks) in [(rest, 1), (rest + 1, 2)] {
        let file = [MAGIC, &channel(), &first, &message(length), &end()].concat();
        let mut copy = Vec::new();
        repair(Cursor::new(file), &mut copy).unwrap();
        assert_eq!(mcap::Summary::read(&copy).unwrap().unwrap().chunk_indexes.len(), chunks);
    }
}
