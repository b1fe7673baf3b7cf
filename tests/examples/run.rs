//! Each program in `examples/` runs on emulated sensors, in real time, and prints or serves
//! what it promises.

use std::process::Command;

use super::example::{Example, address, get, get_until};

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
