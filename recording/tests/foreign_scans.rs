//! Random bags of scans as other programs write them: any windows, clusters, ranges and times,
//! messages of other lasers, types and encodings, and messages that are cut short. The truth is
//! written down with each message: a scan with its values, or the reason why there is none.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::time::{Duration, SystemTime};

use mcap::WriteOptions;
use mcap::records::{MessageHeader, Metadata};
use tokio_scip::{Scan, Window};
use urg_recording::{Entry, LeftOut, LeftOutReason, Recording, RecordingError, cut, cut_topic};

use crate::common::random::{Random, seeds};
use crate::raw::{claims, of_kind, text};
use crate::sink::{replayed, window};

const SECOND: i64 = 1_000_000_000;

/// Laser scanner whose messages are written.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scanner {
    /// Steps in a revolution.
    resolution: u16,
    /// Limits of the ranges in millimetres.
    limits: (f32, f32),
    /// Values that stand for `NaN` and for `+Inf`.
    unknown: u32,
    far: u32,
    /// Limits in a message, in metres, if others than the sensor's.
    written: Option<(f32, f32)>,
}

const fn scanner(
    resolution: u16,
    limits: (f32, f32),
    [unknown, far]: [u32; 2],
    written: Option<(f32, f32)>,
) -> Scanner {
    Scanner { resolution, limits, unknown, far, written }
}

/// A URG-04LX in SCIP 1.1 and in SCIP 2, sensors of 1,440 and 2,880 steps, and a UXM-30LAH-EWA. Then sensors
/// without limits, with limits that no sensor has, without a lower one, and with a later beginning.
const SCANNERS: [Scanner; 9] = [
    scanner(1024, (20.0, 4094.0), [19, 16], None),
    scanner(1024, (20.0, 5600.0), [19, 0], None),
    scanner(1440, (23.0, 60_000.0), [0, 65_533], None),
    scanner(2880, (21.0, 30_000.0), [0, 65_533], None),
    scanner(2880, (23.0, 120_000.0), [0, 120_001], None),
    scanner(1440, (20.0, 60_000.0), [0, 65_533], Some((f32::NAN, f32::NAN))),
    scanner(2880, (20.0, 60_000.0), [0, 65_533], Some((0.1, 300.0))),
    scanner(1440, (1.0, 30_000.0), [0, 65_533], Some((0.0, 30.0))),
    scanner(1440, (100.0, 60_000.0), [0, 65_533], None),
];

/// Ranges in a message besides distances.
const RANGES: [f32; 17] = [
    f32::INFINITY,
    1e30,
    f32::NEG_INFINITY,
    f32::NAN,
    0.0,
    -0.5,
    0.0004,
    0.001,
    0.006,
    0.019,
    0.02,
    4.094,
    4.1,
    5.6,
    8.0,
    65.533,
    120.0,
];

impl Scanner {
    /// Value that a range stands for.
    fn value(&self, range: f32) -> u32 {
        let millimetres = (f64::from(range) * 1000.0).round();
        match () {
            () if millimetres > f64::from(self.limits.1) => self.far,
            () if millimetres >= 0.0 => millimetres as u32,
            () => self.unknown,
        }
    }

    /// What a message tells of its sensor: the directions, and whether it speaks SCIP 2.
    fn kind(&self) -> (u16, bool) {
        (self.resolution, self.far == 16)
    }

    /// Step straight ahead.
    fn front(&self) -> u16 {
        self.resolution / 8 * 3
    }

    /// Last step.
    fn last(&self) -> u16 {
        self.resolution / 4 * 3
    }

    /// Angle of a step in radians.
    fn step(&self) -> f64 {
        2.0 * std::f64::consts::PI / f64::from(self.resolution)
    }

    /// What a recording tells about it in SCIP 2.
    fn parameters(&self) -> Vec<(String, String)> {
        let model = match (self.resolution, self.far) {
            (1024, _) => "URG-04LX",
            (_, 120_001) => "UXM-30LAH-EWA",
            _ => "UST-10LX",
        };
        let numbers = [
            ("DMIN", self.limits.0 as u32),
            ("DMAX", self.limits.1 as u32),
            ("ARES", self.resolution.into()),
            ("AMIN", 0),
            ("AMAX", self.last().into()),
            ("AFRT", self.front().into()),
            ("SCAN", if self.resolution == 1024 { 600 } else { 2400 }),
        ];
        let pairs = numbers.map(|(key, value)| (key.to_owned(), value.to_string()));
        [("MODL".to_owned(), model.to_owned())].into_iter().chain(pairs).collect()
    }
}

