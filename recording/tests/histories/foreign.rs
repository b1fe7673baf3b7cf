//! Bags as other programs write them: any topics, types and numbers, messages in any form.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions};

use crate::common::random::Random;

/// Start of every bag, give or take minutes.
const BEGAN: u64 = 1_700_000_000_000_000_000;
const SECOND: u64 = 1_000_000_000;

/// Topic, type, and encoding of messages.
const TOPICS: [(&str, &str, &str); 9] = [
    ("/scan", "sensor_msgs/msg/LaserScan", "cdr"),
    ("/scan", "my_msgs/msg/Scan", "cdr"),
    ("/front/scan", "sensor_msgs/msg/LaserScan", "cdr"),
    ("/chatter", "std_msgs/msg/String", "cdr"),
    ("/scip/events", "std_msgs/msg/String", "cdr"),
    ("/camera", "", "json"),
    ("/scip/replies", "std_msgs/msg/UInt8MultiArray", "cdr"),
    ("/tf_static", TRANSFORMS, "cdr"),
    ("/map", "nav_msgs/msg/OccupancyGrid", "cdr"),
];
const TRANSFORMS: &str = "tf2_msgs/msg/TFMessage";
/// Profiles of publishers by their durability, as rosbag2 writes it up to Iron and since Jazzy. The
/// last three latch.
const DURABILITIES: [&[&str]; 6] =
    [&[], &["2"], &["volatile"], &["1"], &["volatile", "transient_local"], &["transient_local"]];

