//! Recorded scans as [`Scan`]s, without a replay.

use std::io::{self, Cursor, Read};
use std::ops::{Bound, RangeBounds};
use std::path::Path;
use std::time::Duration;

use tokio_scip::RawReply;
use tokio_scip::protocol::Command;
use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_emulator::{Emulator, Fault, Faults, Values, WorldTime};
use urg_recording::{
    Entry, LeftOutReason, Record, RecordedScans, Recorder, Recording, RecordingError, ReplayPace,
};

use super::common::random::{Random, seeds};
use super::file::Folder;
use super::raw::{MAGIC, channel_content, of_kind, text};
use super::sink::{Sink, next, observed, record, replayed, sensor, values, window};

/// Stands for a function that is written for live scans.
fn summary(scan: &Scan) -> (Window, Vec<u32>, std::time::SystemTime, u64, Duration, bool) {
    let values = scan.raw_values().collect::<Vec<_>>();
    (scan.window(), values, scan.times().stamp, scan.sequence(), scan.scan_time(), scan.is_repeat())
}

#[tokio::test(start_paused = true)]
async fn recorded_scans_are_those_that_the_driver_delivered() {
    for window in [Window::DETECTION, Window::FULL, window(2, 2, 1), window(100, 103, 3)] {
        let sink = Sink::new();
        let delivered = record(sensor(), &sink, window, 20).await;
        let delivered: Vec<Scan> = delivered.into_iter().map(Result::unwrap).collect();
        let scans: Vec<Scan> = sink.open().scans().collect::<Result<_, _>>().unwrap();
        assert_eq!(
            scans.iter().map(summary).collect::<Vec<_>>(),
            delivered.iter().map(summary).collect::<Vec<_>>(),
            "{window}"
        );
        // The replies are no scans on another topic.
        let mut others = sink.open().topic("/front/scan").scans();
        assert!(others.next().is_some_and(|item| item.is_err()));
        let left_out = others.recording().left_out().counts();
        assert_eq!((left_out[0].reason, left_out[0].messages), (LeftOutReason::OtherTopic, 20));
        let times: Vec<_> =
            scans.windows(2).map(|pair| pair[1].received_at() - pair[0].received_at()).collect();
        let live: Vec<_> = delivered
            .windows(2)
            .map(|pair| pair[1].received_at() - pair[0].received_at())
            .collect();
        let is_near = |(a, b): (&Duration, &Duration)| a.abs_diff(*b) < Duration::from_millis(1);
        assert!(times.iter().zip(&live).all(is_near), "{times:?} {live:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn refused_and_malformed_replies_are_skipped() {
    let sink = Sink::new();
    let emulator = sensor();
    emulator.set_faults(Faults::none().at(5, Fault::Drop(700..701)).at(9, Fault::Status(b'7')));
    let delivered = record(emulator, &sink, Window::DETECTION, 10).await;
    assert!(delivered.iter().any(Result::is_err));
    let mut scans = sink.open().scans();
    let values: Vec<_> =
        scans.by_ref().map(|scan| scan.unwrap().raw_values().collect::<Vec<_>>()).collect();
    let expected: Vec<_> =
        delivered.iter().flatten().map(|scan| scan.raw_values().collect::<Vec<_>>()).collect();
    assert_eq!(values, expected);
    assert!(scans.next().is_none() && !scans.recording().is_truncated());
    let failed = delivered.iter().filter(|item| item.is_err()).count();
    assert_eq!(scans.failed_polls(), failed as u64);
    let left_out = scans.recording().left_out().counts();
    let text: Vec<_> = left_out.iter().map(ToString::to_string).collect();
    assert_eq!(text, ["2 polls refused, or with a malformed reply (the first: steps 44..=725)"]);
    assert_eq!(left_out[0].reason, LeftOutReason::FailedPoll);
}

#[tokio::test(start_paused = true)]
async fn recorded_scans_have_the_reported_revolution_time() {
    for (firmware, milliseconds) in [("FIRM:1(300[rpm])", 200), ("FIRM:1", 100)] {
        let time = Duration::from_millis(milliseconds);
        let lines = ["VEND:x", firmware, "SERI:42"];
        let sink = Sink::new();
        let emulator = Emulator::builder().version_lines(lines).build();
        let delivered = record(emulator, &sink, Window::DETECTION, 3).await;
        let scans: Vec<Scan> = sink.open().scans().collect::<Result<_, _>>().unwrap();
        assert_eq!(delivered[2].as_ref().unwrap().scan_time(), time);
        assert_eq!(scans.iter().map(Scan::scan_time).collect::<Vec<_>>(), [time; 3]);
    }
}

#[tokio::test(start_paused = true)]
async fn scans_of_a_file_without_its_end_are_read() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 10).await;
    let whole = sink.bytes();
    for (missing, is_truncated) in [(0, false), (1, true), (30, true)] {
        let file = whole[..whole.len() - missing].to_vec();
        let mut scans = Recording::read(Cursor::new(file)).unwrap().scans();
        assert_eq!(scans.by_ref().filter(Result::is_ok).count(), 10);
        assert_eq!(scans.recording().is_truncated(), is_truncated, "{missing} bytes");
    }
}