/// Time of a revolution in a message, and in nanoseconds what it stands for: `None` is the nominal one.
const REVOLUTIONS: [(f32, Option<i64>); 11] = [
    (0.2, Some(SECOND / 5)),
    (0.1, Some(SECOND / 10)),
    (0.066_67, Some(66_670_000)),
    (0.025, Some(SECOND / 40)),
    (0.0, None),
    (100.0, None),
    (1e8, None),
    (-0.1, None),
    (f32::NAN, None),
    (f32::INFINITY, None),
    (f32::MAX, None),
];

#[derive(Debug, Clone, PartialEq)]
struct Expected {
    scanner: Scanner,
    window: Window,
    values: Vec<u32>,
    intensities: Vec<u32>,
    /// Time in the header.
    first_ray: i64,
    revolution: i64,
}

/// Messages of a bag: scans, and counts of others.
#[derive(Default)]
struct Truth {
    scans: Vec<Expected>,
    left_out: BTreeMap<LeftOutReason, u64>,
    /// True if there are scans in the form of Foxglove's SDK, on a topic of their own.
    has_viewed: bool,
}

/// Form of a message.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    Defined,
    /// The angles point to the first and the last step.
    UrgNode,
    OtherLaser,
    Short,
    Compressed,
    OtherHeader,
    Ros1,
    OtherType,
    Json,
    OtherTopic,
}

const FORMS: [Form; 10] = [
    Form::Defined,
    Form::UrgNode,
    Form::OtherLaser,
    Form::Short,
    Form::Compressed,
    Form::OtherHeader,
    Form::Ros1,
    Form::OtherType,
    Form::Json,
    Form::OtherTopic,
];

/// Window that a message can tell: the last cluster of a message by definition has all steps that exist.
fn any_window(random: &mut Random, form: Form, scanner: Scanner) -> Window {
    loop {
        let most = *random.pick(&[12, 99]);
        let cluster = 1 + random.below(most) as u16;
        let points = 2 + random.below(30) as u16;
        let start = match random.below(8) {
            0 => 0,
            1 => scanner.last() - random.below(300) as u16,
            _ => random.below(u64::from(scanner.last()) - 68) as u16,
        };
        let last = start + (points - 1) * cluster;
        let rest = match form {
            Form::UrgNode => random.below(cluster.into()) as u16,
            _ => (cluster - 1).min(scanner.last().saturating_sub(last)),
        };
        let end = last + rest;
        // With these angles, both forms are one.
        let is_both = form == Form::UrgNode && cluster % 2 == 1 && rest == 0 && cluster > 1;
        // These may be steps of a sensor of 1,440 as well.
        let is_coarse =
            form == Form::UrgNode && scanner.resolution == 2880 && cluster.is_multiple_of(2);
        // 45 steps of 1,440 or 2,880 are whole steps of a sensor of 1,024, too.
        let is_common = scanner.resolution != 1024 && cluster.is_multiple_of(45);
        if end <= scanner.last() && !is_both && !is_coarse && !is_common {
            return window(start, end, cluster as u8);
        }
    }
}

fn header_kind(random: &mut Random, form: Form) -> u8 {
    match form {
        Form::OtherHeader => *random.pick(&[2, 3, 8, 9, 10, 11, 99]),
        _ => *random.pick(&[0, 1, 6, 7]),
    }
}

