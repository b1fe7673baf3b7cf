//! The programs in `examples/`, as a user runs them, in real time.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;

use crate::example::{Example, address, get, get_until, request};

#[test]
fn what_was_recorded_is_read_back() {
    let path = std::env::temp_dir().join(format!("scip-example-{}.mcap", std::process::id()));
    let mut example = Example::run("record_and_read", &["emulated", path.to_str().unwrap()]);
    let (live, recorded) = (example.line(), example.line());
    assert!(live.contains(" 20 scans, "), "{live}");
    assert_eq!(live.split_once(' ').unwrap().1.trim(), recorded.split_once(' ').unwrap().1);
    example.end();
    std::fs::remove_file(path).unwrap();
}

/// The client that streams is there before the recording and after it.
#[test]
fn one_sensor_is_served_streamed_and_recorded_at_once() {
    let folder = std::env::temp_dir().join(format!("scip-served-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let arguments = ["emulated", folder.to_str().unwrap(), "127.0.0.1:0"];
    let mut example = Example::run("serve_and_record", &arguments);
    let line = example.line();
    let nearest = address(&line);
    assert!(get_until(nearest, " 200 ").contains("\"nearest\":"));
    let (host, _) = nearest.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let mut client = BufReader::new(TcpStream::connect(host).unwrap());
    write!(client.get_mut(), "GET /scans HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
    let mut scans = client.lines().map(Result::unwrap).filter(|line| line.starts_with("{\"scan"));
    scans.next().unwrap();

    let recording = nearest.replace("nearest", "recording");
    let begun = request("POST", &recording);
    assert!(begun.contains(" 200 "), "{begun}");
    assert!(request("POST", &recording).contains(" 409 "));
    scans.by_ref().take(5).for_each(drop);
    assert!(get(nearest).contains(" 200 "));
    let ended = request("DELETE", &recording);
    assert!(ended.contains(" 200 "), "{ended}");
    let count: usize = ended.trim_end().rsplit(['\n', ' ']).nth(1).unwrap().parse().unwrap();
    scans.next().unwrap();

    let path = begun.trim_end().rsplit('\n').next().unwrap();
    let recorded = urg_recording::Recording::open(path).unwrap().scans();
    let recorded = recorded.filter(Result::is_ok).count();
    // The replies have scans that were on their way to the recorder when it ended.
    assert!(count > 0 && recorded >= count, "{recorded} of {count}");
    std::fs::remove_dir_all(folder).unwrap();
}