#[tokio::test(start_paused = true)]
async fn a_scan_of_another_window_answers_another_request() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let (sensor, mut scans) =
        observed(&recorder, sensor(), Window::DETECTION, Rate::hz(10.0)).await;
    next(&mut recorder, &mut scans, 3).await;
    sensor.scan(window(100, 110, 1)).await.unwrap();
    next(&mut recorder, &mut scans, 3).await;
    recorder.finish().await.unwrap();
    let mut scans = sink.open().scans();
    assert!(scans.by_ref().all(|scan| scan.unwrap().window() == Window::DETECTION));
    let left_out = scans.recording().left_out().counts();
    let reasons: Vec<_> = left_out.iter().map(|count| count.reason).collect();
    assert_eq!(reasons, [LeftOutReason::OtherRequest]);
}

#[tokio::test(start_paused = true)]
async fn debug_output_is_short() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 3).await;
    let recording = sink.open();
    let text = format!("{recording:?}");
    assert!(text.starts_with("Recording {") && text.contains("H0713090"), "{text}");
    let mut scans = recording.scans();
    scans.by_ref().take(2).for_each(drop);
    assert_eq!(format!("{scans:?}"), "RecordedScans { sequence: 2, .. }");
}

#[tokio::test(start_paused = true)]
async fn a_replay_without_scans_is_an_error() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    recorder.observe(&sensor);
    recorder.finish().await.unwrap();
    let items: Vec<_> = sink.open().scans().collect();
    assert!(matches!(items[..], [Err(RecordingError::NoScans { .. })]), "{items:?}");
    assert!(matches!(sink.open().replay(ReplayPace::Max), Err(RecordingError::NoScans { .. })));
}

/// Returns a sensor whose scans have distances and, in every seventh step, an error code.
fn with_errors() -> Emulator {
    let world = |time: WorldTime, values: &mut Values| {
        for (step, value) in values.iter_mut().enumerate() {
            *value = match step % 7 {
                0 => 7,
                _ => 20 + ((time.request * 7 + step as u64 * 3) % 4000) as u32,
            };
        }
    };
    Emulator::builder().world(world).build()
}

#[tokio::test(start_paused = true)]
async fn a_recording_without_replies_has_the_scans_of_its_messages() {
    let whole = [
        Window::DETECTION,
        Window::FULL,
        window(0, 0, 1),
        window(768, 768, 1),
        window(44, 142, 99),
        window(100, 108, 3),
    ];
    // The last point has fewer steps, which no message tells.
    let uneven = [window(100, 107, 3), window(100, 101, 3)];
    for window in whole.into_iter().chain(uneven) {
        for is_described in [true, false] {
            if !is_described && uneven.contains(&window) {
                continue;
            }
            let sink = Sink::new();
            let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
            let sensor = Sensor::builder().depth(64).connect(with_errors()).await.unwrap();
            let mut stream = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
            if is_described {
                recorder.describe(&sensor, &stream).await.unwrap();
            }
            let live = next(&mut recorder, &mut stream, 10).await;
            recorder.finish().await.unwrap();

            let mut recorded = sink.open().scans();
            let scans: Vec<Scan> = recorded.by_ref().map(Result::unwrap).collect();
            assert_eq!(scans.len(), live.len());
            for (scan, live) in scans.iter().zip(&live) {
                assert_eq!((scan.window(), scan.sequence()), (window, live.sequence()));
                let range = |range: f32| (!range.is_nan()).then_some(range);
                assert!(scan.ranges().map(range).eq(live.ranges().map(range)));
                let error = scan.first_ray_stamp().duration_since(live.first_ray_stamp());
                let error = error.unwrap_or_else(|before| before.duration());
                assert!(error < Duration::from_micros(10), "{error:?}");
            }
            let version = recorded.version();
            let known = sensor.version().await.unwrap();
            let expected = if is_described { known.serial_number } else { "".into() };
            assert_eq!(version.serial_number, expected);

            let emulator = sink.open().replay(ReplayPace::Recorded).unwrap();
            // The first fence asks for a random step: once in 769 times for the only step of a window,
            // whose first reply it takes.
            fastrand::seed(7);
            let replay = Sensor::builder().depth(64).connect(emulator).await.unwrap();
            assert_eq!(replay.version().await.unwrap().serial_number, expected);
            let mut stream = replay.scans(window, Rate::hz(10.0)).await.unwrap();
            let mut replayed = Vec::new();
            while let Some(scan) = stream.next().await {
                replayed.push(scan.unwrap().raw_values().collect::<Vec<_>>());
            }
            assert!(replayed == values(&scans), "{window}");
        }
    }
}

