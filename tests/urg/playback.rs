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