/// Writes a scan of `window`. Returns its CDR, and what it means.
fn message(
    random: &mut Random,
    form: Form,
    scanner: Scanner,
    window: Window,
    stamp: i64,
) -> (Vec<u8>, Expected) {
    let kind = header_kind(random, form);
    let is_big = kind.is_multiple_of(2);
    let mut out = vec![0, kind, 0, random.below(4) as u8];
    let put = |out: &mut Vec<u8>, mut bytes: [u8; 4]| {
        if is_big {
            bytes.reverse();
        }
        out.extend(bytes);
    };
    put(&mut out, ((stamp / SECOND) as i32).to_le_bytes());
    put(&mut out, ((stamp % SECOND) as u32).to_le_bytes());
    let frame: &[u8] = random.pick::<&[u8]>(&[b"front\0", b"rear\0", b"", b"caf\xe9\0"]);
    put(&mut out, (frame.len() as u32).to_le_bytes());
    out.extend(frame);
    out.resize(out.len().next_multiple_of(4), 0);
    let (first, last) = (f64::from(window.start()), f64::from(window.end()));
    let cluster = f64::from(window.cluster_count());
    let mut points = window.points();
    let middle = first + (cluster - 1.0) / 2.0;
    let (from, to) = match form {
        Form::UrgNode => (first, last),
        _ => (middle, middle + cluster * (points - 1) as f64),
    };
    let (front, step) = (f64::from(scanner.front()), scanner.step());
    let (mut from, mut to, mut by) = ((from - front) * step, (to - front) * step, cluster * step);
    if form == Form::OtherLaser {
        match random.below(7) {
            0 => (from, by) = (from + step / 3.0, by),
            // Clockwise, as of a sensor that is mounted upside down.
            1 => (from, to, by) = (to, from, -by),
            2 => by *= 0.73,
            3 => from = f64::NAN,
            4 => from = -3.1,
            5 => {
                let beyond = f64::from(scanner.last() + 1 - window.start()) * step;
                (from, to) = (from + beyond, to + beyond);
            }
            _ => points = *random.pick(&[0, 70_000]),
        }
    }
    let (scan_time, revolution) = *random.pick(&REVOLUTIONS);
    let nominal = if scanner.resolution == 1024 { SECOND / 10 } else { SECOND / 40 };
    let revolution = revolution.unwrap_or(nominal);
    let increment = scan_time * cluster as f32 / f32::from(scanner.resolution);
    // A scan time is of several revolutions if the sensor skips scans. Only the increment tells.
    let (turns, increment) =
        *random.pick(&[(1.0, 0.0), (1.0, increment), (2.0, increment), (10.0, increment)]);
    let scan_time = scan_time * turns;
    let own = (scanner.limits.0 / 1000.0, scanner.limits.1 / 1000.0);
    let (least, most) = scanner.written.unwrap_or(own);
    let fields = [from as f32, to as f32, by as f32, increment, scan_time, least, most];
    fields.iter().for_each(|field| put(&mut out, field.to_le_bytes()));
    let length = match form {
        // A length that no memory could hold.
        Form::Short if random.once_in(8) => u32::MAX,
        _ => points as u32,
    };
    put(&mut out, length.to_le_bytes());
    let mut values = Vec::new();
    for _ in 0..points {
        let distance = 23 + random.below(scanner.limits.1 as u64 - 22) as u32;
        let range =
            if random.once_in(3) { *random.pick(&RANGES) } else { distance as f32 / 1000.0 };
        put(&mut out, range.to_le_bytes());
        values.push(scanner.value(range));
    }
    let whole = out.len();
    // Some programs write other numbers than a sensor sends, or not one for each range.
    let other =
        *random.pick(&[None, None, None, Some(0.5), Some(-1.0), Some(262_144.0), Some(f32::NAN)]);
    let count = *random.pick(&[0, points, points, points / 2]);
    put(&mut out, (count as u32).to_le_bytes());
    let mut intensities = Vec::new();
    for number in 0..count {
        let intensity = random.below(1 << 18) as u32;
        let written = other.filter(|_| number == count / 2).unwrap_or(intensity as f32);
        put(&mut out, written.to_le_bytes());
        intensities.push(intensity);
    }
    if other.is_some() || count != points {
        intensities.clear();
    }
    match form {
        Form::Short => out.truncate(random.below(whole as u64) as usize),
        Form::Compressed => out.splice(..0, [0x28, 0xb5, 0x2f, 0xfd]).for_each(drop),
        _ => {}
    }
    (out, Expected { scanner, window, values, intensities, first_ray: stamp, revolution })
}

/// Names of the message's type: of rosbag2; in mcap-ros2-support's example; in the IDL; of DDS Recorder 1.5.3.
const SCAN_NAMES: [&str; 4] = [
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/LaserScan",
    "sensor_msgs::msg::LaserScan",
    "sensor_msgs::msg::dds_::LaserScan_",
];

