//! Clock, clock mode, restarts and sleep.

use std::time::Duration;

use tokio::io::AsyncReadExt;
use tokio::time::sleep;
use urg_emulator::{Emulator, Link, Model, Quirk};

use super::{MODELS, sensor};
use crate::ask;

/// Number in the characters of the line after the status, without its sum.
fn number(reply: &str) -> u128 {
    let line = reply.lines().nth(2).unwrap();
    let characters = &line.as_bytes()[..line.len() - 1];
    characters.iter().fold(0, |number, byte| number * 64 + u128::from(byte - b'0'))
}

async fn clock(link: &mut Link, command: &str) -> u128 {
    let reply = ask(link, command).await;
    assert!(reply.starts_with(&format!("{command}\n00P\n")), "{reply}");
    number(&reply)
}

/// Asserts that the sensor's clock is within 10 ms of `expected`: tokio's timers round to
/// milliseconds.
async fn check_clock(link: &mut Link, expected: u128) {
    let found = clock(link, "TM1").await;
    assert!(found.abs_diff(expected) < 10, "{found} {expected}");
}

/// Returns true if the link is hung up.
async fn ends(link: &mut Link) -> bool {
    tokio::time::timeout(Duration::ZERO, link.read(&mut [0])).await.is_ok()
}

fn ust(reads: Duration, faster: f64) -> Emulator {
    sensor(Model::Ust10lx).clock(reads, faster).build()
}

#[tokio::test(start_paused = true)]
async fn a_clock_is_read_in_both_units() {
    let mut link = ust(Duration::from_micros(16_000_000_123), 0.0).link();
    // The bytes of the command take no time that counts.
    assert_eq!(ask(&mut link, "TM1;x").await, "TM1;x\n00P\nm2@0?\n\n");
    sleep(Duration::from_secs(5)).await;
    assert!((clock(&mut link, "%TM1").await / 1000).abs_diff(16_005_000) < 10);
    check_clock(&mut link, 16_005_000).await;
}

#[tokio::test(start_paused = true)]
async fn a_clock_of_24_bits_wraps() {
    let before = Duration::from_millis((1 << 24) - 500);
    let mut link = ust(before, 0.0).link();
    check_clock(&mut link, (1 << 24) - 500).await;
    sleep(Duration::from_secs(1)).await;
    check_clock(&mut link, 500).await;
    assert!(clock(&mut link, "%TM1").await > 16_000_000_000);
}

#[tokio::test(start_paused = true)]
async fn a_clock_runs_fast_and_jumps() {
    let emulator = ust(Duration::ZERO, 0.002);
    let mut link = emulator.link();
    sleep(Duration::from_secs(1000)).await;
    check_clock(&mut link, 1_002_000).await;
    emulator.set_clock_rate(-0.001);
    sleep(Duration::from_secs(1000)).await;
    check_clock(&mut link, 2_001_000).await;
    emulator.jump_clock(72);
    check_clock(&mut link, 2_001_072).await;
    emulator.jump_clock(-1_000_072);
    check_clock(&mut link, 1_001_000).await;
    // Not before zero.
    emulator.jump_clock(i64::MIN / 2000);
    check_clock(&mut link, 0).await;
}

