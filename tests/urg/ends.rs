//! How the program ends when it is told to, or when nobody reads it any more.

use super::program::{Emulated, Running, Scratch, shell};

#[test]
fn a_stream_that_is_told_to_end_is_done_and_ends_with_a_whole_line() {
    let start = |signal| (signal, Running::start("stream emulated"));
    for (signal, mut stream) in ["INT", "TERM", "HUP"].map(start) {
        stream.line();
        stream.signal(signal);
        for line in stream.rest() {
            serde_json::from_str::<serde_json::Value>(&line).unwrap();
        }
        let (status, notices) = stream.end();
        assert_eq!((status.code(), notices), (Some(0), vec![]), "{signal}");
    }
}

#[test]
fn a_closed_pipe_ends_a_stream_quietly() {
    let start = |format| (format, Running::start(&format!("stream emulated --format {format}")));
    for (format, mut stream) in ["ndjson", "csv"].map(start) {
        stream.line();
        stream.close_pipe();
        let (status, notices) = stream.end();
        assert_eq!((status.code(), notices), (Some(0), vec![]), "{format}");
    }
    let mut list = Running::start_unread("scan emulated");
    list.close_pipe();
    let (status, notices) = list.end();
    assert_eq!((status.code(), notices), (Some(0), vec![]));
}

#[test]
fn a_stream_that_nobody_reads_can_be_interrupted() {
    let link = Scratch::new("unread");
    let sensor = Emulated::start(&format!("--revolution 10ms --link {}", link.path()));
    let stream = Running::start_unread(&format!("stream {} --rate max", sensor.port));
    // By the time that this one is done, the other's pipe has long been full.
    let mut other = Running::start("stream emulated --count 20");
    other.rest();
    stream.signal("INT");
    let (status, _) = stream.end();
    assert_eq!(status.code(), Some(0));
}

#[test]
fn waiting_for_a_sensor_says_so_and_can_be_interrupted() {
    let missing = Scratch::new("waiting");
    let mut info = Running::start(&format!("info {} --wait", missing.path()));
    assert!(info.notice().starts_with("urg: waiting for a sensor on "));
    info.signal("INT");
    let (status, _) = info.end();
    assert_eq!(status.code(), Some(0));
}

#[test]
fn a_stream_ends_after_its_duration() {
    let mut stream = Running::start("stream emulated --duration 500ms");
    let lines = stream.rest().len();
    assert!((1..=6).contains(&lines), "{lines} scans in half a second");
    let (status, notices) = stream.end();
    assert_eq!((status.code(), notices), (Some(0), vec![]));
}

#[test]
fn an_emulator_that_is_told_to_end_takes_its_link_along() {
    for signal in ["INT", "TERM", "HUP"] {
        let link = Scratch::new("gone");
        let sensor = Emulated::start(&format!("--link {}", link.path()));
        assert!(std::fs::symlink_metadata(link.path()).is_ok());
        sensor.running.signal(signal);
        let (status, _) = sensor.running.end();
        assert_eq!(status.code(), Some(0), "{signal}");
        assert!(std::fs::symlink_metadata(link.path()).is_err(), "{signal}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_stream_that_is_to_outlive_its_terminal_does_so() {
    let mut stream = Running::spawn(shell("trap '' HUP; exec $urg stream emulated --count 5"));
    stream.read();
    stream.line();
    stream.signal("HUP");
    assert_eq!(stream.rest().len(), 4);
    assert_eq!(stream.end().0.code(), Some(0));
}
