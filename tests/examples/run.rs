//! Each program in `examples/` runs on emulated sensors, in real time, and prints or serves
//! what it promises.

use std::process::Command;
use std::thread;

use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use urg_emulator::{Emulator, Model};

use super::example::{Example, address, get, get_until};
use super::tuio::Frame;

/// Tests a program with the sensor that it emulates, and at once with each model over TCP, named by
/// its port and model.
fn with_each_sensor(test: impl Fn(&str, &str) + Sync) {
    let runtime = Runtime::new().unwrap();
    let test = &test;
    thread::scope(|scope| {
        scope.spawn(|| test("emulated", "URG-04LX"));
        for (model, name) in [
            (Model::Urg04lx, "URG-04LX"),
            (Model::Urg04lxUg01, "URG-04LX-UG01"),
            (Model::Utm30lx, "UTM-30LX"),
            (Model::Ust10lx, "UST-10LX"),
        ] {
            let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
            let port = format!("tcp://{}", listener.local_addr().unwrap());
            runtime.spawn(async move {
                let emulator = Emulator::builder().model(model).build();
                while let Ok((client, _)) = listener.accept().await {
                    let _ = emulator.serve(client).await; // ends with the test
                }
            });
            scope.spawn(move || test(&port, name));
        }
    });
}

#[test]
fn the_first_program_prints_a_line_for_each_scan() {
    with_each_sensor(|port, model| {
        let mut example = Example::run("first_scans", &[port]);
        assert!(example.line().contains(model));
        for number in 0..3 {
            let line = example.line();
            assert!(line.starts_with(&format!("scan {number}: ")), "{line}");
        }
    });
}

#[test]
fn the_nearest_obstacle_and_health_are_served() {
    with_each_sensor(|port, _| {
        let mut example = Example::run("nearest_over_http", &[port, "127.0.0.1:0"]);
        let line = example.line();
        let nearest = get_until(address(&line), " 200 ");
        assert!(nearest.contains("\"range\":") && nearest.contains("\"angle\":"), "{nearest}");
        let health = get(&address(&line).replace("nearest", "health"));
        assert!(health.contains(" 200 ") && health.ends_with("ok\n"), "{health}");
    });
}

/// A port that no machine has.
const ABSENT: &str = "/dev/urg-absent";

#[test]
fn the_sensors_that_are_there_are_merged() {
    let absent = format!("{ABSENT}@0,0,0");
    with_each_sensor(|port, _| {
        let ports = [&format!("{port}@0.2,0,0"), &absent, "emulated@-0.2,0,180"];
        let line = Example::run("merged", &ports).line_with("2 of 3 sensors, ");
        let (cloud, waiting) = line.split_once(" points; ").unwrap();
        let points: usize = address(cloud).parse().unwrap();
        assert!(points > 1000, "{points}");
        assert!(waiting.starts_with(&format!("{ABSENT}: ")), "{waiting}");
    });
}

#[test]
fn the_safety_stop_drives_in_a_clear_room() {
    with_each_sensor(|port, _| {
        let mut example = Example::run("safety_stop", &[port]);
        assert_eq!(example.line(), "stops within 650ms of an obstacle in 0.60 m");
        assert_eq!(example.line(), "Stop");
        example.line_with("Drive");
    });
}

#[test]
fn metrics_are_served_as_prometheus_reads_them() {
    with_each_sensor(|port, _| {
        let mut example = Example::run("metrics", &["127.0.0.1:0", port, ABSENT]);
        let line = example.line();
        let scans = |answer: &str| {
            let prefix = format!("urg_scans_total{{sensor=\"{port}\"}} ");
            let line = answer.lines().find(|line| line.starts_with(&prefix));
            line.map_or(0.0, |line| address(line).parse().unwrap())
        };
        let answers = std::iter::repeat_with(|| get(address(&line)));
        let answer = { answers }.find(|answer| scans(answer) > 2.0).unwrap();
        assert!(answer.contains(" 200 "), "{answer}");
        assert!(
            answer.contains(&format!("urg_scans_total{{sensor=\"{ABSENT}\"}} 0\n")),
            "{answer}"
        );
        assert!(
            answer.contains(&format!("urg_timeouts_total{{sensor=\"{port}\"}} 0\n")),
            "{answer}"
        );
        assert_eq!(answer.matches("# TYPE urg_scans_total counter\n").count(), 1, "{answer}");
    });
}

/// Returns the messages that a program sends to systemd.
#[cfg(unix)]
fn notified(port: &str) -> impl Iterator<Item = String> {
    let path =
        std::env::temp_dir().join(format!("urg-{}-{}", std::process::id(), port.replace('/', "")));
    let _ = std::fs::remove_file(&path);
    let systemd = std::os::unix::net::UnixDatagram::bind(&path).unwrap();
    let example = Example::run_with("watchdog", &[port], &[("NOTIFY_SOCKET", path.as_os_str())]);
    std::iter::repeat_with(move || {
        let (_running, mut message) = (&example, [0; 4096]);
        let length = systemd.recv(&mut message).unwrap();
        String::from_utf8(message[..length].to_vec()).unwrap()
    })
}

