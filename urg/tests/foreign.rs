//! Recordings of other programs: what is left out of them, and times and sources that are not right.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::time::{Duration, Instant, SystemTime};

use mcap::records::MessageHeader;
use serde_json::{Value, json};
use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_emulator::Emulator;
use urg_recording::{Recorder, ros};

use super::formats::{self, scans, values};
use super::program::{Scratch, failure, output_of, run, shell};

/// Message of a bag.
struct Message {
    topic: &'static str,
    log_time: Duration,
    data: Vec<u8>,
}

/// Scan of `window` at a tenth of a second.
fn scan(window: Window, tenth: u64) -> Message {
    of_frame(window, "laser", tenth, Duration::from_millis(100 * tenth))
}

fn of_frame(window: Window, frame: &str, tenth: u64, stamp: Duration) -> Message {
    let values = vec![1000 + tenth as u32; window.points()];
    let scan = Scan::builder(window, values).build().unwrap();
    let mut data = Vec::new();
    ros::write_scan(&mut data, &scan, SystemTime::UNIX_EPOCH + stamp, frame);
    Message { topic: "/scan", log_time: Duration::from_millis(100 * tenth), data }
}

/// Writes a bag. `/old/scan` is of ROS 1, `rt/scan` as DDS Recorder 1.5.3 writes it, and `/viewed` as
/// Foxglove's SDK does.
fn write(file: &Scratch, messages: impl IntoIterator<Item = Message>) {
    let mut bag =
        mcap::WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    let mut channels = BTreeMap::new();
    for message in messages {
        let number = channels.len() as u16 + 1;
        let channel = *channels.entry(message.topic).or_insert_with(|| {
            let (name, encoding) = match message.topic {
                "/old/scan" => ("sensor_msgs/LaserScan", "ros1"),
                "rt/scan" => ("sensor_msgs::msg::dds_::LaserScan_", "cdr"),
                "/viewed" => ("foxglove.LaserScan", "protobuf"),
                "/echoes" => ("sensor_msgs/msg/MultiEchoLaserScan", "cdr"),
                _ => ("sensor_msgs/msg/LaserScan", "cdr"),
            };
            bag.add_schema_with_id(number, name, "ros2msg", b"").unwrap();
            let metadata = BTreeMap::new();
            bag.add_channel_with_id(number, number, message.topic, encoding, &metadata).unwrap();
            number
        });
        let log_time = message.log_time.as_nanos() as u64;
        let header =
            MessageHeader { channel_id: channel, sequence: 0, log_time, publish_time: log_time };
        bag.write_to_known_channel(&header, &message.data).unwrap();
    }
    bag.finish().unwrap();
    std::fs::write(file.path(), bag.into_inner().into_inner()).unwrap();
}

fn windows() -> [Window; 2] {
    [Window::DETECTION, Window::new(100..=400).unwrap()]
}

/// Message of a laser scanner with steps of a quarter of a degree.
fn of_other_laser(tenth: u64) -> Message {
    let mut message = scan(Window::DETECTION, tenth);
    // The increment follows the stamp, the frame and two angles.
    message.data[4 + 8 + 12 + 8..][..4].copy_from_slice(&0.25_f32.to_radians().to_le_bytes());
    message
}

#[test]
fn a_bag_whose_window_changes_is_read_whole() {
    let file = Scratch::mcap("windows");
    let [first, second] = windows();
    let messages = (0..60).map(|tenth| scan(if tenth < 10 { first } else { second }, tenth));
    write(&file, messages);
    let info = run(&format!("info {}", file.path()), 0).stdout;
    let row = "scans          60: 10 of steps 44..=725, 50 of steps 100..=400\n";
    assert!(info.contains(row) && info.contains("left out       none\n"), "{info}");
    assert!(!info.contains("protocol"), "{info}");
    let check = run(&format!("check {}", file.path()), 0).stdout;
    assert!(check.ends_with("\nall is well\n"), "{check}");
    let stream = run(&format!("stream {} --rate max", file.path()), 0);
    assert_eq!(scans(&stream.stdout).len(), 60);
    assert!(!stream.stderr.contains("left out"), "{}", stream.stderr);
}

