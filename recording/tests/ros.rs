//! Messages of ROS 2, byte by byte.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::time::{Duration, SystemTime};

use sha2::{Digest, Sha256};
use tokio_scip::{Scan, Window};
use urg_recording::Recorder;
use urg_recording::ros::{
    DiagnosticLevel, DiagnosticStatus, MessageType, Transform, write_diagnostics, write_scan,
    write_transforms,
};

use super::sink::{Sink, window};

#[test]
fn a_scan_ends_with_its_intensities_if_it_has_any() {
    let tail = |intensities: &[u32]| {
        let scan = Scan::builder(Window::new(383..=384).unwrap(), [1000, 2000]);
        let scan = scan.intensities(intensities).build().unwrap();
        let mut out = Vec::new();
        write_scan(&mut out, &scan, SystemTime::UNIX_EPOCH, "laser");
        out.split_off(4 + 8 + 12 + 7 * 4)
    };
    let sequence = |numbers: &[f32]| {
        let length = numbers.len() as u32;
        let numbers = numbers.iter().flat_map(|number| number.to_le_bytes());
        length.to_le_bytes().into_iter().chain(numbers).collect::<Vec<_>>()
    };
    let ranges = sequence(&[1.0, 2.0]);
    assert_eq!(tail(&[]), [&*ranges, &sequence(&[])].concat());
    assert_eq!(tail(&[7, 262_143]), [&*ranges, &sequence(&[7.0, 262_143.0])].concat());
}

#[test]
fn a_transform_is_seven_aligned_numbers() {
    let transform = Transform {
        parent: "base".to_owned(),
        child: "laser".to_owned(),
        translation: [0.5, -1.0, 2.0],
        rotation: [0.0, 0.0, PI],
    };
    let mut out = vec![9];
    write_transforms(&mut out, SystemTime::UNIX_EPOCH + Duration::new(2, 100), &[transform]);
    let mut expected = b"\0\x01\0\0\x01\0\0\0\x02\0\0\0\x64\0\0\0\x05\0\0\0base\0\0\0\0\
        \x06\0\0\0laser\0\0\0\0\0\0\0"
        .to_vec();
    // Alignment counts from the end of the header.
    assert_eq!((expected.len() - 4) % 8, 0);
    for number in [0.5, -1.0, 2.0, 0.0, 0.0, 1.0, (PI / 2.0).cos()] {
        expected.extend_from_slice(&f64::to_le_bytes(number));
    }
    assert_eq!(out, expected);
}

/// Rotates a point by each axis in turn, and by the written quaternion.
#[test]
fn a_rotation_is_roll_then_pitch_then_yaw() {
    let point = [1.0, 2.0, 3.0];
    for rotation in [[PI, 0.0, 0.3], [0.0, 0.4, 0.0], [0.7, 0.0, 0.0], [0.7, -0.4, 2.5]] {
        let transform = Transform {
            parent: "a".to_owned(),
            child: "b".to_owned(),
            translation: [0.0; 3],
            rotation,
        };
        let mut out = Vec::new();
        write_transforms(&mut out, SystemTime::UNIX_EPOCH, &[transform]);
        let numbers = out[out.len() - 32..].chunks(8);
        let numbers: Vec<f64> =
            numbers.map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())).collect();
        let [x, y, z, w] = numbers[..] else { panic!("{numbers:?}") };
        let cross = |a: [f64; 3]| [y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]];
        let once = cross(point);
        let twice = cross(once);
        let turned: [f64; 3] = std::array::from_fn(|n| point[n] + 2.0 * (w * once[n] + twice[n]));
        let expected = rotation.iter().zip([(1, 2), (2, 0), (0, 1)]).fold(
            point,
            |mut point, (angle, (from, to))| {
                let (sin, cos) = angle.sin_cos();
                let (a, b) = (point[from], point[to]);
                (point[from], point[to]) = (a * cos - b * sin, a * sin + b * cos);
                point
            },
        );
        for (turned, expected) in turned.into_iter().zip(expected) {
            assert!((turned - expected).abs() < 1e-12, "{rotation:?}: {turned} {expected}");
        }
    }
}

