//! The handle by which a test controls the sensor.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::Instant;
use tokio_scip::ErrorKind;
use tokio_scip::port::Connect;
use urg_emulator::{Emulator, Verdict};

use super::{ask, instant_sensor, listen};

#[tokio::test(start_paused = true)]
async fn the_log_holds_the_last_commands_with_their_verdicts() {
    let emulator = instant_sensor().log_capacity(3).build();
    let mut link = emulator.link();
    let start = Instant::now();
    for command in ["V", "", "X", "G00000001"] {
        ask(&mut link, command).await;
    }
    let log = emulator.log();
    let lines: Vec<_> = log.iter().map(|entry| (&entry.line[..], entry.verdict)).collect();
    assert_eq!(
        lines,
        [
            (&b""[..], Verdict::Empty),
            (&b"X"[..], Verdict::Malformed),
            (&b"G00000001"[..], Verdict::WellFormed)
        ]
    );
    assert!(log.is_sorted_by_key(|entry| entry.at));
    assert!(log.iter().all(|entry| entry.at >= start && !entry.garbled && !entry.overlapping));
    let counts = emulator.counts();
    assert_eq!((counts.commands, counts.empty, counts.malformed), (4, 1, 1));
    assert_eq!((counts.scans, counts.replies, counts.overlapping), (1, 3, 0));
}

#[tokio::test(start_paused = true)]
async fn an_early_command_is_an_overlap() {
    let emulator = Emulator::default();
    let mut link = emulator.link();
    link.write_all(b"V\n").await.unwrap();
    tokio::time::sleep(Duration::from_millis(50)).await;
    link.write_all(b"L1\n").await.unwrap();
    listen(&mut link).await;
    listen(&mut link).await;
    assert_eq!(emulator.counts().overlapping, 1);
    assert!(emulator.log()[1].overlapping);
    // An LF that ends a half-typed command does not overlap with the next command.
    link.write_all(b"\nV\n").await.unwrap();
    listen(&mut link).await;
    assert_eq!(emulator.counts().overlapping, 1);
}

#[tokio::test(start_paused = true)]
async fn commands_beyond_the_input_buffer_are_lost() {
    let emulator = Emulator::default();
    let mut link = emulator.link();
    link.write_all(&b"L1\n".repeat(40)).await.unwrap();
    let mut replies = 0;
    while !listen(&mut link).await.is_empty() {
        replies += 1;
    }
    assert_eq!((replies, emulator.counts().overrun), (32, 8));
}

#[tokio::test(start_paused = true)]
async fn the_sensor_stays_as_it_is_between_links() {
    let emulator = instant_sensor().build();
    assert_eq!(ask(&mut emulator.link(), "L0").await, "L0\n0\n\n");
    assert_eq!(ask(&mut emulator.link(), "L0").await, "L0\n2\n\n");
    let mut link = emulator.link();
    link.write_all(b"L").await.unwrap();
    drop(link);
    assert_eq!(ask(&mut emulator.link(), "1").await, "L1\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn unread_bytes_wait_for_the_next_link() {
    let emulator = instant_sensor().build();
    emulator.link().write_all(b"V\n").await.unwrap();
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert!(listen(&mut emulator.link()).await.starts_with("V\n0\nVEND:"));
}

#[tokio::test(start_paused = true)]
async fn a_newer_link_hangs_up_the_older_one() {
    let emulator = instant_sensor().build();
    let mut old = emulator.link();
    let waiting = tokio::spawn(async move {
        let ended = old.read(&mut [0; 8]).await.unwrap();
        (ended, old)
    });
    tokio::task::yield_now().await;
    let mut new = emulator.link();
    let (ended, mut old) = waiting.await.unwrap();
    assert_eq!(ended, 0);
    assert!(old.write_all(b"V\n").await.is_err());
    drop(old);
    assert!(emulator.is_connected());
    assert_eq!(ask(&mut new, "L0").await, "L0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn connecting_needs_a_cable_and_a_free_port() {
    let emulator = instant_sensor().build();
    let mut connect = emulator.clone();
    let mut link = connect.connect().await.unwrap();
    assert!(matches!(connect.connect().await.unwrap_err().kind(), ErrorKind::Busy { .. }));

    let waiting = tokio::spawn(async move {
        let ended = link.read(&mut [0; 8]).await.unwrap();
        assert!(link.write_all(b"V\n").await.is_err());
        ended
    });
    tokio::task::yield_now().await;
    emulator.unplug();
    assert_eq!(waiting.await.unwrap(), 0);
    assert!(matches!(connect.connect().await.unwrap_err().kind(), ErrorKind::NoSuchPort { .. }));
    assert_eq!(emulator.link().read(&mut [0; 8]).await.unwrap(), 0);

    emulator.plug_in();
    emulator.set_serial_number("H0000001");
    let mut link = connect.connect().await.unwrap();
    assert!(ask(&mut link, "V").await.contains("SERI:H0000001\n"));
}

#[tokio::test(start_paused = true)]
async fn bytes_on_the_cable_are_lost_when_it_is_pulled() {
    let emulator = instant_sensor().build();
    emulator.link().write_all(b"V\n").await.unwrap();
    tokio::time::sleep(Duration::from_secs(1)).await;
    emulator.unplug();
    emulator.plug_in();
    assert_eq!(listen(&mut emulator.link()).await, "");
    // Neither do bytes that the sensor sends while the cable is off arrive later.
    let emulator = Emulator::default();
    emulator.link().write_all(b"V\n").await.unwrap();
    emulator.unplug();
    tokio::time::sleep(Duration::from_secs(1)).await;
    emulator.plug_in();
    assert_eq!(listen(&mut emulator.link()).await, "");
}

#[tokio::test(start_paused = true)]
async fn a_power_cycle_cuts_off_the_reply() {
    let emulator = instant_sensor().baud_rate(tokio_scip::BaudRate::B19200).laser(false).build();
    let mut link = emulator.link();
    link.write_all(b"V\n").await.unwrap();
    // Two bytes to the sensor and ten bytes back, 0.52 ms each.
    tokio::time::sleep(Duration::from_micros(12 * 521)).await;
    emulator.power_cycle();
    let received = listen(&mut link).await;
    assert!((9..=12).contains(&received.len()), "{received:?}");
    assert!(emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn unrequested_bytes_wake_a_reader() {
    let emulator = instant_sensor().build();
    let mut link = emulator.link();
    let reader = tokio::spawn(async move { listen(&mut link).await });
    tokio::task::yield_now().await;
    emulator.inject("99b\n\n");
    assert_eq!(reader.await.unwrap(), "99b\n\n");
}

#[test]
fn a_sensor_can_be_made_outside_a_runtime() {
    let emulator = Emulator::default();
    let link = emulator.link();
    emulator.power_cycle();
    assert!(emulator.is_laser_on());
    drop(link);
}

#[test]
fn handles_and_links_are_send_and_sync() {
    fn everywhere<T: Send + Sync + 'static>() {}
    everywhere::<Emulator>();
    everywhere::<urg_emulator::Link>();
}
