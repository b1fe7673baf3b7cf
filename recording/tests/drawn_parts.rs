//! Parts of files whose records are drawn, with or without the file's index: which records a part has,
//! and which messages are counted as left out.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::ops::Bound;
use std::time::{Duration, SystemTime};

use mcap::WriteOptions;
use mcap::records::{MessageHeader, Metadata};
use tokio_scip::{Rate, Sensor};
use urg_emulator::Model;
use urg_recording::{LeftOutReason, Recorder, Recording};

use super::file::Folder;
use super::raw::text;
use super::sink::{Sink, model, next, window};
use crate::common::random::{Random, seeds};

const TENTH: u64 = 100_000_000;
const BEGAN: u64 = 1_700_000_000 * 10 * TENTH;

/// Message of a drawn file.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Event,
    /// Reply to `VV` with a wrong sum.
    Malformed,
    Version,
    Parameters,
    LaserOn,
    Poll,
    Scan,
    /// Message on `/scan` that ends early.
    Short,
    /// Scan on another topic.
    Rear,
}

const KINDS: [Kind; 9] = [
    Kind::Event,
    Kind::Malformed,
    Kind::Version,
    Kind::Parameters,
    Kind::LaserOn,
    Kind::Poll,
    Kind::Scan,
    Kind::Short,
    Kind::Rear,
];

impl Kind {
    /// Channel, and the reason why the message is no record.
    fn place(self) -> (u16, Option<LeftOutReason>) {
        match self {
            Self::Scan => (1, None),
            Self::Short => (1, Some(LeftOutReason::Malformed)),
            Self::Event => (3, None),
            Self::Rear => (4, Some(LeftOutReason::OtherTopic)),
            _ => (2, None),
        }
    }
}

/// Records a sensor, and returns the content of one message of each kind.
async fn contents() -> Vec<(Kind, Vec<u8>)> {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let builder = Sensor::builder().on_reply(recorder.observer());
    let sensor = builder.connect(model(Model::Ust10lx)).await.unwrap();
    sensor.laser_on().await.unwrap();
    let mut scans = sensor.scans(window(300, 305, 1), Rate::hz(10.0)).await.unwrap();
    next(&mut recorder, &mut scans, 3).await;
    recorder.finish().await.unwrap();
    let file = sink.bytes();
    let messages: Vec<_> =
        mcap::MessageStream::new(&file).unwrap().map(|message| message.unwrap()).collect();
    let scan = messages.iter().find(|message| message.channel.topic == "/scan").unwrap();
    // The request follows its length.
    let reply = |request: &str| {
        let mut replies = messages.iter().filter(|message| message.channel.topic != "/scan");
        replies.rfind(|reply| reply.data[12..].starts_with(request.as_bytes())).unwrap()
    };
    let content = |kind| match kind {
        Kind::Event => [&[0, 1, 0, 0][..], &text("{\"event\":\"missed\",\"scans\":1}\0")].concat(),
        Kind::Malformed => {
            let mut data = reply("VV").data.to_vec();
            // Three line feeds follow the sum.
            let sum = data.len() - 4;
            data[sum] ^= 1;
            data
        }
        Kind::Version => reply("VV").data.to_vec(),
        Kind::Parameters => reply("PP").data.to_vec(),
        Kind::LaserOn => reply("BM").data.to_vec(),
        Kind::Poll => reply("M").data.to_vec(),
        Kind::Scan | Kind::Rear => scan.data.to_vec(),
        Kind::Short => scan.data[..12].to_vec(),
    };
    KINDS.map(|kind| (kind, content(kind))).into()
}

fn file(random: &mut Random, drawn: &[(u64, Kind)], contents: &[(Kind, Vec<u8>)]) -> Vec<u8> {
    // The format allows each part of the index to be absent.
    let options = WriteOptions::new()
        .compression(None)
        .emit_statistics(!random.once_in(3))
        .emit_message_indexes(!random.once_in(3))
        .emit_chunk_indexes(!random.once_in(3))
        .emit_metadata_indexes(!random.once_in(3))
        .emit_summary_offsets(!random.once_in(3))
        .repeat_channels(random.once_in(2))
        .repeat_schemas(random.once_in(2))
        .calculate_summary_section_crc(!random.once_in(3))
        .calculate_chunk_crcs(!random.once_in(3))
        .chunk_size(Some(1 + random.below(500)));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    if random.once_in(2) {
        let metadata = BTreeMap::from([("rate".to_owned(), "10 Hz".to_owned())]);
        writer.write_metadata(&Metadata { name: "tokio_scip".to_owned(), metadata }).unwrap();
    }
    let scan = "sensor_msgs/msg/LaserScan";
    let topics = [
        ("/scan", scan),
        ("/scip/replies", "std_msgs/msg/UInt8MultiArray"),
        ("/scip/events", "std_msgs/msg/String"),
        ("/rear/scan", scan),
    ];
    let mut declared = BTreeSet::new();
    for (sequence, (time, kind)) in drawn.iter().enumerate() {
        let (channel_id, _) = kind.place();
        if declared.insert(channel_id) {
            let (topic, name) = topics[usize::from(channel_id) - 1];
            let schema = writer.add_schema_with_id(channel_id, name, "ros2msg", b"").unwrap();
            writer.add_channel_with_id(channel_id, schema, topic, "cdr", &BTreeMap::new()).unwrap();
        }
        let (sequence, log_time, publish_time) = (sequence as u32, *time, *time);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        let (_, content) = contents.iter().find(|(known, _)| known == kind).unwrap();
        writer.write_to_known_channel(&header, content).unwrap();
    }
    writer.finish().unwrap();
    let file = writer.into_inner().into_inner();
    if random.once_in(2) { shuffled(random, file) } else { file }
}

