//! The playback of a recording, on the page and in the terminal.

use std::io::Cursor;

use serde_json::Value;
use tokio_scip::{BaudRate, Rate, Sensor, Window};
use urg_emulator::{Emulator, Firmware, Mode};
use urg_recording::{Recorder, Recording};

use super::formats::values;
use super::program::{Scratch, run};
use super::recorded::recording;
use super::web::Served;

/// A scan at 19,200 baud takes longer than the replay lets a poll wait.
#[tokio::test(start_paused = true)]
async fn a_slow_line_is_played_without_errors() {
    let file = Scratch::mcap("slow-line");
    let emulator = Emulator::builder().baud_rate(BaudRate::B19200).mode(Mode::Scip2);
    let emulator = emulator.firmware(Firmware::V31).build();
    let sensor = Sensor::builder().connect(emulator).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut recorder = Recorder::create(file.path()).unwrap();
    recorder.describe(&sensor, &scans).await.unwrap();
    while recorder.progress().scans < 2 {
        recorder.record(&scans.next().await.unwrap()).unwrap();
    }
    recorder.finish().await.unwrap();
    let played = run(&format!("stream {}", file.path()), 0);
    assert_eq!(played.stdout.lines().count(), 2, "{}", played.stdout);
    assert_eq!(played.stderr.lines().count(), 1, "{}", played.stderr);
}

/// Lines of the page's scans.
struct Lines(super::http::HttpResponse);

impl Lines {
    fn next(&mut self) -> Value {
        serde_json::from_str(&self.0.line().unwrap()).unwrap()
    }

    /// Returns the next scan that `is_it`.
    fn scan(&mut self, is_it: impl Fn(u64) -> bool) -> Value {
        loop {
            let line = self.next();
            if line["event"].is_null() && is_it(line["sequence"].as_u64().unwrap()) {
                return line;
            }
        }
    }

    /// Returns the next status of the playback that has this.
    fn status(&mut self, name: &str, value: impl Into<Value>) -> Value {
        let value = value.into();
        loop {
            let mut line = self.next();
            if line["event"] == "playback" && line["playback"][name] == value {
                return line["playback"].take();
            }
        }
    }
}

fn post(served: &Served, command: &str) -> u16 {
    served.client().post(&format!("/playback?{command}"), "").status
}

#[tokio::test(start_paused = true)]
async fn a_recording_on_the_page_obeys_its_controls() {
    let file = Scratch::mcap("played");
    let recorded = recording(file.path(), Window::DETECTION, 30).await;
    let served = Served::start(file.path());
    let mut lines = Lines(served.get("/scans"));
    let first = lines.status("paused", false);
    assert_eq!((&first["scans"], &first["speed"]), (&30.into(), &1.0.into()));
    assert_eq!(served.health(200)["sensors"][0]["link"], "recording");
    assert_eq!(served.state()["sensor"]["serial_number"], "H0713090");

    assert_eq!(post(&served, "pause"), 204);
    lines.status("paused", true);
    assert_eq!(post(&served, "scan=10"), 204);
    let scan = lines.scan(|sequence| sequence == 10);
    assert_eq!(values(&scan), recorded[10]);
    assert!((scan["position"].as_f64().unwrap() - 1.0).abs() < 0.1, "{scan}");
    for (command, sequence) in [("step=1", 11), ("step=-2", 9), ("seek=2", 20), ("by=-1", 10)] {
        assert_eq!(post(&served, command), 204);
        let is_near = |found: u64| found.abs_diff(sequence) <= 1;
        let scan = lines.scan(is_near);
        let found = scan["sequence"].as_u64().unwrap() as usize;
        assert_eq!(values(&scan), recorded[found], "{command}");
    }
    let playback = &served.state()["playback"];
    assert!(playback["paused"] == true && playback["ended"] == false, "{playback}");

    // The last one stays, and the page is still there.
    assert_eq!(post(&served, "speed=100"), 204);
    assert_eq!(post(&served, "play"), 204);
    lines.scan(|sequence| sequence == 29);
    let playback = &served.state()["playback"];
    assert!(playback["ended"] == true && playback["speed"] == 100.0, "{playback}");
    assert_eq!(served.get("/").status, 200);
    assert_eq!(post(&served, "loop=true"), 204);
    lines.scan(|sequence| sequence < 29);
    #[cfg(unix)]
    {
        served.running.signal("INT");
        assert_eq!(served.running.end().0.code(), Some(0));
    }
}

#[tokio::test(start_paused = true)]
async fn a_part_of_a_recording_is_played_through_another_window() {
    let file = Scratch::mcap("window");
    let recorded = recording(file.path(), Window::DETECTION, 30).await;
    let served = Served::start(&format!("{} --range 1s..2s --window 100..200 --loop", file.path()));
    let scan = Lines(served.get("/scans")).scan(|_| true);
    assert_eq!((&scan["start"], &scan["end"]), (&100.into(), &200.into()));
    let seen = values(&scan);
    let at = recorded.iter().position(|scan| scan[56..=156] == seen).unwrap();
    assert!((9..=21).contains(&at), "{at}");
    let scans = served.state()["playback"]["scans"].as_u64().unwrap();
    assert!((9..=11).contains(&scans), "{scans}");
}