#[test]
fn a_status_is_a_byte_and_aligned_strings() {
    let status = DiagnosticStatus {
        level: DiagnosticLevel::Warn,
        name: "urg".to_owned(),
        message: String::new(),
        hardware_id: "H1".to_owned(),
        values: vec![("a", "bc".to_owned())],
    };
    let mut out = vec![9];
    // Windows counts time in steps of 100 ns.
    let stamp = SystemTime::UNIX_EPOCH + Duration::new(2, 0x6400);
    write_diagnostics(&mut out, stamp, &[status]);
    let expected: &[u8] = b"\0\x01\0\0\x02\0\0\0\0\x64\0\0\x01\0\0\0\0\0\0\0\x01\0\0\0\x01\0\0\0\
        \x04\0\0\0urg\0\x01\0\0\0\0\0\0\0\x03\0\0\0H1\0\0\x01\0\0\0\
        \x02\0\0\0a\0\0\0\x03\0\0\0bc\0";
    assert_eq!(out, expected);
}

/// Hash of REP 2016: SHA-256 over the definition as JSON, formatted as Python does.
fn hash(name: &str, definition: &str) -> String {
    let line = format!("{}\n", "=".repeat(80));
    let mut parts = definition.split(&line);
    let fields = fields(parts.next().unwrap());
    let others: BTreeMap<String, String> = parts
        .map(|part| {
            let (name, definition) = part.strip_prefix("MSG: ").unwrap().split_once('\n').unwrap();
            (name.replace('/', "/msg/"), self::fields(definition))
        })
        .collect();
    let description =
        |name: &str, fields: &str| format!("{{\"type_name\": \"{name}\", \"fields\": [{fields}]}}");
    let others: Vec<_> = others.iter().map(|(name, fields)| description(name, fields)).collect();
    let json = format!(
        "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
        description(name, &fields),
        others.join(", ")
    );
    let digest = Sha256::digest(json.as_bytes());
    let digits: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("RIHS01_{digits}")
}

fn fields(definition: &str) -> String {
    // Constants are not fields.
    let fields = definition.lines().filter(|line| !line.is_empty() && !line.contains('='));
    let fields = fields.map(|line| {
        let (kind, name) = line.split_once(' ').unwrap();
        // A default value is not part of the hash.
        let name = name.split(' ').next().unwrap();
        let element = kind.strip_suffix("[]").unwrap_or(kind);
        let sequence = if element == kind { 0 } else { 144 };
        let (id, nested) = match element {
            "uint8" => (3, String::new()),
            "int32" => (6, String::new()),
            "uint32" => (7, String::new()),
            "float32" => (10, String::new()),
            "float64" => (11, String::new()),
            "byte" => (16, String::new()),
            "string" => (17, String::new()),
            message => (1, message.replace('/', "/msg/")),
        };
        format!(
            "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {}, \"capacity\": 0, \
             \"string_capacity\": 0, \"nested_type_name\": \"{nested}\"}}}}",
            id + sequence
        )
    });
    fields.collect::<Vec<_>>().join(", ")
}

#[tokio::test(start_paused = true)]
async fn each_type_has_the_hash_of_its_definition() {
    for message in [MessageType::LASER_SCAN, MessageType::DIAGNOSTIC_ARRAY, MessageType::TF_MESSAGE]
    {
        assert_eq!(hash(message.name(), message.definition()), message.hash());
    }
    // The others are in recordings alone. A missed scan is an event.
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    for sequence in [0, 2] {
        let scan = Scan::builder(window(383, 384, 1), [1000, 2000]).sequence(sequence).build();
        recorder.record(&Ok(scan.unwrap())).unwrap();
    }
    recorder.finish().await.unwrap();
    let schemas = mcap::Summary::read(&sink.bytes()).unwrap().unwrap().schemas;
    for (name, expected) in [
        (
            "std_msgs/msg/UInt8MultiArray",
            "RIHS01_5687e861b8d307a5e48b7515467ae7a5fc2daf805bd0ce6d8e9e604bade9f385",
        ),
        (
            "std_msgs/msg/String",
            "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
        ),
    ] {
        let schema = schemas.values().find(|schema| schema.name == name).unwrap();
        assert_eq!(hash(name, std::str::from_utf8(&schema.data).unwrap()), expected);
    }
}
