//! Sensors that refuse to measure for another reason than their laser.

use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, DuplexStream, duplex, split};
use tokio::time::{Instant, sleep, timeout_at};
use tokio_scip::{Error, ErrorChain, Rate, ScanStream, Sensor, Window};

use crate::common::builder;

pub(super) const VERSION: &str = "00P\nVEND:Hokuyo Automatic Co., Ltd.;;\nPROD:UST-10LX;M\nFIRM:4.1.0;I\n\
    PROT:SCIP 2.2;P\nSERI:H0000001;6";
pub(super) const PARAMETERS: &str = "00P\nMODL:UST-10LX;D\nDMIN:23;7\nDMAX:60000;J\nARES:1440;^\nAMIN:0;?\n\
    AMAX:1080;Z\nAFRT:540;0\nSCAN:2400;U";

/// Returns a sensor that answers within a millisecond, and answers `GD` and `MD` like this.
fn sensor_without_scans(answer: &'static str) -> DuplexStream {
    sensor(answer, |command| command)
}

/// Returns a sensor as [`sensor_without_scans`] does, which repeats this of a command.
fn sensor(answer: &'static str, echo: fn(&str) -> &str) -> DuplexStream {
    let (near, far) = duplex(4096);
    tokio::spawn(async move {
        let (read, mut write) = split(far);
        let mut commands = BufReader::new(read).lines();
        while let Ok(Some(command)) = commands.next_line().await {
            let reply = match command.get(..2) {
                Some("VV") => VERSION,
                Some("PP") => PARAMETERS,
                Some("BM" | "QT") => "00P",
                Some("GD" | "MD") => answer,
                Some(_) => "0Ee",
                None => continue,
            };
            sleep(Duration::from_millis(1)).await;
            let frame = format!("{}\n{reply}\n\n", echo(&command));
            if write.write_all(frame.as_bytes()).await.is_err() {
                return;
            }
        }
    });
    near
}

/// Reads a stream for five seconds, and returns its errors.
async fn errors_of(stream: &mut ScanStream) -> Vec<Error> {
    let (mut errors, end) = (Vec::new(), Instant::now() + Duration::from_secs(5));
    while let Ok(item) = timeout_at(end, stream.next()).await {
        errors.extend(item.unwrap().err());
    }
    errors
}

async fn refused(answer: &'static str, rate: Rate) -> (Sensor, Vec<Error>) {
    crate::common::limit::limit();
    let sensor = builder().attach(sensor_without_scans(answer)).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
    let errors = errors_of(&mut stream).await;
    (sensor, errors)
}

#[tokio::test(start_paused = true)]
async fn a_refusal_to_measure_is_named() {
    for (rate, parts) in [
        (Rate::hz(2.0), &["BM", "'00'", "refuses to measure", "'0E'"][..]),
        (Rate::UNLIMITED, &["refused MD", "'0E'", "does not know the command"]),
    ] {
        let (_sensor, errors) = refused("0Ee", rate).await;
        let [error] = &errors[..] else { panic!("{errors:?}") };
        let text = error.to_string();
        for part in parts {
            assert!(text.contains(part), "{text}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_without_a_scan_is_asked_for_once_a_revolution() {
    // It refuses, and its answer is damaged, or lacks the scan.
    for answer in ["0Ee", "00x", "99b"] {
        let (sensor, _) = refused(answer, Rate::UNLIMITED).await;
        let polls = sensor.stats().polls;
        // 200 revolutions.
        assert!((180..=210).contains(&polls), "{answer}: {polls}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_does_not_repeat_the_text_of_a_request_is_named() {
    crate::common::limit::limit();
    fn own(command: &str) -> &str {
        command.split(';').next().unwrap()
    }
    for (echo, expected) in [
        // Only of some commands.
        (
            (|command| if command.starts_with("PP") { own(command) } else { command })
                as fn(&str) -> &str,
            Some("PP"),
        ),
        // It is silent.
        (|_| "", None),
    ] {
        let error = builder().attach(sensor("0Ee", echo)).await.unwrap_err();
        let text = ErrorChain(&error).to_string();
        assert_eq!(text.contains(" with its text"), expected.is_some(), "{text}");
        if let Some(command) = expected {
            assert!(text.contains(&format!("found \"{command}\"")), "{text}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn scans_without_the_text_of_their_request_are_named() {
    for rate in [Rate::UNLIMITED, Rate::hz(40.0)] {
        let (sensor, errors) = refused("00P\n\nMD0000108001000\n99b", rate).await;
        let text = ErrorChain(&errors[0]).to_string();
        assert!(text.contains(" with its text in the reply, found \"MD0000108001000\""), "{text}");
        assert!(sensor.stats().malformed.total() > 0);
    }
}