#[tokio::test(start_paused = true)]
async fn foreign_and_senseless_commands_are_refused() {
    let file = Scratch::mcap("refused");
    recording(file.path(), Window::DETECTION, 5).await;
    let served = Served::start(file.path());
    for command in
        ["", "rewind", "pause=1", "step=", "scan=-1", "seek=nan", "speed=0", "speed=101", "loop=2"]
    {
        assert_eq!(post(&served, command), 400, "{command}");
    }
    assert_eq!(served.get("/playback?pause").status, 405);
    let of_page = |origin: &str| {
        let origin = format!("Origin: {origin}\r\n");
        served.client().post("/playback?pause", &origin).status
    };
    for origin in ["null", "", "http://evil.example", "http://127.0.0.1:80"] {
        assert_eq!(of_page(origin), 403, "{origin}");
    }
    assert_eq!(served.state()["playback"]["paused"], false);
    assert_eq!(of_page(&format!("http://{}", served.address)), 204);
    let live = Served::start("emulated");
    assert_eq!(post(&live, "pause"), 409);
    let line = run(&format!("serve {} --rate 5", file.path()), 2).stderr;
    assert!(line.contains("--speed 2"), "{line}");
}

/// A file whose log times run back, as others may write it, and one that is overwritten.
#[tokio::test(start_paused = true)]
async fn a_dead_playback_fails_everywhere() {
    let file = Scratch::mcap("dead");
    recording(file.path(), Window::DETECTION, 600).await;
    // The last scan's reply and message at the time of the first scan.
    with_times(file.path(), |messages| {
        let is_scan = |message: &&mcap::Message<'_>| message.channel.topic == "/scan";
        let first = messages.iter().find(is_scan).unwrap().log_time;
        messages.iter_mut().rev().take(2).for_each(|message| message.log_time = first);
    });
    let served = Served::start(&format!("{} --loop --speed 100", file.path()));
    let mut lines = Lines(served.get("/scans"));
    lines.scan(|sequence| sequence > 500);
    lines.scan(|sequence| sequence < 100);
    served.health(200);
    // Overwritten: the playback cannot continue.
    let bytes = std::fs::read(file.path()).unwrap();
    std::fs::write(file.path(), &bytes[..2000]).unwrap();
    let (status, notices) = served.running.end();
    assert_eq!(status.code(), Some(1), "{notices:?}");
    assert!(notices.iter().any(|line| line.contains("the file was changed")), "{notices:?}");
}

/// The other source keeps the page there.
#[tokio::test(start_paused = true)]
async fn a_dead_playback_fails_page_and_health() {
    let file = Scratch::mcap("dead-beside");
    recording(file.path(), Window::DETECTION, 600).await;
    let arguments = format!("dead={} live=emulated --loop --speed 100", file.path());
    let served = Served::start(&arguments);
    Lines(served.get("/scans")).scan(|_| true);
    let health = served.health(200);
    assert_eq!(health["sensors"][0]["link"], "recording");

    let bytes = std::fs::read(file.path()).unwrap();
    std::fs::write(file.path(), &bytes[..2000]).unwrap();
    let health = served.health(503);
    let (dead, live) = (&health["sensors"][0], &health["sensors"][1]);
    assert_eq!((&dead["status"], &dead["link"]), (&"failing".into(), &"closed".into()));
    assert!(dead["why"].as_str().unwrap().contains("the file was changed"), "{health}");
    assert_eq!(live["status"], "ok", "{health}");
    // The page says of a playback that has a reason that it failed (tests/browser.sh).
    let state = served.state();
    assert!(state["playback"].is_object(), "{state}");
    assert_eq!(state["why"], dead["why"]);
}

/// As on a computer without a clock of its own, once it has asked for the time.
#[tokio::test(start_paused = true)]
async fn setting_the_clock_keeps_a_recordings_length() {
    let file = Scratch::mcap("clock");
    recording(file.path(), Window::DETECTION, 100).await;
    with_times(file.path(), |messages| {
        // The time is between two polls, so that a reply and its scan have the same stamp.
        let at = |place: usize| messages[place].log_time + 50_000_000;
        let (half, most) = (at(messages.len() / 2), at(messages.len() * 4 / 5));
        for message in messages.iter_mut().filter(|message| message.log_time > half) {
            let hours = if message.log_time < most { 72 } else { 1 };
            message.publish_time += hours * 3600 * 1_000_000_000;
        }
    });
    let info = run(&format!("info {}", file.path()), 0).stdout;
    assert!(info.contains(", for 0:09\n") && info.contains("gaps           none\n"), "{info}");
    // By 72 hours, less a period: the wall clock did not pause.
    assert!(info.contains("set forward by 71:59:59 at 0:0"), "{info}");
    assert!(info.contains(", set back by 71:00:00 at 0:0"), "{info}");
    let part = run(&format!("stream {} --range 7s..8s --rate max", file.path()), 0).stdout;
    assert!((9..=11).contains(&part.lines().count()), "{}", part.lines().count());
}

/// Writes a recording again after `change` has changed the times of its messages.
fn with_times(path: &str, change: impl FnOnce(&mut [mcap::Message<'_>])) {
    let bytes = std::fs::read(path).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap();
    let mut messages: Vec<_> = messages.map(Result::unwrap).collect();
    change(&mut messages);
    let options = mcap::WriteOptions::new().compression(None).chunk_size(Some(50_000));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let metadata = Recording::open(path).unwrap().metadata().clone();
    let metadata = mcap::records::Metadata { name: "tokio_scip".to_owned(), metadata };
    writer.write_metadata(&metadata).unwrap();
    messages.iter().for_each(|message| writer.write(message).unwrap());
    writer.finish().unwrap();
    std::fs::write(path, writer.into_inner().into_inner()).unwrap();
}
