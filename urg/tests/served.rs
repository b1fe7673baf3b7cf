//! Two processes: one serves an emulated sensor, the other one uses it.

use std::collections::HashMap;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use tokio_scip::{Sensor, Window};
use urg_emulator::{Emulator, Room, STEPS, Values, World, WorldTime};

use super::formats::{check, event, scans, values};
use super::program::{Emulated, Running, Scratch, run};
use super::web::on_tcp;

/// Argument for an emulated sensor with a fast motor, so that tests are fast.
pub(crate) const FAST: &str = "--revolution 50ms";
const REVOLUTION: Duration = Duration::from_millis(50);

/// Number of scans compared with the sensor's.
pub(crate) const SCANS: usize = 30;

/// Returns the values of steps 44..=725 in each revolution of a [`FAST`] sensor with this seed that
/// `began` before this time, with the number of the revolution.
pub(crate) async fn held(seed: u64, began: Instant) -> HashMap<Vec<u64>, u64> {
    let revolutions = began.elapsed().div_duration_f64(REVOLUTION).ceil() as u32;
    let (sender, receiver) = mpsc::channel();
    let mut room = Room::new(seed);
    let world = move |mut time: WorldTime, codes: &mut Values| {
        for revolution in 0..revolutions {
            let mut codes = [19; STEPS];
            time.revolution = revolution.into();
            time.at = REVOLUTION * (revolution + 1);
            room.measure(time, &mut codes);
            let values = codes[44..=725].iter().map(|&code| code.into()).collect();
            sender.send((values, u64::from(revolution))).unwrap();
        }
        codes.fill(19);
    };
    let sensor = Sensor::builder().connect(Emulator::builder().world(world).build()).await.unwrap();
    sensor.scan(Window::DETECTION).await.unwrap();
    drop(sensor);
    receiver.try_iter().collect()
}

/// Asserts that these are [`SCANS`] scans without a gap, each measured by the sensor, in
/// order.
pub(crate) fn check_held(ndjson: &str, held: &HashMap<Vec<u64>, u64>) {
    let scans = scans(ndjson);
    assert_eq!(scans.len(), SCANS);
    let mut last = None;
    for (number, scan) in scans.iter().enumerate() {
        check(scan);
        assert_eq!(scan["sequence"], number as u64);
        let revolution = held.get(&values(scan)).copied();
        assert!(revolution.is_some(), "scan {number} was not measured by the sensor");
        assert!(revolution > last, "scan {number} is older than the one before");
        last = revolution;
    }
}

fn stream(port: &str) -> String {
    format!("stream {port} --rate max --count {SCANS} --format ndjson")
}

#[tokio::test]
async fn scans_over_a_pseudo_terminal_are_those_of_the_sensor() {
    let link = Scratch::new("pty");
    let sensor = Emulated::start(&format!("--link {} --seed 7 {FAST}", link.path()));
    assert_eq!(sensor.port, link.path());
    let info = run(&format!("info {}", sensor.port), 0).stdout;
    assert!(info.contains("SOKUIKI Sensor URG-04LX"), "{info}");
    let output = run(&stream(&sensor.port), 0);
    assert_eq!(output.stderr, "");
    check_held(&output.stdout, &held(7, sensor.began).await);
}

#[tokio::test]
async fn scans_over_tcp_are_those_of_the_sensor() {
    let sensor = Emulated::start(&format!(
        "--tcp 0 --seed 8 --firmware text --serial-number H1234567 {FAST}"
    ));
    assert!(sensor.port.starts_with("tcp://127.0.0.1:"), "{}", sensor.port);
    let info = run(&format!("info {}", sensor.port), 0).stdout;
    assert!(info.contains("serial number  H1234567"), "{info}");
    assert!(!info.contains("\nstatus"), "the text knows of none: {info}");
    let output = run(&stream(&sensor.port), 0);
    check_held(&output.stdout, &held(8, sensor.began).await);
}

#[tokio::test]
async fn a_sensor_at_19200_baud_serves_at_115200() {
    let link = Scratch::new("faster");
    let sensor = Emulated::start(&format!("--link {} --baud 19200 --seed 9 {FAST}", link.path()));
    let output = run(&format!("{} --baud 115200", stream(&sensor.port)), 0);
    check_held(&output.stdout, &held(9, sensor.began).await);
    // It keeps this baud rate, and is found at it.
    let info = run(&format!("info {}", sensor.port), 0).stdout;
    assert!(info.contains("baud rate      115200 baud"), "{info}");
    let output = run(&format!("baud {} 57600 --timeout 9s", sensor.port), 0);
    assert!(output.stderr.contains("the baud rate is 57600 baud"), "{}", output.stderr);
    let output = run(&format!("stream {} --count 1", sensor.port), 0);
    assert_eq!(scans(&output.stdout).len(), 1);
}

