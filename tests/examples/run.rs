//! Each program in `examples/` runs on emulated sensors, in real time, and prints or serves
//! what it promises.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStdout, Command, Stdio};

use crate::common::limit::limit;

/// An example that runs, and is killed when it is dropped.
struct Example {
    child: Child,
    lines: BufReader<ChildStdout>,
}

impl Example {
    fn run(name: &str, arguments: &[&str]) -> Self {
        limit();
        // `cargo test` builds them before it runs tests, into the folder beside theirs.
        let tests = std::env::current_exe().unwrap();
        let examples = tests.parent().unwrap().parent().unwrap().join("examples");
        let mut command = Command::new(examples.join(name));
        let child = command.args(arguments).stdout(Stdio::piped()).spawn();
        // `cargo test --test it` does not build them.
        let mut child = child.expect("run `cargo build --examples --features mcap` first");
        let lines = BufReader::new(child.stdout.take().unwrap());
        Self { child, lines }
    }

    /// Returns the next line of its output.
    fn line(&mut self) -> String {
        let mut line = String::new();
        assert!(self.lines.read_line(&mut line).unwrap() > 0, "no more lines");
        line.trim_end().to_owned()
    }

    /// Returns the first line that contains `text`.
    fn line_with(&mut self, text: &str) -> String {
        std::iter::repeat_with(|| self.line()).find(|line| line.contains(text)).unwrap()
    }

    /// Waits for its end with success.
    fn end(mut self) {
        assert!(self.child.wait().unwrap().success());
    }
}

impl Drop for Example {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the answer to a `GET` of an address such as `http://127.0.0.1:8081/nearest`, head
/// and body.
fn get(url: &str) -> String {
    request("GET", url)
}

/// Returns the answer to a request.
fn request(method: &str, url: &str) -> String {
    let (host, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let mut client = TcpStream::connect(host).unwrap();
    write!(client, "{method} /{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")
        .unwrap();
    let mut answer = String::new();
    client.read_to_string(&mut answer).unwrap();
    answer
}

/// Asks until the answer contains `text`: the service may be waiting for its first scan.
fn get_until(url: &str, text: &str) -> String {
    std::iter::repeat_with(|| get(url)).find(|answer| answer.contains(text)).unwrap()
}

/// Returns the address at the end of a line.
fn address(line: &str) -> &str {
    line.rsplit(' ').next().unwrap()
}

#[test]
fn the_first_program_prints_a_line_for_each_scan() {
    let mut example = Example::run("first_scans", &["emulated"]);
    assert_eq!(example.line(), "SOKUIKI Sensor URG-04LX");
    for number in 0..3 {
        let line = example.line();
        assert!(line.starts_with(&format!("scan {number}: 6")), "{line}");
    }
}

#[test]
fn the_nearest_obstacle_and_health_are_served() {
    let mut example = Example::run("nearest_over_http", &["emulated", "127.0.0.1:0"]);
    let line = example.line();
    let nearest = get_until(address(&line), " 200 ");
    assert!(nearest.contains("\"range\":") && nearest.contains("\"angle\":"), "{nearest}");
    let health = get(&address(&line).replace("nearest", "health"));
    assert!(health.contains(" 200 ") && health.ends_with("ok\n"), "{health}");
}

#[test]
fn sensors_are_merged_into_one_cloud() {
    let mut example = Example::run("merged", &["emulated@0.2,0,0", "emulated@-0.2,0,180"]);
    let line = example.line_with("2 of 2 sensors, ");
    let points: usize = address(line.strip_suffix(" points").unwrap()).parse().unwrap();
    assert!(points > 1000, "{points}");
}

#[test]
fn the_safety_stop_begins_with_a_stop_and_drives_in_a_clear_room() {
    let mut example = Example::run("safety_stop", &["emulated"]);
    assert_eq!(example.line(), "stops within 650ms of an obstacle, 500ms after the last good scan");
    assert_eq!([example.line(), example.line()], ["stop", "drive"]);
}

#[cfg(feature = "mcap")]
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
#[cfg(feature = "mcap")]
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
    let recorded = tokio_scip::recording::Recording::open(path).unwrap().scans();
    let recorded = recorded.filter(Result::is_ok).count();
    // The replies have scans that were on their way to the recorder when it ended.
    assert!(count > 0 && recorded >= count, "{recorded} of {count}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn metrics_are_served_as_prometheus_reads_them() {
    let mut example = Example::run("metrics", &["emulated", "127.0.0.1:0"]);
    let line = example.line();
    let scans = |answer: &str| {
        let line = answer.lines().find(|line| line.starts_with("urg_scans"));
        line.map_or(0.0, |line| address(line).parse().unwrap())
    };
    let answers = std::iter::repeat_with(|| get(address(&line)));
    let answer = { answers }.find(|answer| scans(answer) > 2.0).unwrap();
    assert!(answer.contains(" 200 "), "{answer}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_and_sigterm_switch_the_laser_off_and_free_the_port() {
    for signal in ["INT", "TERM"] {
        let mut example = Example::run("graceful_shutdown", &["emulated"]);
        example.line_with("scan 2");
        let process = example.child.id().to_string();
        assert!(Command::new("kill").args(["-s", signal, &process]).status().unwrap().success());
        example.line_with("the laser is off, and the port is free");
        example.end();
    }
}

#[test]
fn scans_come_over_a_transport_of_ones_own() {
    let mut example = Example::run("own_transport", &["emulated"]);
    example.line_with("scan 2: 6");
}

#[test]
fn a_fleet_of_a_hundred_sensors_keeps_its_rate() {
    let mut example = Example::run("fleet", &["emulated", "100"]);
    let scans = |line: String| -> u64 { line.split(' ').nth(2).unwrap().parse().unwrap() };
    // Ten a second each; fewer if the machine is busy.
    let line = std::iter::repeat_with(|| example.line_with("100 sensors, ")).map(scans);
    assert!({ line }.any(|scans| scans > 500));
}

#[test]
fn people_at_a_door_are_counted() {
    let mut example = Example::run("count_people", &["emulated"]);
    assert_eq!(example.line(), "emulated: 0 people");
}

#[test]
fn the_nearest_object_is_sent_as_osc() {
    let receiver = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let target = receiver.local_addr().unwrap().to_string();
    let _example = Example::run("osc", &["emulated", &target]);
    let mut packet = [0; 64];
    assert_eq!(receiver.recv(&mut packet).unwrap(), 28);
    assert!(packet.starts_with(b"/urg/nearest\0\0\0\0,ff\0"));
}