/// Shuffles the index of a file, and adds a record of another kind that looks like a chunk's.
fn shuffled(random: &mut Random, mut file: Vec<u8>) -> Vec<u8> {
    let mut end = file.split_off(file.len() - 37);
    let start = u64::from_le_bytes(*end[9..].first_chunk().unwrap()) as usize;
    if start == 0 {
        return [file, end].concat();
    }
    let (mut index, mut rest) = (Vec::new(), &file[start..]);
    while let Some(length) = rest.get(1..9) {
        let length = u64::from_le_bytes(length.try_into().unwrap()) as usize;
        let (record, others) = rest.split_at(9 + length);
        index.insert(random.below(index.len() as u64 + 1) as usize, record.to_vec());
        rest = others;
    }
    let mut other = index.iter().find(|record| record[0] == 0x08).cloned().unwrap_or_default();
    if let Some([kind, _, _, _, _, _, _, _, _, times @ ..]) = other.get_mut(..25) {
        (*kind, _) = (0x88, times.fill(0));
    }
    index.push(other);
    let index = index.concat();
    let crc = crc32fast::hash(&[&index, &end[..25]].concat());
    end[25..29].copy_from_slice(&crc.to_le_bytes());
    [&file[..start], &index, &end].concat()
}

/// Numbers of the records in a part, and the counts of what was left out.
type Part = (Vec<u64>, BTreeMap<LeftOutReason, u64>);

fn expected(drawn: &[(u64, Kind)], range: (Bound<Duration>, Bound<Duration>)) -> Part {
    let (mut first, mut has_version) = (None, false);
    let (mut times, mut left_out) = (Vec::new(), BTreeMap::new());
    for (time, kind) in drawn {
        if matches!(kind, Kind::Poll | Kind::Scan) {
            first.get_or_insert(*time);
        }
        let since = Duration::from_nanos(time.saturating_sub(first.unwrap_or(*time)));
        let is_inside = std::ops::RangeBounds::contains(&range, &since);
        let identifies = matches!(kind, Kind::Malformed | Kind::Version | Kind::Parameters);
        match kind.place() {
            (_, None) if is_inside || identifies && !has_version => times.push(*time),
            (_, Some(reason)) if is_inside => *left_out.entry(reason).or_default() += 1,
            _ => {}
        }
        has_version |= *kind == Kind::Version;
    }
    (times, left_out)
}

fn found(recording: Recording, range: (Bound<Duration>, Bound<Duration>)) -> Part {
    let recording = recording.range(range);
    let left_out = recording.left_out();
    let nanos = |at: SystemTime| at.duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos();
    let times = recording.map(|record| nanos(record.unwrap().at) as u64).collect();
    let counts = left_out.counts();
    (times, counts.iter().map(|count| (count.reason, count.messages)).collect())
}

#[tokio::test(start_paused = true)]
async fn a_part_has_what_lies_in_its_time() {
    let contents = contents().await;
    let folder = Folder::new("drawn-parts");
    for seed in seeds("URG_PARTS", 600) {
        let random = &mut Random::new(seed);
        let is_sorted = !random.once_in(3);
        let mut time = BEGAN;
        let mut drawn = Vec::new();
        for _ in 0..random.below(40) {
            time = match is_sorted {
                true => time + TENTH * random.below(8),
                false => BEGAN + TENTH * random.below(100),
            };
            drawn.push((time, *random.pick(&KINDS)));
        }
        let bound = |random: &mut Random| match (random.below(5), random.below(60)) {
            (0, _) => Bound::Unbounded,
            (1, tenths) => Bound::Excluded(Duration::from_nanos(TENTH * tenths)),
            (2, _) => Bound::Included(Duration::ZERO),
            (_, tenths) => Bound::Included(Duration::from_nanos(TENTH * tenths)),
        };
        let range = (bound(random), bound(random));
        let file = file(random, &drawn, &contents);
        let expected = expected(&drawn, range);
        let from_disk = Recording::open(folder.write(&file)).unwrap();
        let from_pipe = Recording::read(Cursor::new(file)).unwrap();
        for recording in [from_disk, from_pipe] {
            assert_eq!(found(recording, range), expected, "{seed}: {range:?} of {drawn:?}");
        }
    }
}
