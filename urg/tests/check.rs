//! `urg check`, on good and on faulty sensors.

use std::io::Cursor;
use std::time::Duration;

use serde_json::Value;
use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::{Emulator, Fault, Faults, Model};
use urg_recording::Recorder;

use super::program::{Emulated, Running, Scratch, failure, run};
use super::recorded::{recording, recording_of};
use super::web::{Served, on_tcp};

/// Returns each step with its verdict.
fn verdicts(report: &str) -> Vec<(&str, &str)> {
    report
        .lines()
        .take_while(|line| !line.is_empty())
        .map(|line| {
            let mut words = line.split_whitespace();
            (words.next().unwrap(), words.next().unwrap())
        })
        .collect()
}

#[test]
fn a_good_sensor_passes_every_step() {
    let link = Scratch::new("check-good");
    let sensor = Emulated::start(&format!("--link {}", link.path()));
    let output = run(&format!("check {} --duration 1s", sensor.port), 0);
    assert_eq!(output.stderr, "");
    let steps: Vec<_> = verdicts(&output.stdout).into_iter().map(|(_, step)| step).collect();
    assert_eq!(
        steps,
        ["link", "version", "laser", "polls", "rate", "latency", "motor", "sight"],
        "{}",
        output.stdout
    );
    assert!(!output.stdout.contains("FAILED"), "{}", output.stdout);
    assert!(output.stdout.contains("SOKUIKI Sensor URG-04LX H0713090"), "{}", output.stdout);
}

#[test]
fn a_sensor_that_damages_replies_fails_the_check() {
    let link = Scratch::new("check-bad");
    let sensor = Emulated::start(&format!(
        "--link {} --revolution 20ms --faults damaged=0.4,seed=3",
        link.path()
    ));
    let output = run(&format!("check {} --duration 3s", sensor.port), 1);
    assert!(verdicts(&output.stdout).contains(&("FAILED", "polls")), "{}", output.stdout);
    assert!(output.stderr.contains("has FAILED: "), "{}", output.stderr);
    assert_eq!(output.stderr.lines().count(), 1, "{}", output.stderr);
    // The pseudo-terminal ignores the baud rate, so a faster one is no advice.
    let rate = output.stdout.lines().find(|line| line.contains(" rate ")).unwrap();
    assert!(rate.contains("polls brought no scan"), "{}", output.stdout);
}

#[test]
fn no_cable_is_blamed_for_a_sensor_that_refuses() {
    // A UST that knows itself to be out of order.
    let faults = ["BM", "GD", "MD"].map(|command| (command, Fault::Status(b'L')));
    let faults =
        faults.into_iter().fold(Faults::none(), |all, (command, fault)| all.on(command, fault));
    let (_runtime, port) = on_tcp(Emulator::builder().model(Model::Ust10lx).faults(faults).build());
    let output = run(&format!("check {port} --duration 1s"), 1).stdout;
    let polls = output.lines().find(|line| line.starts_with("FAILED  polls"));
    assert!(polls.is_some_and(|line| line.ends_with(" refused")), "{output}");
}

#[test]
fn a_check_of_a_missing_port_fails_with_the_reason() {
    let missing = Scratch::new("check-missing");
    let output = run(&format!("check {}", missing.path()), 1);
    assert_eq!(verdicts(&output.stdout), [("FAILED", "link")]);
    assert!(output.stdout.contains("no port"), "{}", output.stdout);
}

#[test]
fn an_interrupted_check_does_not_exit_with_success() {
    let mut check = Running::start("check emulated --duration 1h");
    while !check.line().contains("laser") {}
    check.signal("INT");
    check.rest();
    let (status, notices) = check.end();
    assert_eq!((status.code(), notices.len()), (Some(1), 1), "{notices:?}");
}

#[test]
fn replies_faster_than_the_baud_rate_are_reported() {
    let link = Scratch::new("outrun");
    // A pseudo-terminal accepts any baud rate, and its emulated sensor ignores it.
    let sensor = Emulated::start(&format!("--revolution 20ms --link {}", link.path()));
    let info = run(&format!("info {}", sensor.port), 0).stdout;
    let row = info.lines().find(|line| line.starts_with("baud rate")).unwrap();
    assert!(row.contains("this port ignores the baud rate"), "{info}");
    assert!(!row.contains("at most"), "{info}");
    let baud = run(&format!("baud {} 115200", sensor.port), 0).stderr;
    assert!(baud.contains("replies come faster than"), "{baud}");
    let check = run(&format!("check {} --duration 2s", sensor.port), 0).stdout;
    let link = check.lines().next().unwrap();
    assert!(link.contains("replies come faster than"), "{check}");
    assert!(!check.contains("baud. What helps"), "{check}");
    let served = Served::start(&sensor.port);
    served.get("/scans?max=3").text();
    assert_eq!(served.state()["baud_rate"], Value::Null);
    // Killed, it would leave its lock on the terminal, which its sensor keeps open.
    served.running.signal("INT");
    served.running.end();
    let file = Scratch::mcap("outrun-recorded");
    run(&format!("record {} {} --count 3", sensor.port, file.path()), 0);
    let recorded = run(&format!("info {}", file.path()), 0).stdout;
    assert!(!recorded.contains("19200"), "{recorded}");
}