/// Writes a bag of up to 40 messages, described as a recording of `described` or not. Most have one
/// scanner.
fn bag(random: &mut Random, described: Option<(Scanner, Window)>) -> (Vec<u8>, Truth) {
    let options = WriteOptions::new().compression(None).chunk_size(Some(1 + random.below(4000)));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let scan = *random.pick(&SCAN_NAMES);
    for (id, topic, name, encoding) in [
        (1, "/scan", scan, "cdr"),
        (2, "/scan", "sensor_msgs/LaserScan", "ros1"),
        (3, "/scan", "my_msgs/msg/Scan", "cdr"),
        (4, "/scan", scan, "json"),
        (5, "/rear/scan", scan, "cdr"),
        (6, "/viewed", "foxglove.LaserScan", "protobuf"),
    ] {
        let schema = writer.add_schema_with_id(id, name, "ros2msg", b"").unwrap();
        writer.add_channel_with_id(id, schema, topic, encoding, &BTreeMap::new()).unwrap();
    }
    if let Some((scanner, window)) = described {
        let fields = [
            ("start", window.start()),
            ("end", window.end()),
            ("cluster", window.cluster_count().into()),
        ];
        let fields = fields.map(|(key, value)| (key.to_owned(), value.to_string()));
        let told = if scanner == SCANNERS[0] { Vec::new() } else { scanner.parameters() };
        let metadata = fields.into_iter().chain(told).collect();
        writer.write_metadata(&Metadata { name: "tokio_scip".to_owned(), metadata }).unwrap();
    }
    let mut truth = Truth::default();
    let mut scanner = described.map_or_else(|| *random.pick(&SCANNERS), |(scanner, _)| scanner);
    let is_mixed = random.once_in(4);
    let mut window = any_window(random, Form::Defined, scanner);
    let (mut log_time, mut stamp) = (1_700_000_000 * SECOND, 1_700_000_000 * SECOND);
    let (log_step, stamp_step) =
        (*random.pick(&[SECOND / 10, 0]), *random.pick(&[SECOND / 10, 0, -SECOND / 10]));
    if random.once_in(4) {
        (log_time, stamp) = (log_time * random.below(2) as i64, 0);
    }
    for sequence in 0..random.below(40) as u32 {
        let form = if random.once_in(2) { Form::Defined } else { *random.pick(&FORMS) };
        if random.once_in(8) {
            scanner = if is_mixed { *random.pick(&SCANNERS) } else { scanner };
            window = any_window(random, Form::Defined, scanner);
        }
        let (scanner, written) = match described.filter(|_| random.once_in(2)) {
            Some((known, window)) => {
                // Another sensor's message is told from the described one's only by that sensor's limits.
                let others = SCANNERS.into_iter().filter(|other| other.kind() == known.kind());
                let others: Vec<_> = others.filter(|other| other.written.is_none()).collect();
                let other = if others.is_empty() { known } else { *random.pick(&others) };
                (if is_mixed { other } else { known }, window)
            }
            None if form == Form::UrgNode => (scanner, any_window(random, form, scanner)),
            None => (scanner, window),
        };
        let (data, expected) = message(random, form, scanner, written, stamp);
        let channel_id = match form {
            Form::Ros1 => 2,
            Form::OtherType => 3,
            Form::Json => 4,
            Form::OtherTopic => 5,
            _ => 1,
        };
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: log_time as u64,
            publish_time: log_time as u64,
        };
        writer.write_to_known_channel(&header, &data).unwrap();
        if random.once_in(8) {
            truth.has_viewed = true;
            let header = MessageHeader { channel_id: 6, ..header };
            writer.write_to_known_channel(&header, &data).unwrap();
        }
        let reason = match form {
            Form::Defined | Form::UrgNode => None,
            Form::OtherLaser => Some(LeftOutReason::OtherLaser),
            Form::Short => Some(LeftOutReason::Malformed),
            Form::Compressed => Some(LeftOutReason::Compressed),
            Form::OtherHeader | Form::Json => Some(LeftOutReason::OtherEncoding),
            Form::Ros1 => Some(LeftOutReason::Ros1),
            Form::OtherType => Some(LeftOutReason::OtherType),
            Form::OtherTopic => Some(LeftOutReason::OtherTopic),
        };
        let is_other = described.is_some_and(|(known, window)| {
            (known.kind(), window) != (scanner.kind(), expected.window)
        });
        match reason.or(is_other.then_some(LeftOutReason::OtherWindow)) {
            Some(reason) => *truth.left_out.entry(reason).or_default() += 1,
            None => truth.scans.push(expected),
        }
        log_time += log_step;
        stamp = (stamp + stamp_step).max(0);
    }
    writer.finish().unwrap();
    (writer.into_inner().into_inner(), truth)
}