#[tokio::test(start_paused = true)]
async fn a_reset_starts_the_clock_anew() {
    for model in MODELS {
        for command in ["RS", "RT"] {
            let mut link = sensor(model).laser(true).build().link();
            sleep(Duration::from_secs(9)).await;
            assert_eq!(ask(&mut link, command).await, format!("{command}\n00P\n\n"));
            sleep(Duration::from_secs(1)).await;
            check_clock(&mut link, 1000).await;
            // The laser is off.
            assert_eq!(ask(&mut link, "GD0044004401").await, "GD0044004401\n10Q\n\n");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn only_a_full_reset_resets_the_motor() {
    for (command, status) in [("RT", "03S"), ("RS", "00P")] {
        let mut link = sensor(Model::Urg04lx).build().link();
        assert_eq!(ask(&mut link, "CR10").await, "CR10\n00P\n\n");
        ask(&mut link, command).await;
        assert_eq!(ask(&mut link, "CR10").await, format!("CR10\n{status}\n\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn a_slower_motor_turns_less_often() {
    let emulator = sensor(Model::Urg04lx).build();
    let mut link = emulator.link();
    ask(&mut link, "CR10").await;
    ask(&mut link, "MD0044004401000").await;
    sleep(Duration::from_secs(10)).await;
    ask(&mut link, "II").await;
    // Every 111 ms, without the first one or two.
    let scans = emulator.counts().scans;
    assert!((87..=89).contains(&scans), "{scans}");
}

#[tokio::test(start_paused = true)]
async fn the_clock_mode_refuses_other_commands() {
    for (model, refused) in [(Model::Utm30lx, "0Ee"), (Model::Ust10lx, "10Q")] {
        let mut link = sensor(model).laser(true).build().link();
        assert_eq!(ask(&mut link, "TM0").await, "TM0\n00P\n\n");
        assert_eq!(ask(&mut link, "TM0").await, "TM0\n02R\n\n");
        for command in ["QT", "BM", "PP", "GD0044004401", "MD0044004401000"] {
            assert_eq!(ask(&mut link, command).await, format!("{command}\n{refused}\n\n"));
        }
        assert!(ask(&mut link, "VV").await.starts_with("VV\n00P\n"));
        assert!(ask(&mut link, "II").await.contains("\nLASR:OFF;7\n"));
        clock(&mut link, "TM1").await;
        assert_eq!(ask(&mut link, "TM2").await, "TM2\n00P\n\n");
        assert_eq!(ask(&mut link, "TM2").await, "TM2\n03S\n\n");
        // Real sensors answer outside of the mode, too.
        clock(&mut link, "TM1").await;
        assert_eq!(ask(&mut link, "BM").await, "BM\n00P\n\n");
    }
}

#[tokio::test(start_paused = true)]
async fn a_ust_tells_its_state() {
    let mut link = sensor(Model::Ust10lx).build().link();
    for (command, code) in [
        ("QT", "000@"),
        ("TM0", "002B"),
        ("TM2", "000@"),
        ("BM", "003C"),
        ("%SL", "005E"),
        ("QT", "000@"),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n00P\n\n"));
        assert_eq!(ask(&mut link, "%ST").await, format!("%ST\n00P\n{code}\n\n"));
    }
    ask(&mut link, "%SL").await;
    assert_eq!(ask(&mut link, "BM").await, "BM\n10Q\n\n");
}

#[tokio::test(start_paused = true)]
async fn two_reboots_within_a_second_restart() {
    for model in MODELS {
        let boot = Duration::from_secs(2);
        let emulator = sensor(model).boot_time(boot).build();
        sleep(boot).await;
        let mut link = emulator.link();
        assert_eq!(ask(&mut link, "RB").await, "RB\n01Q\n\n");
        sleep(Duration::from_millis(1001)).await;
        assert_eq!(ask(&mut link, "RB").await, "RB\n01Q\n\n");
        assert_eq!(ask(&mut link, "RB").await, "RB\n00P\n\n");
        // For another second it answers as before.
        sleep(Duration::from_millis(990)).await;
        assert_eq!(ask(&mut link, "QT").await, "QT\n00P\n\n");
        assert_eq!(emulator.counts().resets, 0, "{model:?}");
        sleep(Duration::from_millis(15)).await;
        assert_eq!(emulator.counts().resets, 1, "{model:?}");
        // On Ethernet the connection is lost.
        let is_hung_up = ends(&mut link).await;
        assert_eq!(is_hung_up, model == Model::Ust10lx);
        let mut link = emulator.link();
        sleep(boot).await;
        let (command, status) = match model {
            Model::Urg04lx => ("L1", "0"),
            _ => ("BM", "00P"),
        };
        assert_eq!(ask(&mut link, command).await, format!("{command}\n{status}\n\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn a_clock_may_be_told_on_ticks() {
    let start = tokio::time::Instant::now();
    let mut link = sensor(Model::Ust10lx).quirk(Quirk::ClockTicks).build().link();
    for pause in [1, 2, 3, 7, 11, 13] {
        sleep(Duration::from_millis(pause)).await;
        let asked = start.elapsed().as_millis();
        let told = clock(&mut link, "TM1").await;
        let answered = start.elapsed().as_millis();
        // The clock is read when the request arrives, at most a millisecond after it was sent.
        assert!(told == asked || told == asked + 1, "{told} {asked}");
        assert!(answered >= told.next_multiple_of(5) && answered <= told / 5 * 5 + 7, "{answered}");
    }
}
