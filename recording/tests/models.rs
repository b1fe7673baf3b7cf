//! Recordings of each model: every scan that is read, replayed, cut or repaired is the one that the
//! driver delivered, with the geometry of its sensor.

use std::collections::{HashMap, VecDeque};
use std::io::Cursor;
use std::time::{Duration, SystemTime};

use tokio::time::sleep;
use tokio_scip::protocol::Command;
use tokio_scip::protocol::scip2::{self, Request};
use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_emulator::{Emulator, Fault, Faults, Model, Values, WorldTime};
use urg_recording::{
    Entry, LeftOutCounter, LeftOutReason, Record, Recorder, Recording, ReplayPace, cut, repair,
};

use crate::common::random::{Random, seeds};
use crate::sink::{
    Sink, model as sensor_model, next, observed, record, replayed, window as window_of,
};

const MODELS: [Model; 4] = [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];

/// What a recording has: with replies, with metadata, or with messages alone.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Has {
    replies: bool,
    metadata: bool,
}

/// At the sensor's own rate, the scans have intensities if it measures them.
async fn recorded(
    model: Model,
    has: Has,
    (window, rate): (Window, Rate),
    count: usize,
) -> (Vec<u8>, Vec<Scan>) {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let builder = Sensor::builder().depth(1 << 10).intensities(rate == Rate::UNLIMITED);
    let sensor = builder.connect(sensor_model(model)).await.unwrap();
    if has.replies {
        recorder.observe(&sensor);
    }
    let mut scans = sensor.scans(window, rate).await.unwrap();
    if has.metadata {
        recorder.describe(&sensor, &scans).await.unwrap();
    }
    let delivered = next(&mut recorder, &mut scans, count).await;
    recorder.finish().await.unwrap();
    (sink.bytes(), delivered)
}

fn open(file: &[u8]) -> Recording {
    Recording::read(Cursor::new(file.to_vec())).unwrap()
}

fn read(file: &[u8]) -> Vec<Scan> {
    open(file).scans().map(Result::unwrap).collect()
}

fn is_laser_on(record: &Record) -> bool {
    let Entry::Reply(reply) = &record.entry else { return false };
    let request = reply.request.as_ref().map(Request::command);
    reply.command == Some(Command::LaserOn) || request == Some(&scip2::Command::LaserOn)
}

fn bits(scan: &Scan) -> Vec<u32> {
    scan.ranges().map(f32::to_bits).collect()
}

#[tokio::test(start_paused = true)]
async fn scans_of_each_model_are_read_and_replayed() {
    let degrees = Window::degrees(-20.0..=30.0).unwrap().with_cluster_count(3).unwrap();
    for model in MODELS {
        for (replies, metadata) in [(true, true), (true, false), (false, true), (false, false)] {
            for (window, rate) in [
                (Window::DETECTION, Rate::hz(10.0)),
                (Window::DETECTION, Rate::UNLIMITED),
                (degrees, Rate::UNLIMITED),
                // By polls, if forty scans come in a second.
                (degrees, Rate::hz(2.0)),
            ] {
                let has = Has { replies, metadata };
                let case = format!("{model:?}, {has:?}, {window}, {rate}");
                let (file, delivered) = recorded(model, has, (window, rate), 8).await;
                let recording = open(&file);
                // Its steps, whatever is known of the sensor.
                let steps = delivered[0].window();
                let steps = window_of(steps.start(), steps.end(), steps.cluster_count());
                assert_eq!(recording.window(), metadata.then(|| delivered[0].window()), "{case}");
                let mut scans = recording.scans();
                scans.by_ref().for_each(drop);
                let is_known = scans.version() != Default::default();
                assert_eq!(is_known, replies || metadata, "{case}");
                let mut whole = Vec::new();
                assert_eq!(
                    repair(Cursor::new(file.clone()), &mut whole).unwrap().scans,
                    8,
                    "{case}"
                );
                let mut part = Vec::new();
                let since = |n: usize| delivered[n].received_at() - delivered[0].received_at();
                let range = (since(1) + since(2)) / 2..(since(4) + since(5)) / 2;
                let copied =
                    cut([Cursor::new(file.clone())], range.clone(), None, &mut part).unwrap();
                assert_eq!(copied.scans, 3, "{case}");
                for (place, (found, delivered)) in [
                    (read(&file), &delivered[..]),
                    (read(&whole), &delivered[..]),
                    (read(&part), &delivered[2..5]),
                    (
                        open(&file).range(range).scans().map(Result::unwrap).collect(),
                        &delivered[2..5],
                    ),
                    (replayed(open(&file), steps).await, &delivered[..]),
                    (replayed(open(&part), steps).await, &delivered[2..5]),
                ]
                .into_iter()
                .enumerate()
                {
                    let case = format!("{case}, {place}");
                    assert_eq!(found.len(), delivered.len(), "{case}");
                    for (found, delivered) in found.iter().zip(delivered) {
                        let points = |window: Window| (window.start(), window.points());
                        assert_eq!(points(found.window()), points(delivered.window()), "{case}");
                        assert_eq!(found.angle_min(), delivered.angle_min(), "{case}");
                        assert_eq!(bits(found), bits(delivered), "{case}");
                        let own = |scan: &Scan| scan.intensities().map(<[u32]>::to_vec);
                        // A replay asks for them.
                        let is_own = place < 4 || own(delivered).is_some();
                        assert!(!is_own || own(found) == own(delivered), "{case}");
                        if replies {
                            assert_eq!(found.is_repeat(), delivered.is_repeat(), "{case}");
                            let values = |scan: &Scan| -> Vec<u32> { scan.raw_values().collect() };
                            assert_eq!(values(found), values(delivered), "{case}");
                        }
                        if replies || metadata {
                            assert_eq!(found.geometry(), delivered.geometry(), "{case}");
                            let error = found.scan_time().abs_diff(delivered.scan_time());
                            assert!(error < Duration::from_nanos(10), "{case}: {error:?}");
                        }
                    }
                }
            }
        }
    }
}