pub(super) fn bag(random: &mut Random) -> Vec<u8> {
    let options = WriteOptions::new()
        .compression(None)
        .profile(*random.pick(&["ros2", ""]))
        .use_chunks(!random.once_in(3))
        .chunk_size(Some(100 + random.below(2_000)))
        .calculate_chunk_crcs(!random.once_in(4))
        .calculate_data_section_crc(random.once_in(2));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    if random.once_in(2) {
        let metadata = BTreeMap::from([("key".to_owned(), random.below(3).to_string())]);
        writer.write_metadata(&Metadata { name: "rosbag2".to_owned(), metadata }).unwrap();
    }
    if random.once_in(4) {
        let (name, media_type) = ("map.yaml".to_owned(), "text/yaml".to_owned());
        let data = vec![*random.pick(&[0, 7]); random.below(999) as usize].into();
        let attachment = Attachment { log_time: 1, create_time: 1, name, media_type, data };
        writer.attach(&attachment).unwrap();
    }
    let mut channels = Vec::new();
    for number in 0..1 + random.below(4) {
        let (topic, name, encoding) = *random.pick(&TOPICS);
        // Numbers are mostly small, so that two bags have some in common.
        let any = |random: &mut Random, bound| 1 + number * 100 + random.below(bound);
        let schema = match name {
            "" => 0,
            name => {
                let id = any(random, 3) as u16;
                writer.add_schema_with_id(id, name, "ros2msg", b"float32 data\n").unwrap()
            }
        };
        let id = (any(random, 3) - u64::from(number == 0)) as u16;
        let qos = random.pick(&DURABILITIES).iter().map(|durability| profile(durability)).collect();
        let qos = BTreeMap::from([("offered_qos_profiles".to_owned(), qos)]);
        writer.add_channel_with_id(id, schema, topic, encoding, &qos).unwrap();
        channels.push((id, name));
    }
    if random.once_in(2) {
        let schema = writer.add_schema_with_id(900, "std_msgs/msg/Empty", "ros2msg", b"").unwrap();
        if random.once_in(2) {
            let none = BTreeMap::new();
            writer.add_channel_with_id(900, schema, "/unused", "cdr", &none).unwrap();
        }
    }
    let is_sorted = !random.once_in(3);
    let mut time = BEGAN + random.below(60) * SECOND;
    for sequence in 0..random.below(60) as u32 {
        time = match is_sorted {
            true => time + random.below(SECOND / 2),
            false => BEGAN + random.below(30 * SECOND),
        };
        let (channel_id, name) = *random.pick(&channels);
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time - 5 };
        let data = match name {
            "sensor_msgs/msg/LaserScan" if !random.once_in(8) => laser_scan(random),
            TRANSFORMS if !random.once_in(8) => transforms(random),
            // Of no form of CDR.
            TRANSFORMS => [vec![9], bytes(random)].concat(),
            // Looks like no transforms.
            "nav_msgs/msg/OccupancyGrid" if random.once_in(4) => vec![0, 1, 0, 0, 0, 0, 0, 0],
            _ => bytes(random),
        };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Returns any data, or small numbers, which have many zeros.
fn bytes(random: &mut Random) -> Vec<u8> {
    let (length, width) = (random.below(200), *random.pick(&[1, 8, 200]));
    let byte = |at| match (width, at % width) {
        (1, _) => random.next() as u8,
        (_, 0 | 1) => random.below(16) as u8,
        _ => 0,
    };
    (0..length).map(byte).collect()
}

/// Returns the profile of one publisher in YAML.
fn profile(durability: &str) -> String {
    let is_number = durability.len() == 1;
    let [history, reliability, liveliness] =
        if is_number { ["3", "1", "1"] } else { ["unknown", "reliable", "automatic"] };
    let time = "\n    sec: 2147483647\n    nsec: 4294967295";
    format!(
        "- history: {history}\n  depth: 0\n  reliability: {reliability}\n  durability: {durability}\n  \
         deadline:{time}\n  lifespan:{time}\n  liveliness: {liveliness}\n  \
         liveliness_lease_duration:{time}\n  avoid_ros_namespace_conventions: false\n"
    )
}

/// Returns a scan of a URG in any form of CDR that ROS writes: either byte order, with options, a
/// time before 1970, or compressed as a whole.
fn laser_scan(random: &mut Random) -> Vec<u8> {
    let is_big = random.once_in(4);
    let options = random.below(4) as u8 * u8::from(random.once_in(4));
    // XCDR2 has the same layout.
    let kind = u8::from(!is_big) + 6 * u8::from(random.once_in(4));
    let mut out = vec![0, kind, 0, options];
    let mut put = |bytes: [u8; 4]| {
        out.extend(match is_big {
            true => bytes.into_iter().rev().collect::<Vec<_>>(),
            false => bytes.to_vec(),
        })
    };
    let seconds = if random.once_in(8) { -5 } else { 1_700_000_000 + random.below(1000) as i32 };
    put(seconds.to_le_bytes());
    put((random.below(SECOND) as u32).to_le_bytes());
    // "abc" and its NUL.
    put(4_u32.to_le_bytes());
    put(if is_big { *b"\0cba" } else { *b"abc\0" });
    let step = std::f32::consts::TAU / 1024.0;
    let points = 5 + random.below(5) as u32;
    for number in [0.0, step * (points - 1) as f32, step, 0.1 / 1024.0, 0.1, 0.02, 4.094] {
        put(number.to_le_bytes());
    }
    put(points.to_le_bytes());
    for _ in 0..points {
        put((random.below(4000) as f32 / 1000.0).to_le_bytes());
    }
    put(0_u32.to_le_bytes());
    if random.once_in(8) {
        return [&[0x28, 0xb5, 0x2f, 0xfd][..], &out].concat();
    }
    out
}

/// Places of letters in a message of transforms, and where that ends after so many of them.
const CHILDREN: [usize; 3] = [28, 112, 192];
const ENDS: [usize; 4] = [8, 92, 172, 252];

/// Returns the places of up to three frames, each named by a letter.
fn transforms(random: &mut Random) -> Vec<u8> {
    let count = random.below(4) as usize;
    let mut out = vec![0, 1, 0, 0, count as u8, 0, 0, 0];
    for _ in 0..count {
        out.extend((0..8).map(|_| random.next() as u8));
        out.extend(b"\x04\0\0\0map\0\x02\0\0\0");
        out.extend([b'a' + random.below(4) as u8, 0]);
        // Numbers of eight bytes are aligned after the header.
        out.resize(4 + (out.len() - 4).next_multiple_of(8) + 56, 7);
    }
    out
}

/// Returns the letters of [`transforms`], or an empty text for another message.
pub(super) fn letters(data: &[u8]) -> Vec<String> {
    let count = data.get(4).map_or(9, |count| usize::from(*count));
    match ENDS.get(count) {
        Some(end)
            if *end == data.len() && data.starts_with(&[0, 1, 0, 0, count as u8, 0, 0, 0]) =>
        {
            CHILDREN[..count].iter().map(|at| char::from(data[*at]).to_string()).collect()
        }
        _ => vec![String::new()],
    }
}

/// Returns true if the message has the form of [`laser_scan`], compressed ones excepted.
pub(super) fn is_readable(data: &[u8]) -> bool {
    // The sequences decide: the ranges, and no intensities.
    let Some(([0, order @ (0 | 1 | 6 | 7), _, _], rest)) = data.split_first_chunk() else {
        return false;
    };
    let number = |at: usize| {
        let bytes: [u8; 4] = rest.get(at..at + 4)?.try_into().ok()?;
        Some(if order % 2 == 1 { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) }
            as usize)
    };
    let length = |at: usize| Some(at + 4 + number(at)?);
    let ranges = length(8).map(|end| end.next_multiple_of(4) + 28);
    ranges.and_then(|at| Some(at + 4 + 4 * number(at)?)).is_some_and(|end| end <= rest.len())
}
