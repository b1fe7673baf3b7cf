//! Recordings that other programs wrote, or copied: with other topics, without chunks, and
//! with records that this crate does not use.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Cursor, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions};
use tokio_scip::Window;
use urg_emulator::{Emulator, Model, Values, WorldTime};
use urg_recording::{Recording, repair};

use super::sink::{self, Sink, record, sensor};

/// Writes the messages of a recording again, between an image of 2 MiB, an attachment of
/// 3 MiB and a private record.
fn written_again(recorded: &[u8], options: WriteOptions) -> Vec<u8> {
    let mut writer = options.compression(None).create(Cursor::new(Vec::new())).unwrap();
    let metadata = Sink::with_bytes(recorded).open().metadata().clone();
    writer.write_metadata(&Metadata { name: "tokio_scip".to_owned(), metadata }).unwrap();
    writer.add_channel_with_id(99, 0, "/camera", "raw", &BTreeMap::new()).unwrap();
    for (number, message) in mcap::MessageStream::new(recorded).unwrap().enumerate() {
        if number == 5 {
            let image = vec![6; 2 << 20];
            let header =
                MessageHeader { channel_id: 99, sequence: 0, log_time: 1, publish_time: 1 };
            writer.write_to_known_channel(&header, &image).unwrap();
            let attachment = Attachment {
                log_time: 1,
                create_time: 1,
                name: "map.png".to_owned(),
                media_type: "image/png".to_owned(),
                data: Cow::Owned(vec![6; 3 << 20]),
            };
            writer.attach(&attachment).unwrap();
            writer.write_private_record(0x90, &[6; 100], Default::default()).unwrap();
        }
        writer.write(&message.unwrap()).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[tokio::test(start_paused = true)]
async fn a_foreign_copy_reads_as_the_original() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 20).await;
    let recorded = sink.bytes();
    for options in [
        WriteOptions::new().use_chunks(false),
        WriteOptions::new().chunk_size(Some(20_000)),
        WriteOptions::new().chunk_size(Some(20_000)).calculate_chunk_crcs(false),
    ] {
        let copied = written_again(&recorded, options);
        let mut copy = Recording::read(Cursor::new(copied.clone())).unwrap();
        assert_eq!(copy.metadata(), sink.open().metadata());
        let records: Vec<_> = copy.by_ref().collect::<Result<_, _>>().unwrap();
        assert_eq!(records, sink.records());
        assert!(!copy.is_truncated());

        let mut repaired = Vec::new();
        let outcome = repair(Cursor::new(copied.clone()), &mut repaired).unwrap();
        assert_eq!((outcome.was_truncated, outcome.damaged_parts), (false, 0));
        let messages = |file: &[u8]| -> Vec<_> {
            let messages = mcap::MessageStream::new(file).unwrap().map(Result::unwrap);
            messages
                .map(|message| (message.channel.topic.clone(), message.data.into_owned()))
                .collect()
        };
        // The image is among them.
        assert_eq!(messages(&repaired), messages(&copied));
        assert_eq!(messages(&repaired).len(), records.len() + 1);
    }
}

/// Output that stays as it is if the writer dies.
#[derive(Default, Clone)]
struct Disk(Arc<Mutex<Cursor<Vec<u8>>>>);

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.lock().unwrap().seek(to)
    }
}

/// mcap 0.26.0 writes the lengths of a chunk once it is complete. Until then they are `u64::MAX`.
#[tokio::test(start_paused = true)]
async fn a_chunk_whose_writer_died_is_read() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 20).await;
    for (chunk_size, joined) in [(None, false), (Some(50_000), false), (Some(50_000), true)] {
        let disk = Disk::default();
        let options = WriteOptions::new().compression(None).chunk_size(chunk_size);
        let mut writer = options.create(disk.clone()).unwrap();
        for message in mcap::MessageStream::new(&sink.bytes()).unwrap() {
            writer.write(&message.unwrap()).unwrap();
        }
        let mut written = disk.0.lock().unwrap().get_ref().clone();
        assert!(written.windows(8).any(|length| length == [0xff; 8]));
        if joined {
            // Then the chunk's end is not known: it is left out, but not the file after it.
            written.extend(sink.bytes());
        }
        let mut recording = Recording::read(Cursor::new(written)).unwrap();
        let records: Vec<_> = recording.by_ref().filter_map(Result::ok).collect();
        if joined {
            assert!(records.ends_with(&sink.records()) && records.len() > sink.records().len());
        } else {
            assert_eq!(records, sink.records(), "{chunk_size:?}");
            assert!(recording.is_truncated());
        }
    }
}

