//! The end of the program by a signal, by its options, or by a closed pipe.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};

use super::program::{Emulated, Running, Scratch, run};
use crate::instant_sensor;

#[test]
fn a_signal_ends_a_stream_with_success_and_a_whole_line() {
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
    // When this one has ended, the other one's pipe has long been full.
    let mut other = Running::start("stream emulated --count 20");
    other.rest();
    stream.signal("INT");
    let (status, _) = stream.end();
    assert_eq!(status.code(), Some(0));
}

#[test]
fn a_full_pipe_loses_no_part_of_a_scan() {
    let link = Scratch::new("full");
    let sensor = Emulated::start(&format!("--revolution 10ms --link {}", link.path()));
    let mut stream = Running::start(&format!("stream {} --rate max --count 60", sensor.port));
    // When this one has ended, the other one's pipe has long been full.
    let mut other = Running::start("stream emulated --count 20");
    other.rest();
    for (sequence, line) in stream.rest().iter().enumerate() {
        let scan = serde_json::from_str::<serde_json::Value>(line).unwrap();
        assert_eq!(scan["sequence"], sequence);
        assert_eq!(scan["values"].as_array().unwrap().len(), 682);
    }
    let (status, notices) = stream.end();
    assert_eq!((status.code(), notices), (Some(0), vec![]));
}

/// It would send them to the next program, too.
#[test]
fn the_sensor_sends_no_scans_after_the_end() {
    let sensor = Emulated::start("--model ust-10lx --tcp 0");
    let address = sensor.port.strip_prefix("tcp://").unwrap().to_owned();
    for options in ["", "--count 3"] {
        let mut stream = Running::start(&format!("stream {} {options}", sensor.port));
        if options.is_empty() {
            stream.line();
            stream.signal("INT");
        }
        stream.rest();
        assert_eq!(stream.end().0.code(), Some(0));
        let mut client = TcpStream::connect(&address).unwrap();
        client.write_all(b"%ST\n").unwrap();
        let mut reply = [0; 13];
        client.read_exact(&mut reply).unwrap();
        assert_eq!(String::from_utf8_lossy(&reply), "%ST\n00P\n000@\n", "{options}");
    }
}

#[test]
fn waiting_for_a_sensor_is_announced_and_can_be_interrupted() {
    let missing = Scratch::new("waiting");
    let mut info = Running::start(&format!("info {} --wait", missing.path()));
    assert!(info.notice().starts_with("urg: waiting for a sensor on "));
    info.signal("INT");
    let (status, _) = info.end();
    assert_eq!(status.code(), Some(0));
}

#[test]
fn an_interrupted_setting_is_a_failure() {
    let missing = Scratch::new("interrupted-setting");
    for command in ["scan PORT", "laser PORT off", "baud PORT 115200", "reboot PORT"] {
        let mut running =
            Running::start(&format!("{command} --wait").replace("PORT", missing.path()));
        assert!(running.notice().starts_with("urg: waiting for a sensor on "));
        running.signal("INT");
        let (status, notices) = running.end();
        assert_eq!(status.code(), Some(1), "{command}");
        assert_eq!(notices, ["urg: interrupted before it was done"], "{command}");
    }
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
fn a_signal_ends_an_emulator_and_removes_its_symbolic_link() {
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
fn a_stream_that_ignores_hang_up_outlives_its_terminal() {
    let script = "trap '' HUP; exec $urg stream emulated --count 5";
    let mut stream = Running::spawn(super::program::shell(script));
    stream.read();
    stream.line();
    stream.signal("HUP");
    assert_eq!(stream.rest().len(), 4);
    assert_eq!(stream.end().0.code(), Some(0));
}

/// Serves a sensor on TCP that answers every command but polls, and returns its PORT.
fn sensor_without_scans() -> String {
    sensor_that_announces_polls().0
}

/// Does the same, and announces each poll.
fn sensor_that_announces_polls() -> (String, Receiver<()>) {
    let (polled, polls) = channel();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let commands = BufReader::new(stream.try_clone().unwrap()).split(b'\n');
        for command in commands.map_while(Result::ok).filter(|command| !command.is_empty()) {
            let is_poll = command.starts_with(b"G") && command[1..4] != command[4..7];
            if is_poll {
                let _ = polled.send(());
            } else {
                let mut reply = Vec::new();
                instant_sensor::reply(&command, &mut reply);
                stream.write_all(&reply).unwrap();
            }
        }
    });
    (port, polls)
}

#[test]
fn an_interrupt_before_a_scan_can_arrive_is_no_failure() {
    let (port, polls) = sensor_that_announces_polls();
    let stream = Running::start(&format!("stream {port}"));
    polls.recv().unwrap();
    stream.signal("INT");
    let (status, notices) = stream.end();
    assert_eq!(status.code(), Some(0), "{notices:?}");
}

#[test]
fn no_scan_is_an_explained_failure() {
    let stream = run(&format!("stream {} --duration 3s", sensor_without_scans()), 1);
    let reason = stream.stderr.lines().last().unwrap();
    assert!(reason.contains("no scan in 3."), "{}", stream.stderr);
    assert!(reason.contains("did not answer"), "{}", stream.stderr);
}

#[test]
fn a_recording_without_a_scan_is_a_failure() {
    let file = Scratch::mcap("no-scan");
    let port = sensor_without_scans();
    let record = run(&format!("record {port} {} --duration 3s", file.path()), 1);
    let lines: Vec<_> = record.stderr.lines().rev().take(2).collect();
    assert!(lines[0].contains("no scan in 3."), "{}", record.stderr);
    assert!(lines[1].contains(": 0 scans in 0:03, "), "{}", record.stderr);
}

#[test]
fn an_interrupt_without_a_scan_is_a_failure() {
    let file = Scratch::mcap("interrupted-no-scan");
    let record = format!("record {} {}", sensor_without_scans(), file.path());
    let stream = format!("stream {}", sensor_without_scans());
    let start = |command: &String| Running::start(command);
    for mut running in [record, stream].iter().map(start) {
        assert!(running.notice().contains("reported once"));
        running.signal("INT");
        let (status, notices) = running.end();
        assert_eq!(status.code(), Some(1), "{notices:?}");
        let reason = notices.last().unwrap();
        assert!(reason.contains("no scan in ") && reason.contains("did not answer"), "{notices:?}");
    }
}