#[test]
fn messages_that_are_no_scan_are_counted() {
    let file = Scratch::mcap("left-out");
    let mut messages: Vec<Message> = (0..20).map(|tenth| scan(Window::DETECTION, tenth)).collect();
    messages[3].data.truncate(1000);
    messages[7] = of_other_laser(7);
    messages[8] = of_other_laser(8);
    messages[9].data[1] = 9;
    messages[12].topic = "/rear/scan";
    write(&file, messages);
    let laser = "2 scans of another laser scanner (the first: 682 points from -119.53° to 119.88° \
                 every 0.250°)";
    let others = "1 message cut short or malformed (/scan, 1000 bytes); \
                  1 message in another encoding (/scan, CDR header 00 09)";
    let info = run(&format!("info {}", file.path()), 0).stdout;
    let row = format!("left out       {laser}; {others}; 1 scan on another topic (/rear/scan)\n");
    assert!(
        info.contains("scans          15 of steps 44..=725\n") && info.contains(&row),
        "{info}"
    );
    let info = run(&format!("info {} --format json", file.path()), 0).stdout;
    let info: Value = serde_json::from_str(&info).unwrap();
    assert_eq!(info["left_out"][0]["reason"], "other_laser");
    assert_eq!(info["left_out"][0]["messages"], 2);
    let check = run(&format!("check {}", file.path()), 0).stdout;
    assert!(check.contains(&format!("weak    left out {laser}; {others}")), "{check}");
    assert!(check.ends_with("\nit works; weak: left out\n"), "{check}");
    let stream = run(&format!("stream {} --rate max", file.path()), 0);
    assert_eq!(scans(&stream.stdout).len(), 15);
    let notice = format!("urg: {}: left out: {laser}; {others}\n", file.path());
    assert!(stream.stderr.contains(&notice), "{}", stream.stderr);
}

#[test]
fn a_bag_without_a_scan_is_named_for_what_it_is() {
    let file = Scratch::mcap("no-scan");
    write(&file, (0..5).map(of_other_laser));
    for command in ["info", "check", "stream", "scan", "serve"] {
        let line = failure(&format!("{command} {}", file.path()));
        assert!(line.contains("5 scans of another laser scanner"), "{command}: {line}");
    }
    write(&file, (0..5).map(|tenth| Message { topic: "/old/scan", ..scan(windows()[0], tenth) }));
    let line = failure(&format!("info {} --topic /old/scan", file.path()));
    assert!(
        line.contains(
            "5 messages of ROS 1, whose bag `rosbags-convert` converts (the first: /old/scan)"
        ),
        "{line}"
    );
    let line = failure(&format!("info {}", file.path()));
    assert!(line.ends_with("; choose a topic: /old/scan\n"), "{line}");
    write(&file, (0..5).map(|tenth| Message { topic: "/viewed", ..scan(windows()[0], tenth) }));
    let found = "; found /viewed (foxglove.LaserScan): record the scans with `ros2 bag record \
                 --storage mcap`\n";
    for command in ["info", "check", "stream", "scan", "serve"] {
        let line = failure(&format!("{command} {}", file.path()));
        assert!(line.ends_with(found), "{command}: {line}");
    }
    let line = failure(&format!("info {} --topic /viewed", file.path()));
    assert!(
        line.ends_with("; 5 messages of another type (the first: /viewed, foxglove.LaserScan)\n")
    );
    write(&file, (0..5).map(|tenth| Message { topic: "/echoes", ..scan(windows()[0], tenth) }));
    let line = failure(&format!("info {}", file.path()));
    assert!(line.ends_with("laser_proc, and record what that publishes\n"), "{line}");
    // The scans of `/scan` are there to choose.
    write(&file, (0..5).map(|tenth| scan(windows()[0], tenth)));
    for command in ["info", "check", "stream", "scan", "serve"] {
        let line = failure(&format!("{command} {} --topic /other", file.path()));
        let advice = " on the topic /other; choose a topic: /scan\n";
        assert!(line.ends_with(advice), "{command}: {line}");
    }
}