/// The line delivers some replies twice.
#[tokio::test(start_paused = true)]
async fn replies_alone_have_each_scan_once() {
    for model in MODELS {
        let sink = Sink::new();
        let recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        let emulator = sensor_model(model);
        let (_sensor, mut scans) =
            observed(&recorder, emulator.clone(), Window::DETECTION, Rate::UNLIMITED).await;
        emulator.set_faults(Faults::none().rate(0.3, Fault::Doubled).seed(1));
        let mut delivered = Vec::new();
        while delivered.len() < 50 {
            delivered.extend(scans.next().await.unwrap());
        }
        recorder.finish().await.unwrap();
        let found = read(&sink.bytes());
        // Of two equal replies, the stamp of the first.
        let told = |scan: &Scan| (scan.times().stamp, bits(scan));
        assert!(found.iter().take(50).map(told).eq(delivered.iter().map(told)), "{model:?}");
    }
}

/// Beside a stream of another window, the sensor sends both in one, and the driver makes the clusters.
#[tokio::test(start_paused = true)]
async fn clusters_of_a_shared_stream_are_read_as_delivered() {
    for seed in seeds("SHARED", 24) {
        let mut random = Random::new(seed);
        let model = *random.pick(&[Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx]);
        let has_intensities = random.once_in(2);
        let sink = Sink::new();
        let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        let builder = Sensor::builder().depth(1 << 10).intensities(has_intensities);
        let sensor = builder.connect(sensor_model(model)).await.unwrap();
        let other = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        recorder.observe(&sensor);
        let start = 100 + random.below(300) as u16;
        let window = window_of(start, start + random.below(100) as u16, 2 + random.below(9) as u8);
        let mut scans = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        // Without its messages, so that each scan is read from its reply.
        let mut delivered = Vec::new();
        while delivered.len() < 20 {
            delivered.push(scans.next().await.unwrap().unwrap());
        }
        recorder.finish().await.unwrap();
        drop(other);
        let found = read(&sink.bytes());
        let case = format!("seed {seed}, {model:?}, {window:?}, {has_intensities}");
        let told = |scan: &Scan| {
            let intensities = scan.intensities().map(<[u32]>::to_vec);
            (scan.window(), scan.raw_values().collect::<Vec<_>>(), intensities)
        };
        let first = found.iter().position(|scan| told(scan) == told(&delivered[0]));
        let found = found.iter().skip(first.expect(&case)).take(20).map(told);
        assert!(found.eq(delivered.iter().map(told)), "{case}");
    }
}