#[test]
fn an_emulated_sensor_names_its_port_alone() {
    let link = Scratch::new("ust");
    let link = link.path();
    for (options, speed) in [("--model ust-10lx", ""), ("--baud 19200", " at 19200 baud")] {
        let mut sensor = Running::start(&format!("emulate {options} --link {link}"));
        let notice = sensor.notice();
        assert_eq!(notice, format!("urg: emulated sensor H0713090{speed}, on {link}"));
        sensor.signal("INT");
        sensor.end();
    }
}

#[test]
fn the_baud_rate_behind_a_bridge_cannot_be_changed() {
    let sensor = Emulated::start("--tcp 0 --baud 57600");
    assert!(sensor.port.ends_with("?baud=57600"), "{}", sensor.port);
    let line = super::program::failure(&format!("baud {} 115200", sensor.port));
    assert!(line.contains("cannot be set to 115200 baud"), "{line}");
    assert_eq!(line.matches("its baud rate is fixed").count(), 1, "{line}");
}

#[test]
fn a_stream_continues_when_the_sensor_returns() {
    let link = Scratch::new("replug");
    let sensor = Emulated::start(&format!("--link {}", link.path()));
    let mut stream = Running::start(&format!("stream {}", link.path()));
    stream.line();
    sensor.running.signal("INT");
    let lost = event("disconnected", || stream.line());
    assert!(lost["error"].as_str().unwrap().contains("lost"), "{lost}");
    let lost = format!("the link to {} is lost", link.path());
    let notice = stream.notice();
    assert!(notice.contains(&lost), "{notice}");
    assert_eq!(notice.matches(link.path()).count(), 1, "{notice}");
    drop(sensor);
    let _sensor = Emulated::start(&format!("--link {}", link.path()));
    assert_eq!(
        event("reconnected", || stream.line()),
        serde_json::json!({ "event": "reconnected" })
    );
    check(&serde_json::from_str(&stream.line()).unwrap());
    stream.signal("INT");
    stream.rest();
    let (status, notices) = stream.end();
    assert_eq!(status.code(), Some(0));
    assert!(notices.iter().any(|line| line.ends_with("the sensor is back")), "{notices:?}");
}

#[test]
fn a_program_that_waits_finds_the_sensor_that_appears() {
    let link = Scratch::new("appears");
    let mut stream = Running::start(&format!("stream {} --wait --count 1", link.path()));
    assert!(stream.notice().contains("waiting"));
    let _sensor = Emulated::start(&format!("--link {}", link.path()));
    check(&serde_json::from_str(&stream.line()).unwrap());
    let (status, _) = stream.end();
    assert_eq!(status.code(), Some(0));
}

#[test]
fn faults_cost_scans_and_never_the_stream() {
    let link = Scratch::new("faults");
    let arguments = format!("--link {} --seed 3 {FAST} --faults damaged=0.2,seed=5", link.path());
    let sensor = Emulated::start(&arguments);
    let output = run(&format!("stream {} --rate max --count 20", sensor.port), 0);
    let lines = scans(&output.stdout);
    let (events, scans): (Vec<_>, Vec<_>) =
        lines.into_iter().partition(|line| line.get("event").is_some());
    assert_eq!(scans.len(), 20);
    scans.iter().for_each(check);
    assert!(events.iter().all(|event| event["error"].is_string()), "{events:?}");
}

#[test]
fn text_from_a_sensor_cannot_control_the_terminal() {
    let (_runtime, port) = on_tcp(Emulator::builder().serial_number("\x1b[31mred").build());
    let info = run(&format!("info {port}"), 0).stdout;
    assert!(info.contains(r"\x1b[31mred"), "{info}");
    assert!(!info.contains('\x1b'), "{info:?}");
}

#[test]
fn a_hard_room_has_more_error_codes() {
    let arguments = "--tcp 0 --room hard --firmware text";
    let sensor = Emulated::start(&format!("{arguments} {FAST}"));
    let scan = scans(&run(&format!("scan {} --format json", sensor.port), 0).stdout).remove(0);
    let missing = values(&scan).iter().filter(|&&value| value < 20).count();
    assert!((300..=450).contains(&missing), "{missing} of 682");
}

#[test]
fn another_model_is_emulated_on_tcp() {
    use std::io::{Read, Write};
    let sensor = Emulated::start("--model ust-10lx --tcp 0 --serial-number H1");
    let address = sensor.port.strip_prefix("tcp://").unwrap();
    let mut client = std::net::TcpStream::connect(address).unwrap();
    client.write_all(b"VV\n").unwrap();
    let mut reply = Vec::new();
    while !reply.ends_with(b"\n\n") {
        let mut byte = [0];
        client.read_exact(&mut byte).unwrap();
        reply.push(byte[0]);
    }
    let reply = String::from_utf8(reply).unwrap();
    assert!(reply.starts_with("VV\n00P\n") && reply.contains("\nPROD:UST-10LX;M\n"), "{reply}");
    assert!(reply.ends_with("\nSERI:H1;V\n\n"), "{reply}");
}