#[test]
fn a_bag_is_streamed_with_its_window_and_pace() {
    let file = Scratch::mcap("pace");
    let (window, pace) = (Window::new(100..=400).unwrap(), Duration::from_millis(10));
    let paced = |n| Message { log_time: pace * n as u32, ..scan(window, n) };
    write(&file, (0..60).map(paced).chain([Message { topic: "/old/scan", ..paced(60) }]));
    let began = Instant::now();
    let streamed = run(&format!("stream {} --format ndjson", file.path()), 0).stdout;
    // At the rate of a sensor, 10 Hz, it would take 6 s.
    assert!(began.elapsed() < Duration::from_secs(5), "{:?}", began.elapsed());
    let scan = run(&format!("scan {} --format json", file.path()), 0).stdout;
    let steps_and_values = |ndjson: &str| {
        let of = |scan: &Value| (scan["start"].clone(), scan["end"].clone(), values(scan));
        formats::scans(ndjson).iter().map(of).collect::<Vec<_>>()
    };
    assert_eq!(
        steps_and_values(&piped(&file, "stream - --format ndjson")),
        steps_and_values(&streamed)
    );
    let scans = scans(&(streamed + &scan));
    assert_eq!(scans.len(), 61);
    for scan in &scans {
        assert_eq!((&scan["start"], &scan["end"]), (&json!(100), &json!(400)));
        assert_eq!(values(scan).len(), window.points());
    }
    // The header has the time of the first ray.
    for (scan, tenth) in scans.iter().zip(0..60) {
        let first_ray = scan["first_ray"].as_f64().unwrap();
        assert!((first_ray - f64::from(tenth) / 10.0).abs() < 1e-5, "{first_ray}: {tenth}");
    }
    let other = run(&format!("stream {} --from -10 --to 10 --rate max", file.path()), 0).stdout;
    assert_ne!(scans[0]["start"], formats::scans(&other)[0]["start"]);
}

/// Runs the program with a bag on its standard input, which cannot be read a second time.
fn piped(file: &Scratch, arguments: &str) -> String {
    let output = output_of(shell(&format!("cat {} | $urg {arguments}", file.path())));
    assert_eq!(output.code, Some(0), "{arguments}: {}", output.stderr);
    output.stdout
}

#[test]
fn a_bag_in_a_pipe_has_the_window_of_its_topic() {
    let file = Scratch::mcap("piped");
    let rear = |n| Message { topic: "/rear/scan", ..scan(windows()[1], n) };
    write(&file, (0..5).flat_map(|n| [scan(windows()[0], n), rear(n)]));
    for (topic, window) in ["/scan", "/rear/scan"].into_iter().zip(windows()) {
        for command in ["stream - --rate max --format ndjson", "scan - --format json"] {
            let text = piped(&file, &format!("{command} --topic {topic}"));
            let scans = scans(&text);
            assert_eq!(scans.len(), if command.starts_with("scan") { 1 } else { 5 }, "{text}");
            for scan in scans {
                assert_eq!(
                    (&scan["start"], &scan["end"]),
                    (&json!(window.start()), &json!(window.end()))
                );
                assert_eq!(values(&scan).len(), window.points());
            }
        }
    }
}

#[test]
fn the_topics_of_a_dds_recorder_are_read() {
    let file = Scratch::mcap("dds");
    write(&file, (0..5).map(|tenth| Message { topic: "rt/scan", ..scan(windows()[0], tenth) }));
    let line = failure(&format!("info {}", file.path()));
    assert!(line.ends_with("; choose a topic: rt/scan\n"), "{line}");
    let info = run(&format!("info {} --topic rt/scan", file.path()), 0).stdout;
    let row = "scans          5 of steps 44..=725\nleft out       none\n";
    assert!(info.contains(row), "{info}");
}

#[test]
fn times_that_do_not_advance_are_weak() {
    let file = Scratch::mcap("times");
    let tenth = |tenth: u64| Duration::from_millis(100 * tenth);
    let check = |stamp: fn(u64) -> u64, log_time: fn(u64) -> u64| {
        write(
            &file,
            (0..20).map(|number| Message {
                log_time: tenth(log_time(number)),
                ..of_frame(Window::DETECTION, "laser", number, tenth(stamp(number)))
            }),
        );
        run(&format!("check {}", file.path()), 0).stdout
    };
    let well = check(|number| 50 + number, |number| number);
    assert!(well.ends_with("\nall is well\n"), "{well}");
    let same = check(|_| 0, |number| number);
    let row = "weak    times    all 20 scans have the same stamp, 1970-01-01 00:00:00 UTC\n";
    assert!(same.contains(row) && same.ends_with("\nit works; weak: times\n"), "{same}");
    let backward = check(|number| 50 - number, |number| number);
    assert!(backward.contains("19 stamps earlier than the one before"), "{backward}");
    let without = check(|number| 100 * number, |_| 0);
    assert!(
        without.contains("times    all 20 scans have the same log time, 1970-01-01"),
        "{without}"
    );
    assert!(without.contains("ok      gaps     not known without log times\n"), "{without}");
    let backward = check(|number| number, |number| 50 - number);
    assert!(backward.contains("19 log times earlier than the one before"), "{backward}");
}

