//! Messages of latched topics before a part: the last one of each topic, as far as memory allows.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::time::Duration;

use mcap::WriteOptions;
use mcap::records::MessageHeader;
use urg_recording::cut;

use super::raw::text;
use crate::common::random::Random;

const SECOND: u64 = 1_000_000_000;
const BEGAN: u64 = 1_700_000_000 * SECOND;
/// Most bytes of latched messages, and how many a topic takes besides.
const MOST: usize = 64 << 20;
const TOPIC: usize = 64;
const TOPICS: [(u16, &str, &str); 4] = [
    (1, "/map", "nav_msgs/msg/OccupancyGrid"),
    (2, "/costmap", "nav_msgs/msg/OccupancyGrid"),
    (3, "/tf_static", "tf2_msgs/msg/TFMessage"),
    // One of a recording's own, which is also kept as it was read.
    (4, "/scip/events", "std_msgs/msg/String"),
];
const POLL: u16 = 5;

/// Message that is kept: its log time, number and bytes in memory.
type Kept = (u64, u32, usize);

/// Some messages come late, or at the time of another one.
#[test]
fn the_last_latched_messages_that_fit_begin_a_part() {
    let mut lost = 0;
    for seed in 0..4 {
        let random = &mut Random::new(seed);
        // Without chunks, each message is a part that may be lost.
        let options = WriteOptions::new().compression(None).use_chunks(false);
        let options = options.calculate_data_section_crc(false);
        let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
        let profiles = ("offered_qos_profiles".to_owned(), "- durability: 1\n".to_owned());
        let latched = BTreeMap::from([profiles]);
        for (number, topic, name) in TOPICS {
            let schema = writer.add_schema_with_id(number, name, "ros2msg", b"").unwrap();
            writer.add_channel_with_id(number, schema, topic, "cdr", &latched).unwrap();
        }
        let name = "std_msgs/msg/UInt8MultiArray";
        let schema = writer.add_schema_with_id(POLL, name, "ros2msg", b"").unwrap();
        let none = BTreeMap::new();
        writer.add_channel_with_id(POLL, schema, "/scip/replies", "cdr", &none).unwrap();
        let mut write = |(channel_id, sequence): (u16, u32), seconds, data: &[u8]| {
            let log_time = BEGAN + seconds * SECOND;
            let header = MessageHeader { channel_id, sequence, log_time, publish_time: 1 };
            writer.write_to_known_channel(&header, data).unwrap();
        };
        // The time of a part counts from a poll. This one has no reply.
        let request = [&[0, 1, 0, 0, 1, 0, 0, 0][..], &text("G00000001\0")].concat();
        let poll = [&request[..], &[0; 18]].concat();
        write((POLL, 0), 0, &poll);
        let mut kept: BTreeMap<u16, Kept> = BTreeMap::new();
        let mut damaged = 0;
        for number in 1..9_u32 {
            let (channel, _, _) = *random.pick(&TOPICS);
            let copies = if channel == 4 { 2 } else { 1 };
            let used: usize = kept.values().map(|(_, _, bytes)| bytes).sum();
            let room = (MOST - TOPIC * (kept.len() + 1)).saturating_sub(used) / copies;
            let length = match random.below(4) {
                0 if room > 100 => room,
                1 if room > 100 => room + 1,
                _ => 100 + random.below(36 << 20) as usize,
            };
            let mut data = vec![b'a'; length];
            data[..4].copy_from_slice(&[0, 1, 0, 0]);
            data[4..8].copy_from_slice(&(length as u32 - 8).to_le_bytes());
            data[length - 1] = 0;
            let seconds = 1 + random.below(2);
            write((channel, number), seconds, &data);
            if used + copies * length + TOPIC * (kept.len() + 1) > MOST {
                damaged += 1;
            } else if kept.get(&channel).is_none_or(|(last, ..)| *last <= seconds) {
                kept.insert(channel, (seconds, number, copies * length));
            }
        }
        lost += damaged;
        write((POLL, 9), 60, &poll);
        writer.finish().unwrap();
        let file = Cursor::new(writer.into_inner().into_inner());
        let mut part = Vec::new();
        let copied = cut([file], Duration::from_secs(60).., None, &mut part).unwrap();
        let begun = mcap::MessageStream::new(&part).unwrap().map(|message| {
            let message = message.unwrap();
            assert_eq!(message.log_time, BEGAN + 60 * SECOND, "{seed}");
            message.sequence
        });
        let mut expected: Vec<_> = kept.values().collect();
        expected.sort();
        let expected = expected.iter().map(|(_, number, _)| *number).chain([9]);
        assert_eq!(begun.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{seed}");
        assert_eq!((copied.damaged_parts, copied.was_truncated), (damaged, false), "{seed}");
    }
    assert!(lost > 3, "{lost}");
}