fn open(file: &[u8]) -> Recording {
    Recording::read(Cursor::new(file.to_vec())).unwrap()
}

fn counted(counts: &[LeftOut]) -> BTreeMap<LeftOutReason, u64> {
    counts.iter().map(|count| (count.reason, count.messages)).collect()
}

fn check(scan: &Scan, expected: &Expected) {
    assert_eq!(
        (scan.window(), scan.raw_values().collect()),
        (expected.window, expected.values.clone())
    );
    assert_eq!(scan.intensities().unwrap_or_default(), expected.intensities);
    let is_distance = |value: &u32| match *value {
        65_533 => expected.scanner.far > 65_533,
        // A UXM sends it for nothing in range.
        120_000.. => false,
        _ => true,
    };
    let distances: Vec<u32> = scan.distances().flatten().collect();
    assert!(distances.iter().all(|value| *value > 0 && is_distance(value)), "{distances:?}");
    let walls = expected.values.iter().filter(|value| **value == 65_533 && is_distance(value));
    assert_eq!(distances.iter().filter(|value| **value == 65_533).count(), walls.count());
    let (least, most) = scan.geometry().distances().into_inner();
    let (limits, near) = (expected.scanner.limits, |a: u32, b: f32| (a as f32 - b).abs() <= 1.0);
    assert!(near(least, limits.0) && near(most, limits.1), "{least}..={most}, {limits:?}");
    let ahead = scan.geometry().degrees(expected.scanner.front());
    let resolution = scan.geometry().steps_per_revolution();
    assert_eq!((ahead, resolution), (0.0, expected.scanner.resolution));
    let near = |found: Duration, wanted: i64| {
        let error = (found.as_nanos() as i64 - wanted).abs();
        assert!(error < 3_000, "{found:?}: {error} ns from {wanted}");
    };
    near(scan.scan_time(), expected.revolution);
    near(
        scan.first_ray_stamp().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default(),
        expected.first_ray,
    );
}

#[tokio::test(start_paused = true)]
async fn every_message_is_a_scan_or_counted() {
    let (mut totals, mut nothing) = (BTreeMap::new(), 0);
    for seed in seeds("URG_FOREIGN", 400) {
        let random = &mut Random::new(seed);
        let described = random.once_in(3).then(|| {
            let scanner = *random.pick(&SCANNERS);
            (scanner, any_window(random, Form::Defined, scanner))
        });
        let (file, truth) = bag(random, described);
        let mut recorded = open(&file).scans();
        let mut scans = Vec::new();
        for scan in recorded.by_ref() {
            match scan {
                Ok(scan) => scans.push(scan),
                Err(RecordingError::NoScans { topics, others, .. }) => {
                    assert!(truth.scans.is_empty(), "{seed}");
                    let is_other = truth.left_out.contains_key(&LeftOutReason::OtherTopic);
                    assert_eq!(topics, vec!["/rear/scan"; is_other.into()], "{seed}");
                    let viewed = vec!["/viewed (foxglove.LaserScan)"; truth.has_viewed.into()];
                    assert_eq!(others, viewed, "{seed}");
                    nothing += 1;
                }
                Err(error) => panic!("{seed}: {error}"),
            }
        }
        let left_out = recorded.recording().left_out().counts();
        assert_eq!(counted(&left_out), truth.left_out, "{seed}: {left_out:?}");
        // Nothing more is known of a compressed message.
        let is_compressed = |count: &&LeftOut| count.reason == LeftOutReason::Compressed;
        assert!(left_out.iter().filter(is_compressed).all(|count| count.first == "/scan"));
        let is_other = |count: &&LeftOut| count.reason == LeftOutReason::OtherLaser;
        let shows = |count: &LeftOut| count.first.contains(" points from ");
        assert!(left_out.iter().filter(is_other).all(shows), "{left_out:?}");
        assert_eq!(scans.len(), truth.scans.len(), "{seed}");
        scans.iter().zip(&truth.scans).for_each(|(scan, expected)| check(scan, expected));
        // The first message of an unknown sensor tells the speed of its motor, to 100 rpm.
        let unknown =
            truth.scans.first().filter(|scan| described.is_none() && scan.scanner != SCANNERS[0]);
        if let (Some(scan), Some(expected)) = (scans.first(), unknown) {
            let rpm = |nanos: f64| 60e9 / nanos;
            let error = rpm(scan.geometry().revolution().as_nanos() as f64)
                - rpm(expected.revolution as f64);
            assert!(error.abs() < 1.0, "{seed}: {error} rpm");
        }
        for (reason, count) in counted(&left_out) {
            *totals.entry(reason).or_insert(0) += count;
        }
        // A description is of the recorded stream, and not of another topic.
        let rear = open(&file).topic("/rear/scan").scans().filter(Result::is_ok).count() as u64;
        assert_eq!(
            rear,
            truth.left_out.get(&LeftOutReason::OtherTopic).copied().unwrap_or(0),
            "{seed}"
        );
        // A copy counts the same scans.
        let mut copy = Vec::new();
        let copied = cut([Cursor::new(file.clone())], .., None, &mut copy).unwrap();
        assert_eq!(copied.scans, scans.len() as u64, "{seed}");
        // So does a replay, and it has the values of each.
        let Some(first) = truth.scans.first().filter(|_| seed % 4 == 0) else { continue };
        let recording = open(&file);
        let counter = recording.left_out();
        let replayed = replayed(recording, first.window).await;
        // A replay is of one sensor.
        let (same, others): (Vec<_>, Vec<_>) =
            truth.scans.iter().partition(|scan| scan.scanner.kind() == first.scanner.kind());
        let mut left_out = truth.left_out;
        if !others.is_empty() {
            *left_out.entry(LeftOutReason::OtherLaser).or_default() += others.len() as u64;
        }
        assert_eq!(counted(&counter.counts()), left_out, "{seed}: replayed");
        assert_eq!(replayed.len(), same.len(), "{seed}: replayed");
        for (replayed, expected) in replayed.iter().zip(same) {
            if expected.window == first.window {
                assert!(
                    replayed.raw_values().eq(expected.values.iter().copied()),
                    "{seed}: replayed"
                );
            }
        }
    }
    println!("left out: {totals:?}; {nothing} bags without a scan");
    assert!(nothing > 5, "{nothing}");
    assert!(totals.len() == 8 && totals.values().all(|count| *count > 5), "{totals:?}");
}