/// `ros2 bag play` and `ros2 bag record --all` give each message a time of its own, and may swap two topics.
#[tokio::test(start_paused = true)]
async fn scans_played_and_recorded_again_are_read_once() {
    let models = [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];
    for (model, swaps) in models.into_iter().flat_map(|model| [(model, false), (model, true)]) {
        let sink = Sink::new();
        // More than are searched for their window.
        record(sink::model(model), &sink, sink::window(300, 320, 1), 300).await;
        let recorded = sink.bytes();
        let mut messages: Vec<_> =
            mcap::MessageStream::new(&recorded).unwrap().map(Result::unwrap).collect();
        if swaps {
            for place in 1..messages.len() {
                if messages[place].channel.topic == "/scan" {
                    messages.swap(place - 1, place);
                }
            }
        }
        let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
        for (message, number) in messages.into_iter().zip(0..) {
            let log_time = 3_600_000_000_000 + message.log_time + number * 1_000;
            writer.write(&mcap::Message { log_time, publish_time: log_time, ..message }).unwrap();
        }
        writer.finish().unwrap();
        let values = |recording: Recording| -> Vec<Vec<u32>> {
            recording.scans().map(|scan| scan.unwrap().raw_values().collect()).collect()
        };
        let again = Recording::read(Cursor::new(writer.into_inner().into_inner())).unwrap();
        assert_eq!(values(again), values(sink.open()), "{model:?}, swapped: {swaps}");
    }
}

/// One message is played late or early, among the replies alone. Eight replies wait for their messages, and
/// a message waits for its reply until seven polls follow.
#[tokio::test(start_paused = true)]
async fn a_played_message_finds_its_reply_nearby() {
    let sink = Sink::new();
    record(sensor(), &sink, sink::window(300, 320, 1), 40).await;
    let recorded = sink.bytes();
    let metadata = sink.open().metadata().clone();
    let messages = || mcap::MessageStream::new(&recorded).unwrap().map(Result::unwrap);
    let scans: Vec<_> = messages().filter(|message| message.channel.topic == "/scan").collect();
    let replies: Vec<_> = messages()
        .filter(|message| message.channel.topic == "/scip/replies")
        .filter(|message| scans.iter().any(|scan| scan.publish_time == message.publish_time))
        .collect();
    assert_eq!((scans.len(), replies.len()), (40, 40));
    for distance in -12_isize..=12 {
        // The message comes after this number of replies. Its own one is reply 20.
        let place = (20 + usize::from(distance >= 0)).wrapping_add_signed(distance);
        let mut order = replies.clone();
        order.insert(place, scans[20].clone());
        let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
        let (name, metadata) = ("tokio_scip".to_owned(), metadata.clone());
        writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
        for (message, number) in order.into_iter().zip(0..) {
            let log_time = 3_600_000_000_000 + scans[0].log_time + number * 1_000;
            writer.write(&mcap::Message { log_time, publish_time: log_time, ..message }).unwrap();
        }
        writer.finish().unwrap();
        let again = Recording::read(Cursor::new(writer.into_inner().into_inner())).unwrap();
        let is_found = (-6..8).contains(&distance);
        assert_eq!(again.scans().count(), if is_found { 40 } else { 41 }, "{distance}");
    }
}

/// A reply that has its message is the reply of no other message.
#[tokio::test(start_paused = true)]
async fn an_equal_scan_played_later_is_another_one() {
    let sink = Sink::new();
    let world = |_: WorldTime, codes: &mut Values| codes.iter_mut().for_each(|code| *code = 99);
    let still = Emulator::builder().world(world).build();
    record(still, &sink, sink::window(300, 320, 1), 5).await;
    let recorded = sink.bytes();
    let mut messages: Vec<_> =
        mcap::MessageStream::new(&recorded).unwrap().map(Result::unwrap).collect();
    let mut played =
        messages.iter().rfind(|message| message.channel.topic == "/scan").unwrap().clone();
    played.log_time += 3_600_000_000_000;
    played.publish_time = played.log_time;
    messages.push(played);
    let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    messages.iter().for_each(|message| writer.write(message).unwrap());
    writer.finish().unwrap();
    let again = Recording::read(Cursor::new(writer.into_inner().into_inner())).unwrap();
    assert_eq!(again.scans().map(Result::unwrap).count(), 6);
}