/// The messages of a recording with replies are not read as scans a second time.
#[tokio::test(start_paused = true)]
async fn a_recording_is_replayed_without_its_reply_to_v() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let observer = recorder.observer();
    let without_version = move |reply: RawReply<'_>| {
        if reply.command != Some(Command::Version) {
            observer(reply);
        }
    };
    let builder = Sensor::builder().on_reply(without_version).depth(64);
    let sensor = builder.connect(sensor()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let live = values(&next(&mut recorder, &mut stream, 10).await);
    recorder.finish().await.unwrap();
    let scans: Vec<Scan> = sink.open().scans().map(Result::unwrap).collect();
    assert!(live == values(&scans));
    let emulator = sink.open().replay(ReplayPace::Max).unwrap();
    let replay = Sensor::builder().depth(64).connect(emulator).await.unwrap();
    assert_eq!(replay.version().await.unwrap(), tokio_scip::Version::default());
    let mut stream = replay.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    let mut replayed = Vec::new();
    while let Some(scan) = stream.next().await {
        replayed.push(scan.unwrap().raw_values().collect::<Vec<_>>());
    }
    assert_eq!(replayed, live);
}

/// Pipe whose writer pauses after the bytes.
struct PausedPipe(Cursor<Vec<u8>>);

impl Read for PausedPipe {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self.0.read(bytes)? {
            0 => Err(io::ErrorKind::WouldBlock.into()),
            read => Ok(read),
        }
    }
}

