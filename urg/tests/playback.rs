//! The playback of a recording, on the page and in the terminal.

use serde_json::Value;
use tokio_scip::Window;

use super::formats::values;
use super::program::{Scratch, run};
use super::recorded::recording;
use super::web::Served;

/// The lines of the page's scans.
struct Lines(super::http::Response);

impl Lines {
    fn next(&mut self) -> Value {
        serde_json::from_str(&self.0.line().unwrap()).unwrap()
    }

    /// The next scan that `is_it`.
    fn scan(&mut self, is_it: impl Fn(u64) -> bool) -> Value {
        loop {
            let line = self.next();
            if line["event"].is_null() && is_it(line["sequence"].as_u64().unwrap()) {
                return line;
            }
        }
    }

    /// The next status of the playback that has this.
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
async fn a_recording_on_the_page_can_be_paused_stepped_searched_and_looped() {
    let file = Scratch::with_extension("played", ".mcap");
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
    assert_eq!(served.state()["playback"]["ended"], true);
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
    let file = Scratch::with_extension("window", ".mcap");
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
async fn commands_that_make_no_sense_and_those_of_other_sites_are_refused() {
    let file = Scratch::with_extension("refused", ".mcap");
    recording(file.path(), Window::DETECTION, 5).await;
    let served = Served::start(file.path());
    assert_eq!(post(&served, "rewind"), 400);
    assert_eq!(served.get("/playback?pause").status, 405);
    let origin = "Origin: http://evil.example\r\n";
    assert_eq!(served.client().post("/playback?pause", origin).status, 403);
    assert_eq!(served.state()["playback"]["paused"], false);
    let live = Served::start("emulated");
    assert_eq!(post(&live, "pause"), 409);
    let line = run(&format!("serve {} --rate 5", file.path()), 2).stderr;
    assert!(line.contains("--speed 2"), "{line}");
}

/// A file whose log times run back, as others may write it, and one that is overwritten.
#[tokio::test(start_paused = true)]
async fn times_that_run_back_are_played_and_a_dead_playback_is_a_failure_everywhere() {
    let file = Scratch::with_extension("dead", ".mcap");
    recording(file.path(), Window::DETECTION, 600).await;
    let mut bytes = std::fs::read(file.path()).unwrap();
    // The last scan's reply and message at the time of the first scan; no chunk has a checksum.
    let messages = mcap_places(&bytes);
    let first = messages.iter().find(|(channel, ..)| *channel == 0).unwrap().1;
    let (at, last) = (messages.len() - 2, messages.len());
    for (_, _, place) in &messages[at..last] {
        bytes[*place..place + 8].copy_from_slice(&first.to_le_bytes());
    }
    for place in chunk_places(&bytes) {
        bytes[place + 9 + 24..place + 9 + 28].fill(0);
    }
    std::fs::write(file.path(), &bytes).unwrap();
    let served = Served::start(&format!("{} --loop --speed 100", file.path()));
    let mut lines = Lines(served.get("/scans"));
    lines.scan(|sequence| sequence > 500);
    lines.scan(|sequence| sequence < 100);
    served.health(200);
    // Overwritten: the playback cannot continue.
    std::fs::write(file.path(), &bytes[..2000]).unwrap();
    let (status, notices) = served.running.end();
    assert_eq!(status.code(), Some(1), "{notices:?}");
    assert!(notices.iter().any(|line| line.contains("the file was changed")), "{notices:?}");
}

/// The other source keeps the page there.
#[tokio::test(start_paused = true)]
async fn a_dead_playback_beside_another_source_is_on_the_page_and_in_the_health() {
    let file = Scratch::with_extension("dead-beside", ".mcap");
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
async fn a_clock_that_was_set_changes_neither_the_length_of_a_recording_nor_its_parts() {
    let file = Scratch::with_extension("clock", ".mcap");
    recording(file.path(), Window::DETECTION, 100).await;
    let mut bytes = std::fs::read(file.path()).unwrap();
    let messages = mcap_places(&bytes);
    for (_, _, place) in &messages[messages.len() / 2..] {
        let stamp = *place + 8..*place + 16;
        let set = u64::from_le_bytes(bytes[stamp.clone()].try_into().unwrap());
        let set = set + 72 * 3600 * 1_000_000_000;
        bytes[stamp].copy_from_slice(&set.to_le_bytes());
    }
    for place in chunk_places(&bytes) {
        bytes[place + 9 + 24..place + 9 + 28].fill(0);
    }
    std::fs::write(file.path(), &bytes).unwrap();
    let info = run(&format!("info {}", file.path()), 0).stdout;
    assert!(info.contains(", for 0:09\n") && info.contains("gaps           none\n"), "{info}");
    // By 72 hours, less a period: the wall clock did not pause.
    assert!(info.contains("set forward by 71:59:59 at 0:0"), "{info}");
    let part = run(&format!("stream {} --range 7s..8s --rate max", file.path()), 0).stdout;
    assert!((9..=11).contains(&part.lines().count()), "{}", part.lines().count());
}

/// Returns the records of a file up to its index, those in chunks included: kind, place.
fn record_places(bytes: &[u8]) -> Vec<(u8, usize)> {
    let (mut at, mut places) = (8, Vec::new());
    while bytes[at] != 0x0f {
        places.push((bytes[at], at));
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        at += if bytes[at] == 0x06 { 9 + 40 } else { 9 + length };
    }
    places
}

fn chunk_places(bytes: &[u8]) -> Vec<usize> {
    record_places(bytes).into_iter().filter(|(kind, _)| *kind == 0x06).map(|(_, at)| at).collect()
}

/// Returns the messages: their channel, their log time, and the place of that.
fn mcap_places(bytes: &[u8]) -> Vec<(u16, u64, usize)> {
    let messages = record_places(bytes).into_iter().filter(|(kind, _)| *kind == 0x05);
    let message = |(_, at): (u8, usize)| {
        let channel = u16::from_le_bytes(bytes[at + 9..at + 11].try_into().unwrap());
        let time = at + 15;
        (channel, u64::from_le_bytes(bytes[time..time + 8].try_into().unwrap()), time)
    };
    messages.map(message).collect()
}
