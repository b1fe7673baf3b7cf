//! Replies known in advance, in both protocols.

use std::io;
use std::time::{Duration, SystemTime};

use tokio::io::AsyncReadExt;
use tokio::time::sleep;
use urg_emulator::{Emulator, Mode, Model, ReplayPace, Script, Values};

use super::sensor;
use crate::ask;

/// Measures one more millimetre with each reply, from 101 to 103, and then ends.
struct Counting(u32);

impl Script for Counting {
    fn prepare(&mut self) {}

    fn due(&self) -> Option<Duration> {
        (self.0 < 103).then_some(Duration::ZERO)
    }

    fn is_single_step(&self, _: u16) -> bool {
        false
    }

    fn advance(&mut self, _: &[u8]) -> Option<Vec<u8>> {
        self.0 += 1;
        None
    }

    fn wall_clock(&self) -> SystemTime {
        SystemTime::UNIX_EPOCH
    }

    fn failure(&self) -> Option<io::Error> {
        None
    }

    fn measure(&self, distances: &mut Values, intensities: &mut Values) {
        distances.fill(self.0);
        intensities.fill(2 * self.0);
    }

    fn clock(&self) -> Option<u64> {
        Some(1000 * u64::from(self.0))
    }
}

fn scripted(model: Model, mode: Mode) -> Emulator {
    sensor(model).mode(mode).script(Counting(100), ReplayPace::Max).build()
}

#[tokio::test(start_paused = true)]
async fn a_script_answers_in_both_protocols() {
    for (model, mode, off, on, command, refused, values) in [
        (Model::Urg04lx, Mode::Scip1, "L0", "L1", "G00000101", "6", ["1U1U", "1V1V", "1W1W"]),
        (
            Model::Ust10lx,
            Mode::Scip2,
            "QT",
            "BM",
            "GD0000000101",
            "10Q",
            ["01U01U", "01V01V", "01W01W"],
        ),
    ] {
        let mut link = scripted(model, mode).link();
        ask(&mut link, off).await;
        assert_eq!(ask(&mut link, command).await, format!("{command}\n{refused}\n\n"));
        ask(&mut link, on).await;
        sleep(Duration::from_secs(1)).await;
        for expected in values {
            let reply = ask(&mut link, command).await;
            let data = reply.trim_end().lines().last().unwrap();
            assert!(data.starts_with(expected), "{reply}");
        }
        // The end: the link is hung up.
        assert_eq!(ask(&mut link, command).await, "");
    }
}

/// Each scan once, whatever a stream leaves out of a world's, with the script's time.
#[tokio::test(start_paused = true)]
async fn a_stream_sends_the_whole_script() {
    for (command, values) in [
        ("MD0000000101000", ["01U01U", "01V01V", "01W01W"]),
        ("ME0000000101500", ["01U03:", "01V03<", "01W03>"]),
    ] {
        let mut link = scripted(Model::Utm30lx, Mode::Scip2).link();
        assert_eq!(ask(&mut link, command).await, format!("{command}\n00P\n\n"));
        let mut sent = String::new();
        link.read_to_string(&mut sent).await.unwrap();
        let scans: Vec<&str> = sent.split_terminator("\n\n").collect();
        for ((scan, expected), clock) in scans.iter().zip(values).zip(["01U", "01V", "01W"]) {
            let lines: Vec<&str> = scan.lines().collect();
            assert_eq!(lines[..2], [command, "99b"]);
            assert_eq!(&lines[2][1..4], clock);
            assert!(lines[3].starts_with(expected), "{scan}");
        }
        assert_eq!(scans.len(), 3);
    }
}