#[test]
fn another_type_is_named() {
    let mut writer = WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    let name = "foxglove.LaserScan";
    let schema = writer.add_schema_with_id(1, name, "protobuf", b"").unwrap();
    writer.add_channel_with_id(1, schema, "/scan", "protobuf", &BTreeMap::new()).unwrap();
    let header = MessageHeader { channel_id: 1, sequence: 0, log_time: 1, publish_time: 1 };
    writer.write_to_known_channel(&header, b"").unwrap();
    writer.finish().unwrap();
    let error = open(&writer.into_inner().into_inner()).scans().next().unwrap().unwrap_err();
    let expected = "sensor_msgs/msg/LaserScan of a URG on the topic /scan; \
                    1 message of another type (/scan, foxglove.LaserScan)";
    assert!(error.to_string().ends_with(expected), "{error}");
}

/// Writes scans of a window ten times a second, after some descriptions of a URG-04LX.
fn described_bag(
    described: &[Window],
    window: Window,
    tenths: std::ops::Range<i64>,
) -> Cursor<Vec<u8>> {
    let mut writer = WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    for window in described {
        let metadata = [("start", window.start()), ("end", window.end()), ("cluster", 1)];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_string())).into();
        writer.write_metadata(&Metadata { name: "tokio_scip".to_owned(), metadata }).unwrap();
    }
    let name = "sensor_msgs/msg/LaserScan";
    let schema = writer.add_schema_with_id(1, name, "ros2msg", b"").unwrap();
    writer.add_channel_with_id(1, schema, "/scan", "cdr", &BTreeMap::new()).unwrap();
    for tenth in tenths {
        let stamp = 1_700_000_000 * SECOND + tenth * SECOND / 10;
        let (data, _) = message(&mut Random::new(1), Form::Defined, SCANNERS[0], window, stamp);
        let log_time = stamp as u64;
        let header = MessageHeader { channel_id: 1, sequence: 0, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
    Cursor::new(writer.into_inner().into_inner())
}

/// A file may have any number of descriptions without a scan. Only the latest sixteen are kept.
#[test]
fn a_stream_may_begin_after_fifteen_other_descriptions() {
    let windows: Vec<Window> = (0..17).map(|more| window(300, 310 + more, 1)).collect();
    for (count, place, scans) in [(16, 0, 5), (17, 0, 0), (17, 1, 5), (17, 16, 5)] {
        let bag = described_bag(&windows[..count], windows[place], 0..5);
        let mut recorded = Recording::read(bag).unwrap().scans();
        let found = recorded.by_ref().filter(|scan| scan.is_ok()).count();
        assert_eq!(found, scans, "{place} of {count}");
        let left_out = counted(&recorded.recording().left_out().counts());
        let others = left_out.get(&LeftOutReason::OtherWindow).copied().unwrap_or_default();
        assert_eq!(others, 5 - scans as u64, "{place} of {count}");
    }
}

/// Joined, two streams take turns. A part may have the scans of the earlier one alone.
#[test]
fn a_part_shows_the_stream_that_it_has() {
    let [long, short] = [window(300, 310, 1), window(400, 420, 1)];
    let bag = |window: Window, seconds: std::ops::Range<i64>| {
        described_bag(&[window], window, seconds.start * 10..seconds.end * 10)
    };
    let mut joined = Vec::new();
    let copied = cut([bag(long, 0..10), bag(short, 3..5)], .., None, &mut joined).unwrap();
    let read = |file: &[u8]| {
        let mut recorded = open(file).scans();
        let windows: Vec<Window> = recorded.by_ref().map(|scan| scan.unwrap().window()).collect();
        let count = |wanted| windows.iter().filter(|window| **window == wanted).count();
        (count(long), count(short), counted(&recorded.recording().left_out().counts()))
    };
    // Once the other one has begun, the scans of the first are left out, and counted.
    let (first, second, left_out) = read(&joined);
    assert_eq!((first, second), (31, 20));
    assert_eq!(left_out, [(LeftOutReason::OtherWindow, 69)].into());
    assert_eq!(copied.scans, 51);
    let mut part = Vec::new();
    let seconds = |seconds| Duration::from_secs(seconds);
    let copied = cut([Cursor::new(joined)], seconds(7)..seconds(9), None, &mut part).unwrap();
    assert_eq!(read(&part), (20, 0, BTreeMap::new()));
    assert_eq!(copied.scans, 20);
}

/// The part is the messages whose log times are in it, of all topics.
#[test]
fn a_part_counts_from_the_scans_of_its_topic() {
    let times = |file: &[u8]| -> Vec<_> {
        let messages = mcap::MessageStream::new(file).unwrap().map(Result::unwrap);
        messages.map(|message| (message.channel.topic.clone(), message.log_time)).collect()
    };
    let (mut parts, mut nothing) = (0, 0);
    for seed in seeds("URG_TOPIC", 200) {
        let random = &mut Random::new(seed);
        let (mut file, _) = bag(random, None);
        if random.once_in(2) {
            // Metadata of a stream, after the header: they say nothing of other topics.
            let pairs = ["start", "44", "end", "50", "cluster", "1"].map(text).concat();
            let pairs = [&text("tokio_scip")[..], &claims(pairs.len() as u32), &pairs].concat();
            let header = 17 + usize::from(file[9]);
            file.splice(header..header, of_kind(0x0c, &pairs));
        }
        let tenths = Duration::from_millis(100);
        let from = tenths * random.below(20) as u32;
        let range = from..from + tenths * (1 + random.below(20) as u32);
        for topic in ["/scan", "/rear/scan"] {
            let first = open(&file).topic(topic).find_map(|record| {
                record.ok().filter(|record| matches!(record.entry, Entry::Scan(_)))
            });
            let mut part = Vec::new();
            let copied =
                cut_topic([Cursor::new(file.clone())], topic, range.clone(), None, &mut part);
            let Some(first) = first else {
                // Without a scan to count from, all is at its time.
                assert_eq!(
                    copied.unwrap().messages > 0,
                    from.is_zero() && !times(&file).is_empty()
                );
                nothing += 1;
                continue;
            };
            let first = first.at.duration_since(SystemTime::UNIX_EPOCH).unwrap();
            let is_inside =
                |at: u64| range.contains(&Duration::from_nanos(at).saturating_sub(first));
            let mut expected = times(&file);
            expected.retain(|(_, at)| is_inside(*at));
            assert_eq!(times(&part), expected, "{seed} {topic}");
            let scans = open(&file).topic(topic).range(range.clone()).scans();
            let scans = scans.filter(Result::is_ok).count() as u64;
            assert_eq!(copied.unwrap().scans, scans, "{seed} {topic}");
            parts += usize::from(scans > 0);
        }
    }
    assert!(parts > 50 && nothing > 20, "{parts} {nothing}");
}