#[test]
fn scans_that_end_before_the_bag_are_weak() {
    let file = Scratch::mcap("ends-early");
    // The last two topics cannot be read.
    for other in ["/rear/scan", "/echoes", "/viewed"] {
        let ends_early = (0..20).map(|tenth| scan(windows()[0], tenth));
        let others = (0..50).map(|tenth| Message { topic: other, ..scan(windows()[0], tenth) });
        let mut messages: Vec<_> = ends_early.chain(others).collect();
        messages.sort_by_key(|message| message.log_time);
        write(&file, messages);
        let check = run(&format!("check {}", file.path()), 0).stdout;
        assert!(check.contains("weak    gaps     3.0 s at 0:01\n"), "{other}: {check}");
        assert!(check.ends_with("\nit works; weak: gaps\n"), "{other}: {check}");
    }
}

/// As of a recorder whose clock was set back by 6 s.
#[test]
fn log_times_that_were_set_back_are_no_gap_at_the_end() {
    let file = Scratch::mcap("set-back");
    write(&file, (0..80).chain(20..40).map(|tenth| scan(windows()[0], tenth)));
    let check = run(&format!("check {}", file.path()), 0).stdout;
    assert!(check.contains("ok      gaps     none\n"), "{check}");
}

#[test]
fn scans_of_several_sensors_are_weak() {
    let file = Scratch::mcap("frames");
    let frame = |number: u64| ["front", "rear"][number as usize % 2];
    let stamp = |number| Duration::from_millis(100 * number);
    let messages =
        (0..20).map(|number| of_frame(Window::DETECTION, frame(number), number, stamp(number)));
    write(&file, messages);
    let check = run(&format!("check {}", file.path()), 0).stdout;
    assert!(check.contains("weak    sources  scans of 2 frames: front, rear\n"), "{check}");
    assert!(check.ends_with("\nit works; weak: sources\n"), "{check}");
}

#[tokio::test(start_paused = true)]
async fn joined_recordings_of_two_sensors_are_weak() {
    let [first, second, both] = ["one", "two", "both"].map(Scratch::mcap);
    for (path, number) in [(&first, "H1"), (&second, "H2")] {
        let mut recorder = Recorder::create(path.path()).unwrap();
        let emulator = Emulator::builder().usb().serial_number(number).build();
        let sensor = Sensor::builder().connect(emulator).await.unwrap();
        let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        recorder.record(&scans.next().await.unwrap()).unwrap();
        recorder.finish().await.unwrap();
    }
    run(&format!("cut {} {} {}", first.path(), second.path(), both.path()), 0);
    let check = run(&format!("check {}", both.path()), 0).stdout;
    assert!(check.contains("weak    sources  scans of 2 sensors: H1, H2\n"), "{check}");
}

#[test]
fn a_part_counts_from_the_topic_of_the_scans() {
    let (file, part) = (Scratch::mcap("front"), Scratch::mcap("front-part"));
    let front = |tenth| Message { topic: "/front/scan", ..scan(windows()[0], tenth) };
    write(&file, (100..130).map(front));
    // Without an error, `..1s` would take everything.
    for range in ["1s..2s", "..1s"] {
        let line = failure(&format!("cut {} {} --range {range}", file.path(), part.path()));
        assert!(line.ends_with(" on the topic /scan; choose a topic: /front/scan\n"), "{line}");
        assert!(!std::fs::exists(part.path()).unwrap());
    }
    let whole = Scratch::mcap("front-whole");
    run(&format!("cut {} {}", file.path(), whole.path()), 0);
    let options = "--range 1s..2s --topic /front/scan";
    let notice = run(&format!("cut {} {} {options}", file.path(), part.path()), 0).stderr;
    assert!(notice.ends_with(": 10 scans\n"), "{notice}");
    let stream = |path: &str, options: &str| {
        let text = run(&format!("stream {path} --rate max {options}"), 0).stdout;
        scans(&text).iter().map(values).collect::<Vec<_>>()
    };
    let copied = stream(part.path(), "--topic /front/scan");
    assert_eq!(copied, stream(whole.path(), options));
    assert_eq!(copied.len(), 10);
}