#[cfg(unix)]
#[test]
fn fresh_scans_feed_the_watchdog() {
    let fed = "WATCHDOG=1\nSTATUS=scans are fresh\n";
    with_each_sensor(|port, _| {
        let mut messages = notified(port);
        assert_eq!(messages.next().unwrap(), "READY=1\n");
        assert!(messages.any(|message| message == fed));
    });
    for message in notified(ABSENT).skip(1).take(3) {
        assert!(message.starts_with("STATUS=expected a scan"), "{message}");
    }
}

#[cfg(unix)]
#[test]
fn signals_free_the_port_with_the_laser_off() {
    for signal in ["INT", "TERM"] {
        with_each_sensor(|port, _| {
            let mut example = Example::run("graceful_shutdown", &[port]);
            example.line_with("scan 2");
            let process = example.child.id().to_string();
            let kill = Command::new("kill").args(["-s", signal, &process]).status();
            assert!(kill.unwrap().success());
            example.line_with("the laser is off, and the port is free");
            example.end();
        });
    }
}

#[cfg(unix)]
#[test]
fn scans_come_over_a_transport_of_ones_own() {
    with_each_sensor(|port, _| {
        let device = port.replace("tcp://", "/dev/tcp/").replace(':', "/");
        let program = format!("exec bash -c 'exec 3<>{device}; cat <&3 & exec cat >&3'");
        let port = if device == port { port } else { &program };
        Example::run("own_transport", &[port]).line_with("scan 2: ");
    });
}

/// Scans per second in a line of the fleet.
fn rate(line: &str) -> u64 {
    address(line.strip_suffix(" scans/s").unwrap()).parse().unwrap()
}

#[test]
fn a_fleet_of_a_hundred_sensors_is_reported() {
    // Computing 100 rooms takes most of a core, so `promises` checks the rate on the paused clock.
    Example::run("fleet", &["emulated", "100"]).line_with("100 sensors, ");
}

#[test]
fn a_fleet_names_the_sensor_that_it_waits_for() {
    with_each_sensor(|port, _| {
        let mut example = Example::run("fleet", &[ABSENT, port]);
        let lines = std::iter::repeat_with(|| example.line_with("2 sensors, "));
        assert!({ lines }.any(|line| rate(&line) > 5));
        example.line_with(&format!("0 {ABSENT}: expected a scan within 500.0ms, but none"));
    });
}

#[test]
fn a_missing_door_does_not_delay_the_others() {
    with_each_sensor(|port, _| {
        let mut example = Example::run("count_people", &[ABSENT, port]);
        example.line_with(&format!("{ABSENT}: unknown: expected a scan"));
        example.line_with(&format!("{port}: 0 people"));
    });
}

#[test]
fn the_nearest_object_is_sent_as_osc() {
    with_each_sensor(|port, _| {
        let receiver = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let target = receiver.local_addr().unwrap().to_string();
        let mut example = Example::run("osc", &[port, &target]);
        example.line_with(&target);
        let mut packet = [0; 64];
        assert_eq!(receiver.recv(&mut packet).unwrap(), 28);
        assert!(packet.starts_with(b"/urg/nearest\0\0\0\0,ff\0"));
    });
}

#[test]
fn hands_on_a_wall_are_sent_as_tuio() {
    let receiver = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let target = receiver.local_addr().unwrap().to_string();
    // As it prints them when they are touched, for which a busy machine would be too slow.
    let corners = ["0.381,0.574", "2.367,0.593", "2.367,-0.593", "0.382,-0.574"];
    let arguments = ["emulated", &target].into_iter().chain(corners).collect::<Vec<_>>();
    let mut example = Example::run("interactive_wall", &arguments);
    let line = example.line_with(&target);
    assert!(line.contains(&corners.join(" ")), "{line}");
    let mut packet = [0; 2048];
    let frames = std::iter::repeat_with(|| {
        let received = receiver.recv(&mut packet).unwrap();
        Frame::decode(&packet[..received], "interactive_wall@127.0.0.1")
    });
    let frame = { frames }.find(|frame| frame.cursors.len() == 2).unwrap();
    // Each hand stays at its height.
    let mut heights: Vec<f64> = frame.cursors.values().map(|cursor| cursor.place.1).collect();
    heights.sort_by(f64::total_cmp);
    assert!((heights[0] - 0.25).abs() < 0.02 && (heights[1] - 0.7).abs() < 0.02, "{heights:?}");
}

#[test]
fn scans_of_each_model_show_hands_and_motion() {
    with_each_sensor(|port, _| {
        Example::run("odometry", &[port]).line_with("heading ");
        let corners = ["0.4,0.6", "2.4,0.6", "2.4,-0.6", "0.4,-0.6"];
        let arguments = [port, "127.0.0.1:9"].into_iter().chain(corners).collect::<Vec<_>>();
        Example::run("interactive_wall", &arguments).line_with("sends hands between ");
    });
}