/// Sets the stamps in a recording of the paused clock to its times. The wall clock runs on, and a machine
/// that stalls seems to have set it.
fn take_stamps_from_log_times(path: &str) {
    let bytes = std::fs::read(path).unwrap();
    let mut file =
        mcap::WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    for index in mcap::Summary::read(&bytes).unwrap().unwrap().metadata_indexes {
        file.write_metadata(&mcap::read::metadata(&bytes, &index).unwrap()).unwrap();
    }
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        let publish_time = message.log_time;
        file.write(&mcap::Message { publish_time, ..message }).unwrap();
    }
    file.finish().unwrap();
    std::fs::write(path, file.into_inner().into_inner()).unwrap();
}

#[tokio::test(start_paused = true)]
async fn drift_and_jumps_of_a_recorded_clock_are_told() {
    for (rate, drift) in [(Rate::UNLIMITED, 0.0012), (Rate::hz(7.0), -0.0004)] {
        let file = Scratch::mcap("check-drift");
        let sensor = Emulator::builder().model(Model::Ust10lx).clock(Duration::ZERO, drift);
        recording_of(sensor.build(), file.path(), Window::DETECTION, rate, 500).await;
        take_stamps_from_log_times(file.path());
        let check = run(&format!("check {}", file.path()), 0).stdout;
        let expected = if drift > 0.0 { "0.12 % fast" } else { "0.04 % slow" };
        assert!(check.contains(&format!("sensor clock {expected}\n")), "{check}");
        assert!(check.contains("scans    500 of steps 0..=1080"), "{check}");
        assert!(check.ends_with("\nall is well\n"), "{check}");
    }
    let file = Scratch::mcap("check-jump");
    let sensor = Emulator::builder().model(Model::Ust10lx);
    let sensor = sensor.faults(Faults::none().at(700, Fault::ClockJump(-2000)));
    recording_of(sensor.build(), file.path(), Window::DETECTION, Rate::UNLIMITED, 1000).await;
    take_stamps_from_log_times(file.path());
    let check = run(&format!("check {}", file.path()), 0).stdout;
    assert!(check.contains(" % fast; it jumped 1 time"), "{check}");
    assert!(check.ends_with("\nit works; weak: sensor clock\n"), "{check}");
}

#[tokio::test(start_paused = true)]
async fn scans_that_never_came_are_told_of_a_recording() {
    let file = Scratch::mcap("check-lost");
    let lossy = Faults::none().at(60, Fault::Lost).at(61, Fault::Lost).at(70, Fault::WrongSum);
    let sensor = Emulator::builder().model(Model::Ust10lx).faults(lossy).build();
    recording_of(sensor, file.path(), Window::DETECTION, Rate::hz(40.0), 200).await;
    take_stamps_from_log_times(file.path());
    let check = run(&format!("check {}", file.path()), 0).stdout;
    let losses = "losses   1 poll without a scan, 2 scans lost on the way\n";
    assert!(check.contains(losses), "{check}");
    assert!(check.ends_with("\nit works; weak: left out, losses\n"), "{check}");
}

#[tokio::test(start_paused = true)]
async fn a_link_that_did_not_return_is_weak_in_a_recording() {
    for is_back in [false, true] {
        let file = Scratch::mcap("check-unplugged");
        let emulator = Emulator::builder().usb().build();
        let mut recorder = Recorder::create(file.path()).unwrap();
        let builder = Sensor::builder().on_reply(recorder.observer());
        let sensor = builder.connect(emulator.clone()).await.unwrap();
        let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        for number in 0..20 + if is_back { 2 } else { 1 } {
            match number {
                20 => emulator.unplug(),
                21 => emulator.plug_in(),
                _ => {}
            }
            let item = scans.next().await.unwrap();
            assert_eq!(item.is_err(), number == 20, "{item:?}");
            recorder.record(&item).unwrap();
        }
        recorder.finish().await.unwrap();
        take_stamps_from_log_times(file.path());
        let check = run(&format!("check {}", file.path()), 0).stdout;
        let row = "weak    link     lost at 0:01, and not back\n";
        assert_eq!(check.contains(row), !is_back, "{check}");
        assert_eq!(check.contains("weak: link\n"), !is_back, "{check}");
    }
}

#[tokio::test(start_paused = true)]
async fn the_bag_of_another_program_is_judged() {
    let file = Scratch::mcap("check-bag");
    recording(file.path(), Window::DETECTION, 20).await;
    let bytes = std::fs::read(file.path()).unwrap();
    let mut bag =
        mcap::WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        let mut channel = (*message.channel).clone();
        if channel.topic == "/scan" {
            channel.topic = "/front/scan".to_owned();
            bag.write(&mcap::Message { channel: channel.into(), ..message }).unwrap();
        }
    }
    bag.finish().unwrap();
    std::fs::write(file.path(), bag.into_inner().into_inner()).unwrap();
    let line = failure(&format!("check {}", file.path()));
    assert!(line.ends_with("choose a topic: /front/scan\n"), "{line}");
    let check = run(&format!("check {} --topic /front/scan", file.path()), 0).stdout;
    assert!(check.contains("not recorded, as by other programs: only the scans on /front/scan"));
    assert!(
        check.contains("scans    20 of steps 44..=725\n") && check.ends_with("\nall is well\n"),
        "{check}"
    );
    // Nobody counted the losses: "0" would be false.
    assert!(check.contains("losses   not recorded\n"), "{check}");
}