#[tokio::test(start_paused = true)]
async fn scans_in_a_pipe_come_without_further_bytes() {
    let sink = Sink::new();
    let (mut recorder, mut length) =
        (Recorder::builder().write_to(sink.clone()).unwrap(), sink.length());
    let sensor = Sensor::builder().depth(64).connect(sensor()).await.unwrap();
    recorder.observe(&sensor);
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    recorder.describe(&sensor, &stream).await.unwrap();
    next(&mut recorder, &mut stream, 3).await;
    // The writer ends the chunk by itself after a second of real time.
    let began = *length.borrow_and_update();
    while *length.borrow_and_update() < began + 3 * 1400 {
        length.changed().await.unwrap();
    }
    let pipe = PausedPipe(Cursor::new(sink.bytes()));
    let mut scans = Recording::read(pipe).unwrap().scans();
    for _ in 0..3 {
        assert!(matches!(scans.next(), Some(Ok(_))));
    }
    // The sensor went on meanwhile.
    let error = scans.find_map(Result::err);
    assert!(matches!(error, Some(RecordingError::Read { .. })), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn a_damaged_chunk_is_an_item_between_the_scans() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 600).await;
    let mut file = sink.bytes();
    let middle = file.len() / 2;
    file[middle] ^= 1;
    let recording = Recording::read(Cursor::new(file)).unwrap();
    let items: Vec<_> = recording.scans().collect();
    let at = items.iter().position(Result::is_err).unwrap();
    assert!(matches!(items[at], Err(RecordingError::Damaged { .. })));
    assert!(at > 0 && items.len() > at + 100, "{at} of {}", items.len());
    assert_eq!(items.iter().filter(|item| item.is_err()).count(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_part_has_exactly_the_scans_of_its_time() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 50).await;
    let all: Vec<Scan> = sink.open().scans().collect::<Result<_, _>>().unwrap();
    let (from, to) = (Duration::from_secs(1), Duration::from_secs(3));
    let is_inside =
        |scan: &&Scan| (from..to).contains(&(scan.received_at() - all[0].received_at()));
    let expected = values(all.iter().filter(is_inside));
    assert!((15..=25).contains(&expected.len()), "{}", expected.len());
    let part: Vec<Scan> = sink.open().range(from..to).scans().collect::<Result<_, _>>().unwrap();
    assert_eq!(values(&part), expected);

    let replayed = replayed(sink.open().range(from..to), Window::DETECTION).await;
    assert_eq!(values(&replayed), expected);
    // A part without a scan.
    let mut none = sink.open().range(Duration::from_secs(99)..).scans();
    assert!(matches!(none.next(), Some(Err(RecordingError::NoScans { .. }))));
}

fn scans_from(path: &Path, place: Duration) -> RecordedScans {
    Recording::open(path).unwrap().range(place..).scans()
}

#[tokio::test(start_paused = true)]
async fn a_part_is_reached_through_the_index() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 600).await;
    let mut all = sink.open().scans();
    let (mut places, mut expected) = (Vec::new(), Vec::new());
    while let Some(scan) = all.next() {
        places.push(all.position());
        expected.push(scan.unwrap());
    }
    assert_eq!(places[0], Duration::ZERO);
    // Damage shows that it was read.
    let mut bytes = sink.bytes();
    let quarter = bytes.len() / 4;
    bytes[quarter] ^= 1;
    let folder = Folder::new("part");
    let path = folder.write(&bytes);
    for number in [300, 599, 301] {
        let mut scans = scans_from(&path, places[number]).numbered_from(number as u64);
        let first = scans.next().unwrap().unwrap();
        assert_eq!(first.sequence(), number as u64);
        assert!(first.raw_values().eq(expected[number].raw_values()));
        assert_eq!(scans.position(), places[number]);
        let rest: Vec<Scan> = scans.collect::<Result<_, _>>().unwrap();
        let following = &expected[number + 1..];
        assert_eq!(values(&rest), values(following), "{number}");
    }
    // Without its index the file is read from its beginning.
    let path = folder.write(&bytes[..bytes.len() - 100]);
    let items: Vec<_> = scans_from(&path, places[300]).collect();
    assert!(matches!(items[0], Err(RecordingError::Damaged { .. })), "{:?}", items[0]);
    assert_eq!(items.iter().filter(|item| item.is_ok()).count(), 300);
}

#[tokio::test(start_paused = true)]
async fn a_part_survives_an_outdated_index() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 200).await;
    // Ten bytes are missing before the part, and ten too many after its beginning.
    let mut bytes = sink.bytes();
    let quarter = bytes.len() / 4;
    bytes.drain(quarter..quarter + 10);
    bytes.splice(3 * quarter..3 * quarter, [0; 10]);
    let place = Duration::from_secs(10);
    let values = |recording: Recording| -> Vec<_> {
        let scans = recording.range(place..).scans().filter_map(Result::ok);
        scans.map(|scan| scan.raw_values().collect::<Vec<_>>()).collect()
    };
    let folder = Folder::new("shifted");
    let found = values(Recording::open(folder.write(&bytes)).unwrap());
    let expected = values(Recording::read(Cursor::new(bytes)).unwrap());
    assert!((70..100).contains(&expected.len()), "{}", expected.len());
    assert_eq!(found, expected);
}

#[tokio::test(start_paused = true)]
async fn a_part_finds_channels_defined_only_once() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 100).await;
    let options = mcap::WriteOptions::new().compression(None).chunk_size(Some(10_000));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let metadata = sink.open().metadata().clone();
    let metadata = mcap::records::Metadata { name: "tokio_scip".to_owned(), metadata };
    writer.write_metadata(&metadata).unwrap();
    // The channel of scans is defined where the first one is: in what is left out.
    let messages = sink.bytes();
    let messages = mcap::MessageStream::new(&messages).unwrap().map(Result::unwrap);
    for message in
        messages.filter(|message| message.channel.topic != "/scan" || message.sequence > 20)
    {
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    let bytes = writer.into_inner().into_inner();
    let place = Duration::from_secs(5);
    let records = |recording: Recording| -> Vec<_> {
        recording.range(place..).collect::<Result<_, _>>().unwrap()
    };
    let folder = Folder::new("channels");
    let found = records(Recording::open(folder.write(&bytes)).unwrap());
    let is_scan = |record: &&Record| matches!(record.entry, Entry::Scan(_));
    assert!((45..=55).contains(&found.iter().filter(is_scan).count()), "{found:?}");
    assert_eq!(found, records(Recording::read(Cursor::new(bytes)).unwrap()));
}