/// Another program may have rounded the log times, or written the same one for all messages, and then sorted
/// the topics: rosbags 0.11.9 writes `/scan` before the replies.
#[tokio::test(start_paused = true)]
async fn scans_of_one_log_time_are_read_once() {
    for (model, is_still) in MODELS.into_iter().flat_map(|model| [(model, false), (model, true)]) {
        let sink = Sink::new();
        let world = |_: WorldTime, codes: &mut Values| codes.iter_mut().for_each(|code| *code = 99);
        let emulator = match is_still {
            true => Emulator::builder().model(model).world(world).build(),
            false => sensor_model(model),
        };
        let delivered = record(emulator, &sink, window_of(300, 320, 1), 30).await;
        let delivered: Vec<_> = delivered.into_iter().map(Result::unwrap).collect();
        let file = sink.bytes();
        let metadata = sink.open().metadata().clone();
        for seed in seeds("ONE_LOG_TIME", 40) {
            let mut random = Random::new(seed);
            let unit = *random.pick(&[1, 1_000_000, 300_000_000, 1_000_000_000, u64::MAX]);
            let [has_scans, has_stamps, is_described] =
                [9, 4, 5].map(|of_ten| random.below(10) < of_ten);
            let case = format!("{model:?}, {is_still}, seed {seed}");
            // With its own times, a file may lack the reply of a scan, its message or both.
            let loses = unit == 1 && has_stamps && random.once_in(2);
            let nanos = |scan: &Scan| {
                let stamp = scan.times().stamp.duration_since(SystemTime::UNIX_EPOCH);
                stamp.unwrap().as_nanos() as u64
            };
            let fates =
                delivered.iter().map(|scan| (nanos(scan), if loses { random.below(8) } else { 8 }));
            let fates: HashMap<u64, u64> = fates.collect();
            let is_left = |scan: &&Scan| match fates[&nanos(scan)] {
                0 => has_scans,
                fate => fate != 2,
            };
            let delivered: Vec<_> = delivered.iter().filter(is_left).cloned().collect();
            let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
            if is_described {
                let (name, metadata) = ("tokio_scip".to_owned(), metadata.clone());
                writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
            }
            // Each topic keeps its order.
            let mut queues = [VecDeque::new(), VecDeque::new()];
            for message in mcap::MessageStream::new(&file).unwrap() {
                let mut message = message.unwrap();
                let is_scan = message.channel.topic == "/scan";
                let fate = fates.get(&message.publish_time);
                let is_lost = fate.is_some_and(|fate| [u64::from(is_scan), 2].contains(fate));
                message.log_time -= message.log_time % unit;
                if !has_stamps {
                    message.publish_time = message.log_time;
                }
                if (has_scans || !is_scan) && !is_lost {
                    queues[usize::from(is_scan)].push_back(message);
                }
            }
            let share = random.below(5);
            while let Some(at) =
                queues.iter().flat_map(VecDeque::front).map(|message| message.log_time).min()
            {
                let is_scan = random.below(4) < share;
                let mut order = [usize::from(is_scan), usize::from(!is_scan)].into_iter();
                let place = order
                    .find(|place| queues[*place].front().is_some_and(|next| next.log_time == at))
                    .unwrap();
                writer.write(&queues[place].pop_front().unwrap()).unwrap();
            }
            writer.finish().unwrap();
            let written = writer.into_inner().into_inner();
            let found = read(&written);
            assert!(
                found.iter().map(bits).eq(delivered.iter().map(bits)),
                "{case}, {}",
                found.len()
            );
            let stamps = |scans: &[Scan]| -> Vec<_> {
                scans.iter().map(|scan| scan.times().stamp).collect()
            };
            assert!(!has_stamps || stamps(&found) == stamps(&delivered), "{case}");
            let outcome = repair(Cursor::new(written), &mut Vec::new()).unwrap();
            assert_eq!(outcome.scans, delivered.len() as u64, "{case}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_replay_has_the_version_of_each_model() {
    for model in MODELS {
        let sensor = Sensor::builder().connect(sensor_model(model)).await.unwrap();
        let version = sensor.version().await.unwrap();
        let has = Has { replies: true, metadata: true };
        let (file, _) = recorded(model, has, (Window::DETECTION, Rate::hz(10.0)), 2).await;
        let replay = open(&file).replay(ReplayPace::Max).unwrap();
        let sensor = Sensor::builder().connect(replay).await.unwrap();
        let replayed = sensor.version().await.unwrap();
        assert_eq!(format!("{replayed:?}"), format!("{version:?}"), "{model:?}");
    }
}

/// Metadata and messages of two streams in any order: a copy counts what a reader of it finds.
#[tokio::test(start_paused = true)]
async fn a_copy_counts_the_scans_of_any_stream() {
    for model in MODELS {
        let mut streams = Vec::new();
        for first in [300, 340] {
            let stream = (window_of(first, first + 20, 1), Rate::hz(10.0));
            let has = Has { replies: true, metadata: true };
            let (file, _) = recorded(model, has, stream, 8).await;
            let metadata = open(&file).metadata().clone();
            let messages = mcap::MessageStream::new(&file).unwrap().map(Result::unwrap);
            streams.push((metadata, messages.collect::<Vec<_>>()));
        }
        for seed in seeds("URG_STREAMS", 60) {
            let mut random = Random::new(seed);
            let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
            for _ in 0..random.below(20) {
                let (metadata, messages) = random.pick(&streams);
                if random.once_in(4) {
                    let (name, metadata) = ("tokio_scip".to_owned(), metadata.clone());
                    writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
                } else {
                    writer.write(random.pick(messages)).unwrap();
                }
            }
            writer.finish().unwrap();
            let file = writer.into_inner().into_inner();
            let count = |file: &[u8]| open(file).scans().filter(Result::is_ok).count() as u64;
            let mut copy = Vec::new();
            let told = repair(Cursor::new(file.clone()), &mut copy).unwrap().scans;
            assert_eq!((told, count(&copy)), (count(&file), count(&file)), "{model:?}, {seed}");
        }
    }
}

/// A copy repeats the last reply to `PP` before a part, unless another sensor was described since.
#[tokio::test(start_paused = true)]
async fn a_part_has_the_sensor_that_was_described_last() {
    let (stream, has) =
        ((Window::DETECTION, Rate::hz(10.0)), Has { replies: true, metadata: true });
    let (other, _) = recorded(Model::Utm30lx, has, stream, 1).await;
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let builder = Sensor::builder().on_reply(recorder.observer());
    let sensor = builder.connect(sensor_model(Model::Ust10lx)).await.unwrap();
    // The sensor is asked for a window that holds both.
    let _wider = sensor.scans(window_of(200, 400, 1), Rate::UNLIMITED).await.unwrap();
    let mut scans = sensor.scans(window_of(300, 320, 1), Rate::UNLIMITED).await.unwrap();
    recorder.describe(&sensor, &scans).await.unwrap();
    next(&mut recorder, &mut scans, 40).await;
    recorder.finish().await.unwrap();
    let file = sink.bytes();
    let messages = |file| mcap::MessageStream::new(file).unwrap().map(Result::unwrap);
    let asks_sensor = |message: &mcap::Message<'_>| {
        message.channel.topic == "/scip/replies" && message.data[12..].starts_with(b"PP")
    };
    let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
    let reply = messages(&other).find(asks_sensor).unwrap();
    writer.write(&reply).unwrap();
    let (name, metadata) = ("tokio_scip".to_owned(), sink.open().metadata().clone());
    writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
    let rest = messages(&file).filter(|message| !asks_sensor(message));
    rest.for_each(|message| writer.write(&message).unwrap());
    writer.finish().unwrap();
    let joined = writer.into_inner().into_inner();
    let range = Duration::from_millis(300)..;
    let expected: Vec<_> = open(&joined).range(range.clone()).scans().map(Result::unwrap).collect();
    let mut part = Vec::new();
    let copied = cut([Cursor::new(joined)], range, None, &mut part).unwrap();
    assert_eq!(copied.scans, expected.len() as u64);
    let told = |scan: &Scan| (*scan.geometry(), bits(scan));
    assert!(expected.len() > 10 && read(&part).iter().map(told).eq(expected.iter().map(told)));
}

/// A message does not tell how many steps its last point has.
#[tokio::test(start_paused = true)]
async fn a_later_description_tells_the_last_step() {
    for (model, last) in MODELS.into_iter().flat_map(|model| [(model, 305), (model, 301)]) {
        let sink = Sink::new();
        let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        let sensor = Sensor::builder().connect(sensor_model(model)).await.unwrap();
        let mut scans = sensor.scans(window_of(300, last, 4), Rate::hz(10.0)).await.unwrap();
        let mut delivered = next(&mut recorder, &mut scans, 3).await;
        recorder.describe(&sensor, &scans).await.unwrap();
        delivered.extend(next(&mut recorder, &mut scans, 3).await);
        recorder.finish().await.unwrap();
        let told = |scan: &Scan| (scan.window(), bits(scan));
        let found = read(&sink.bytes());
        assert!(found.iter().map(told).eq(delivered.iter().map(told)), "{model:?}, {last}");
    }
}

/// A sensor in SCIP 2 sends more scans than some of these rates ask for. Each one sends more after
/// the last recorded scan.
#[tokio::test(start_paused = true)]
async fn a_recording_has_the_scans_of_its_stream() {
    for model in MODELS {
        for (hz, missed, late) in [3.0, 7.0, 10.0, 23.0, 30.0, 1000.0]
            .into_iter()
            .flat_map(|hz| [(hz, 0, 0), (hz, 5, 0), (hz, 0, 300)])
        {
            let sink = Sink::new();
            let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
            let builder = Sensor::builder().depth(1 << 10);
            let sensor = builder.connect(sensor_model(model)).await.unwrap();
            recorder.observe(&sensor);
            let mut scans = sensor.scans(Window::DETECTION, Rate::hz(hz)).await.unwrap();
            // The consumer is late, so replies come before the first recorded scan.
            sleep(Duration::from_millis(late)).await;
            let mut delivered = next(&mut recorder, &mut scans, 50).await;
            for _ in 0..missed {
                delivered.push(scans.next().await.unwrap().unwrap());
            }
            delivered.extend(next(&mut recorder, &mut scans, 50).await);
            sleep(Duration::from_millis(300)).await;
            recorder.finish().await.unwrap();
            let stamps = |scans: &[Scan]| -> Vec<_> {
                scans.iter().map(|scan| scan.times().stamp).collect()
            };
            let (mut found, expected) = (stamps(&read(&sink.bytes())), stamps(&delivered));
            if missed > 0 {
                // Nothing tells which ones the consumer has missed.
                found.retain(|stamp| expected.contains(stamp));
            }
            assert_eq!(found, expected, "{model:?}, {hz} Hz, {missed} missed, {late} ms");
        }
    }
}

/// The driver asks for one step to see whether the sensor measures.
/// Without its last line feed, a reply runs into the next one.
#[tokio::test(start_paused = true)]
async fn a_scan_after_the_rest_of_another_is_recorded_once() {
    for model in MODELS {
        let sink = Sink::new();
        let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        let emulator = sensor_model(model);
        let sensor = Sensor::builder().depth(1 << 10).connect(emulator.clone()).await.unwrap();
        recorder.observe(&sensor);
        let mut scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let faults = Faults::none().rate(0.2, Fault::Merged).rate(0.2, Fault::Cut(100)).seed(1);
        emulator.set_faults(faults);
        let mut delivered = Vec::new();
        while delivered.len() < 50 {
            let item = scans.next().await.unwrap();
            recorder.record(&item).unwrap();
            delivered.extend(item);
        }
        recorder.finish().await.unwrap();
        let file = sink.bytes();
        let mut again = Vec::new();
        let replay = open(&file).replay(ReplayPace::Max).unwrap();
        let sensor = Sensor::builder().depth(1 << 10).connect(replay).await.unwrap();
        let mut replayed = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        while let Some(item) = replayed.next().await {
            again.extend(item);
        }
        let told = |scan: &Scan| (scan.times().stamp, bits(scan));
        for found in [open(&file).scans().filter_map(Result::ok).collect(), again] {
            assert!(found.iter().map(told).eq(delivered.iter().map(told)), "{model:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_probe_is_no_scan() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let emulator = sensor_model(Model::Ust10lx);
    let builder = Sensor::builder().on_reply(recorder.observer());
    let sensor = builder.connect(emulator).await.unwrap();
    sensor.laser_on().await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    let delivered = next(&mut recorder, &mut scans, 5).await;
    sensor.laser_on().await.unwrap();
    recorder.finish().await.unwrap();
    // The latter one came after the last scan.
    assert!(sink.records().iter().filter(|record| is_laser_on(record)).count() > 1);
    let read = read(&sink.bytes());
    assert_eq!(read.len(), 5);
    assert!(read[0].raw_values().eq(delivered[0].raw_values()));
}

/// Another window than the recorded one shows what it has, also of a sensor with 18 bits.
#[tokio::test(start_paused = true)]
async fn another_window_of_a_sensor_in_scip_2_is_replayed() {
    let has = Has { replies: true, metadata: true };
    let (file, delivered) =
        recorded(Model::Utm30lx, has, (Window::DETECTION, Rate::hz(10.0)), 5).await;
    let window = Window::new(1000..=1080).unwrap();
    let replayed = replayed(open(&file), window).await;
    assert_eq!(replayed.len(), 5);
    for (replayed, delivered) in replayed.iter().zip(&delivered) {
        assert!(replayed.raw_values().eq(delivered.raw_values().skip(1000)));
    }
    let sink = Sink::new();
    record(open(&file).replay(ReplayPace::Max).unwrap(), &sink, window, 5).await;
    let clocks = |recording: Recording| {
        let mut scans = recording.scans();
        std::iter::from_fn(move || scans.next().map(|_| scans.sensor_clock())).collect::<Vec<_>>()
    };
    let recorded = clocks(open(&file));
    assert!(recorded.iter().all(Option::is_some) && recorded[0] < recorded[1]);
    assert_eq!(clocks(sink.open()), recorded);
}

/// In SCIP 2 a driver takes no empty text.
#[tokio::test(start_paused = true)]
async fn a_replay_has_the_version_that_the_metadata_tell() {
    let keys = ["vendor", "product", "firmware", "protocol", "serial_number"];
    let has = Has { replies: false, metadata: true };
    for model in MODELS {
        let (file, _) = recorded(model, has, (Window::DETECTION, Rate::hz(10.0)), 2).await;
        for seed in seeds("URG_VERSIONS", 8) {
            let mut random = Random::new(seed);
            let mut metadata = open(&file).metadata().clone();
            let lost: Vec<_> = keys.into_iter().filter(|_| random.once_in(2)).collect();
            lost.iter().for_each(|key| drop(metadata.remove(*key)));
            let expected = keys.map(|key| match metadata.get(key) {
                Some(value) => value.clone(),
                None if model == Model::Urg04lx => String::new(),
                None => "unknown".to_owned(),
            });
            let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
            let name = "tokio_scip".to_owned();
            writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
            let messages = mcap::MessageStream::new(&file).unwrap();
            messages.for_each(|message| writer.write(&message.unwrap()).unwrap());
            writer.finish().unwrap();
            let replay = open(&writer.into_inner().into_inner()).replay(ReplayPace::Max).unwrap();
            let sensor = Sensor::builder().connect(replay).await.unwrap();
            let version = sensor.version().await.unwrap();
            let texts = [
                version.vendor.to_string(),
                version.product.to_string(),
                version.firmware.to_string(),
                version.protocol.to_string(),
                version.serial_number.to_string(),
            ];
            assert_eq!(texts, expected, "{model:?}, seed {seed}");
        }
    }
}

/// Each scan that is read has the geometry of its own sensor. A replay is of one sensor.
#[tokio::test(start_paused = true)]
async fn two_sensors_lie_in_one_file() {
    let pairs = [(0, 3), (3, 1), (0, 1), (2, 1)];
    for (one, other) in pairs.map(|(one, other)| (MODELS[one], MODELS[other])) {
        let has = Has { replies: true, metadata: true };
        let stream = (Window::DETECTION, Rate::hz(10.0));
        // At the same time, by the wall clock.
        let (first, of_one) = recorded(one, has, stream, 20).await;
        let (second, of_other) = recorded(other, has, stream, 20).await;
        let mut joined = Vec::new();
        let copied = cut([first, second].map(Cursor::new), .., None, &mut joined).unwrap();
        let found = read(&joined);
        assert_eq!((copied.scans, found.len()), (40, 40), "{one:?}, {other:?}");
        for scan in &found {
            let mut delivered = of_one.iter().chain(&of_other);
            let delivered = delivered.find(|it| it.times().stamp == scan.times().stamp).unwrap();
            assert_eq!(scan.geometry(), delivered.geometry());
            assert!(scan.raw_values().eq(delivered.raw_values()));
            let error = scan.scan_time().abs_diff(delivered.scan_time());
            assert!(error < Duration::from_nanos(10), "{one:?}, {other:?}: {error:?}");
        }
        let counts = |left_out: LeftOutCounter| {
            left_out.counts().iter().map(|count| (count.reason, count.messages)).collect::<Vec<_>>()
        };
        let recording = open(&joined);
        let left_out = recording.left_out();
        let steps = found[0].window();
        let steps = window_of(steps.start(), steps.end(), steps.cluster_count());
        assert_eq!(replayed(recording, steps).await.len(), 20);
        assert_eq!(counts(left_out), [(LeftOutReason::OtherLaser, 20)]);
        let mut scans = open(&joined).scans().of_one_sensor();
        assert!(scans.by_ref().all(|scan| scan.unwrap().geometry() == found[0].geometry()));
        assert_eq!(counts(scans.recording().left_out()), [(LeftOutReason::OtherLaser, 20)]);
    }
}
