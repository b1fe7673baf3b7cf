//! Scans that are sent without being asked for again.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, sleep};
use tokio_scip::BaudRate;
use urg_emulator::{Emulator, Mode, Model, Pace, Values, WorldTime};

use super::{MODELS, sensor};
use crate::{ask, listen};

const MS: Duration = Duration::from_millis(1);

/// Returns a sensor whose step 44 measures the number of the revolution, from 100 mm on.
fn counting(model: Model) -> Emulator {
    let world = |time: WorldTime, values: &mut Values| {
        values.fill(1234);
        values[44] = 100 + time.revolution as u32;
    };
    sensor(model).world(world).build()
}

/// Number of the revolution that a scan of step 44 shows.
fn revolution(scan: &str) -> u32 {
    let data = scan.lines().nth(3).unwrap().as_bytes();
    data[..3].iter().fold(0, |number, byte| number * 64 + u32::from(byte - b'0')) - 100
}

#[tokio::test(start_paused = true)]
async fn a_stream_sends_every_scan_once() {
    for model in MODELS {
        let emulator = counting(model);
        let mut link = emulator.link();
        assert_eq!(ask(&mut link, "MD0044004401000;a").await, "MD0044004401000;a\n00P\n\n");
        assert!(emulator.is_laser_on());
        let first = listen(&mut link).await;
        assert!(first.starts_with("MD0044004401000;a\n99b\n"), "{first}");
        for later in 1..100 {
            let scan = listen(&mut link).await;
            assert!(scan.starts_with("MD0044004401000;a\n99b\n"), "{scan}");
            assert_eq!(revolution(&scan), revolution(&first) + later);
        }
        assert_eq!(ask(&mut link, "QT").await, "QT\n00P\n\n");
        assert_eq!(listen(&mut link).await, "");
        assert!(!emulator.is_laser_on());
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_skips_and_counts_down() {
    let emulator = counting(Model::Utm30lx);
    let mut link = emulator.link();
    assert_eq!(ask(&mut link, "MS0044004501211;b").await, "MS0044004501211;b\n00P\n\n");
    let mut revolutions = Vec::new();
    for left in (0..11).rev() {
        let scan = listen(&mut link).await;
        assert!(scan.starts_with(&format!("MS00440045012{left:02};b\n99b\n")), "{scan}");
        let data = scan.lines().nth(3).unwrap();
        // Two points of two characters, and the sum.
        assert_eq!(data.len(), 5);
        revolutions.push(emulator.sent_scans().last().unwrap().time.revolution);
    }
    assert!(revolutions.windows(2).all(|two| two[1] == two[0] + 3), "{revolutions:?}");
    // "Switched off after completing the number of scans" (p. 10).
    assert_eq!(listen(&mut link).await, "");
    assert!(!emulator.is_laser_on());
    assert_eq!(ask(&mut link, "GD0044004401").await, "GD0044004401\n10Q\n\n");
}

#[tokio::test(start_paused = true)]
async fn the_first_scan_is_measured_after_the_request() {
    for model in MODELS {
        let emulator = sensor(model).pace(Pace::PerRevolution).build();
        let mut link = emulator.link();
        sleep(130 * MS).await;
        ask(&mut link, "MD0044004401001").await;
        let answered = Instant::now();
        listen(&mut link).await;
        let sent = *emulator.sent_scans().last().unwrap();
        assert!(sent.revolution_end - sent.time.period + MS >= answered, "{model:?}");
        assert!(sent.revolution_end - sent.time.period < answered + sent.time.period);
        assert!(sent.requested_at < answered);
    }
}

#[tokio::test(start_paused = true)]
async fn a_scan_comes_when_its_revolution_ends() {
    let emulator = sensor(Model::Ust10lx).revolution(25_050_400 * MS / 1_000_000).build();
    let start = Instant::now();
    let mut link = emulator.link();
    ask(&mut link, "MD0000108001000").await;
    for _ in 0..50 {
        link.read_u8().await.unwrap();
        let arrived = start.elapsed();
        listen(&mut link).await;
        let ended = emulator.sent_scans().last().unwrap().revolution_end - start;
        // In the next frame of a millisecond; tokio's timer fires in the one after.
        let frame = Duration::from_millis(ended.as_millis() as u64 + 1);
        assert_eq!(arrived, frame + MS, "{ended:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn stamps_follow_the_clock_of_the_sensor() {
    let emulator = sensor(Model::Ust10lx).clock(1000 * MS, 0.01).build();
    let start = Instant::now();
    let mut link = emulator.link();
    ask(&mut link, "%ME0000000001000").await;
    for _ in 0..100 {
        let scan = listen(&mut link).await;
        let lines: Vec<&[u8]> = scan.lines().map(str::as_bytes).collect();
        assert_eq!((lines[2].len(), lines[3].len()), (12, 7), "{scan}");
        let stamp = lines[2][..11].iter().fold(0, |n, byte| n * 64 + u64::from(byte - b'0'));
        let sent = emulator.sent_scans().last().unwrap().time;
        let expected = 1e6 + sent.at_step(0).as_secs_f64() * 1e6 * 1.01;
        assert!((stamp as f64 - expected).abs() < 2.0, "{stamp} {expected} {start:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn other_commands_are_answered_during_a_stream() {
    let emulator = counting(Model::Ust10lx);
    let mut link = emulator.link();
    ask(&mut link, "MD0044004401000").await;
    sleep(990 * MS).await;
    link.write_all(b"GD0044004401;one\nVV\nBM\n").await.unwrap();
    let mut others = Vec::new();
    let mut revolutions = Vec::new();
    while revolutions.len() < 80 {
        let reply = listen(&mut link).await;
        match reply.starts_with("MD") {
            true => revolutions.push(revolution(&reply)),
            false => others.push(reply),
        }
    }
    assert!(revolutions.windows(2).all(|two| two[1] == two[0] + 1));
    assert!(others[0].starts_with("GD0044004401;one\n00P\n"));
    assert!(others[1].starts_with("VV\n00P\n"));
    assert_eq!(others[2..], ["BM\n02R\n\n"]);
}

#[tokio::test(start_paused = true)]
async fn a_new_stream_replaces_the_old_one() {
    let mut link = sensor(Model::Utm30lx).build().link();
    ask(&mut link, "MD0044004401000;old").await;
    listen(&mut link).await;
    assert_eq!(ask(&mut link, "ME0044004401000;new").await, "ME0044004401000;new\n00P\n\n");
    for _ in 0..5 {
        assert!(listen(&mut link).await.starts_with("ME0044004401000;new\n99b\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn the_clock_mode_ends_a_stream_except_of_a_ust() {
    for (model, status) in [(Model::Utm30lx, "00P"), (Model::Ust10lx, "10Q")] {
        let mut link = sensor(model).build().link();
        ask(&mut link, "MD0044004401000").await;
        listen(&mut link).await;
        assert_eq!(ask(&mut link, "TM0").await, format!("TM0\n{status}\n\n"));
        assert_eq!(listen(&mut link).await.is_empty(), status == "00P");
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_outlives_its_client() {
    for model in MODELS {
        let emulator = sensor(model).mode(Mode::Scip2Streaming).build();
        assert!(emulator.is_laser_on());
        let last = if model == Model::Utm30lx || model == Model::Ust10lx { 1080 } else { 725 };
        let first = if last == 1080 { 0 } else { 44 };
        let echo = format!("MD{first:04}{last:04}01000\n99b\n");
        for _ in 0..2 {
            let mut link = emulator.link();
            assert!(listen(&mut link).await.starts_with(&echo), "{model:?}");
            // Half a scan stays behind, unless the connection is lost with it.
            let mut half = [0; 100];
            link.read_exact(&mut half).await.unwrap();
            sleep(3600 * 1000 * MS).await;
            drop(link);
            let mut link = emulator.link();
            let next = listen(&mut link).await;
            assert_eq!(next.starts_with(&echo), model == Model::Ust10lx, "{next}");
        }
        let mut link = emulator.link();
        link.write_all(b"QT\n").await.unwrap();
        let mut last = listen(&mut link).await;
        while last != "QT\n00P\n\n" {
            last = listen(&mut link).await;
            assert!(!last.is_empty());
        }
        assert_eq!(listen(&mut link).await, "");
    }
}

/// The buffers of a host hold some scans.
#[tokio::test(start_paused = true)]
async fn a_host_may_pause_for_a_second() {
    for model in [Model::Utm30lx, Model::Ust10lx] {
        let emulator = sensor(model).log_capacity(100).build();
        let mut link = emulator.link();
        ask(&mut link, "MD0000108001000").await;
        for _ in 0..3 {
            tokio::time::advance(1000 * MS).await;
            for _ in 0..20 {
                assert_eq!(listen(&mut link).await.len(), 3372);
            }
        }
        let sent = emulator.sent_scans();
        assert!(sent.windows(2).all(|two| two[1].time.revolution == two[0].time.revolution + 1));
    }
}

/// 2,137 bytes take 186 ms at 115,200 baud.
#[tokio::test(start_paused = true)]
async fn a_slow_line_costs_whole_revolutions() {
    let emulator = sensor(Model::Urg04lx).baud_rate(BaudRate::B115200).build();
    let mut link = emulator.link();
    link.set_baud_rate(BaudRate::B115200).unwrap();
    ask(&mut link, "MD0044072501000").await;
    for _ in 0..20 {
        assert_eq!(listen(&mut link).await.len(), 2137);
    }
    let sent = emulator.sent_scans();
    assert!(sent.windows(2).all(|two| two[1].time.revolution == two[0].time.revolution + 2));
}

#[tokio::test(start_paused = true)]
async fn a_new_connection_begins_with_a_new_line() {
    for (model, reply) in [(Model::Utm30lx, "BQT\n0Ee\n\n"), (Model::Ust10lx, "QT\n00P\n\n")] {
        let emulator = sensor(model).build();
        let mut link = emulator.link();
        link.write_all(b"B").await.unwrap();
        sleep(MS).await;
        drop(link);
        assert_eq!(ask(&mut emulator.link(), "QT").await, reply);
    }
}