#[tokio::test(start_paused = true)]
async fn a_wrong_or_unchecked_index_is_ignored() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 30).await;
    let whole = sink.bytes();
    let place = Duration::from_secs(2);
    let values = |scans: RecordedScans| -> Vec<_> {
        scans.filter_map(Result::ok).map(|scan| scan.raw_values().collect::<Vec<_>>()).collect()
    };
    let expected = values(sink.open().range(place..).scans());
    assert!(expected.len() > 5);
    let folder = Folder::new("index");
    // The index is the end of the file, with some 40 bytes after it.
    for at in (whole.len() - 900..whole.len()).step_by(7) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x11;
        let path = folder.write(&bytes);
        assert_eq!(values(scans_from(&path, place)), expected, "{at}");
        // Zero stands for no checksum. The magic follows it.
        let crc = bytes.len() - 12;
        bytes[crc..crc + 4].fill(0);
        let path = folder.write(&bytes);
        assert_eq!(values(scans_from(&path, place)), expected, "{at}, without a checksum");
    }
}

/// A part may begin or end exactly where a chunk does, for example at its first message.
#[tokio::test(start_paused = true)]
async fn a_part_through_the_index_has_the_scans_of_its_time() {
    let sink = Sink::new();
    record(sensor(), &sink, window(300, 320, 1), 60).await;
    let folder = Folder::new("bounds");
    let path = folder.write(&sink.bytes());
    let mut scans = sink.open().scans();
    let mut truth = Vec::new();
    while let Some(scan) = scans.next() {
        truth.push((scans.position(), scan.unwrap().times().stamp));
    }
    for seed in seeds("URG_BOUNDS", 200) {
        let mut random = Random::new(seed);
        let mut bound = || {
            let at = random.pick(&truth).0 + Duration::from_nanos(random.below(3));
            let at = at.saturating_sub(Duration::from_nanos(1));
            match random.below(5) {
                0 => Bound::Unbounded,
                1 | 2 => Bound::Excluded(at),
                _ => Bound::Included(at),
            }
        };
        let range = (bound(), bound());
        let expected: Vec<_> =
            truth.iter().filter(|(at, _)| range.contains(at)).map(|(_, stamp)| *stamp).collect();
        let part = Recording::open(&path).unwrap().range(range).scans();
        let found: Vec<_> = part.filter_map(Result::ok).map(|scan| scan.times().stamp).collect();
        assert_eq!(found, expected, "seed {seed}, {range:?}");
    }
}

/// A malformed reply to a poll of `length` bytes, as a message.
fn malformed_poll(request: &str, length: usize) -> Vec<u8> {
    let label = text(&format!("{request}\0"));
    let padding = vec![0; label.len().next_multiple_of(4) - label.len()];
    let bytes = [request.as_bytes(), &vec![b'\n'; length - request.len()]].concat();
    let head = [&[0, 1, 0, 0, 1, 0, 0, 0][..], &label, &padding, &[0; 12]].concat();
    let data = [&head[..], &(length as u32).to_le_bytes(), &bytes].concat();
    of_kind(0x05, &[&[0; 22][..], &data].concat())
}

/// The driver widens some polls. Without metadata, the narrowest of the first polls is the stream's.
#[test]
fn a_stream_is_found_among_256_polls_or_a_mebibyte() {
    let channel = of_kind(0x04, &channel_content(0, "/scip/replies"));
    for (wide, length, is_found) in [
        (1, 20, true),
        (255, 20, true),
        (256, 20, false),
        (300, 20, false),
        (7, 1 << 17, true),
        (8, (1 << 17) - 1, true),
        (8, 1 << 17, false),
    ] {
        let polls = malformed_poll("G09719901", length).repeat(wide);
        let file = [MAGIC, &channel, &polls, &malformed_poll("G10019901", 20)].concat();
        let mut scans = Recording::read(Cursor::new(file)).unwrap().scans();
        assert_eq!(scans.by_ref().filter(Result::is_ok).count(), 0);
        assert_eq!(scans.failed_polls(), 0);
        let left_out = scans.recording().left_out().counts();
        let found: Vec<_> = left_out.iter().map(|left| (left.reason, left.messages)).collect();
        let failed = (LeftOutReason::FailedPoll, (wide + usize::from(is_found)) as u64);
        let other = (!is_found).then_some((LeftOutReason::OtherRequest, 1));
        assert_eq!(found, [failed].into_iter().chain(other).collect::<Vec<_>>(), "{wide} {length}");
    }
}