/// A file may have any number of sources. The first 16 are named.
#[tokio::test(start_paused = true)]
async fn sixteen_sources_are_named() {
    let sink = Sink::new();
    record(sensor(), &sink, sink::window(300, 320, 1), 20).await;
    let recorded = sink.bytes();
    let metadata = sink.open().metadata().clone();
    for count in [1, 15, 16, 17, 20] {
        let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
        let scans = mcap::MessageStream::new(&recorded).unwrap().map(Result::unwrap);
        let scans = scans.filter(|message| message.channel.topic == "/scan");
        for (message, number) in scans.zip(0..count) {
            let mut metadata = metadata.clone();
            metadata.insert("serial_number".into(), format!("{number:02}"));
            let name = "tokio_scip".to_owned();
            writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
            let mut data = message.data.to_vec();
            let at = data.windows(6).position(|part| part == b"laser\0").unwrap();
            data[at..at + 5].copy_from_slice(format!("las{number:02}").as_bytes());
            writer.write(&mcap::Message { data: data.into(), ..message }).unwrap();
        }
        writer.finish().unwrap();
        let file = writer.into_inner().into_inner();
        let mut scans = Recording::read(Cursor::new(file)).unwrap().scans();
        assert_eq!(scans.by_ref().map(Result::unwrap).count(), count);
        let first =
            |name: &str| (0..count.min(16)).map(|number| format!("{name}{number:02}")).collect();
        let (frames, numbers): (BTreeSet<_>, BTreeSet<_>) = (first("las"), first(""));
        assert_eq!(*scans.frame_ids(), frames, "{count}");
        assert_eq!(*scans.serial_numbers(), numbers, "{count}");
    }
}

#[tokio::test(start_paused = true)]
async fn the_scans_of_several_sensors_are_read_by_topic() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 20).await;
    let mut writer = WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    let recorded = sink.bytes();
    let messages = mcap::MessageStream::new(&recorded).unwrap().map(Result::unwrap);
    for (number, message) in messages.filter(|message| message.channel.topic == "/scan").enumerate()
    {
        for (id, topic) in [(10, "/front/scan"), (11, "/rear/scan")] {
            if topic == "/front/scan" || number < 5 {
                let mut channel = (*message.channel).clone();
                channel.id = id;
                topic.clone_into(&mut channel.topic);
                writer
                    .write(&mcap::Message { channel: channel.into(), ..message.clone() })
                    .unwrap();
            }
        }
    }
    writer.finish().unwrap();
    let file = writer.into_inner().into_inner();
    let open = || Recording::read(Cursor::new(file.clone())).unwrap();
    for (topic, count) in [("/front/scan", 20), ("/rear/scan", 5)] {
        assert_eq!(open().topic(topic).scans().map(Result::unwrap).count(), count);
    }
    let error = open().scans().next().unwrap().unwrap_err().to_string();
    assert!(error.ends_with("; choose a topic: /front/scan, /rear/scan"), "{error}");
}

/// As `ros2 bag record --compression-mode message` writes them.
#[tokio::test(start_paused = true)]
async fn compressed_messages_are_named_with_a_remedy() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 5).await;
    let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let recorded = sink.bytes();
    for message in mcap::MessageStream::new(&recorded).unwrap().map(Result::unwrap) {
        let data = Cow::Owned([&[0x28, 0xb5, 0x2f, 0xfd][..], &message.data].concat());
        writer.write(&mcap::Message { data, ..message }).unwrap();
    }
    writer.finish().unwrap();
    let mut scans = Recording::read(Cursor::new(writer.into_inner().into_inner())).unwrap().scans();
    let error = scans.next().unwrap().unwrap_err().to_string();
    assert!(error.contains("; 13 messages that `rosbags-convert --src FOLDER"), "{error}");
}
