//! Rows W: damage to the bytes of replies. `bytes` has damage at each single place.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
use tokio::time::Instant;
use tokio_scip::protocol::MalformedError;
use tokio_scip::{ErrorKind, Rate, State, Window};
use urg_emulator::{EmptyCommand, Fault, Faults, Mode};

use super::rig::{instant_sensor, scans, second_poll, streaming, wrong_scans};
use crate::common::{builder, ms};

const WINDOW: Window = Window::DETECTION;

#[test]
fn w03_consecutive_fences_differ_in_two_bytes() {
    for step in 0..769 {
        let [one, next] = [step, (step + 1) % 769].map(|n| format!("G{n:03}{n:03}01"));
        let differing = one.bytes().zip(next.bytes()).filter(|(a, b)| a != b).count();
        assert!(differing >= 2, "{one} and {next}");
    }
}

#[tokio::test(start_paused = true)]
async fn w05_a_lost_status_line_is_not_accepted() {
    // The status; the status and the LF after it; the LF before it and the status.
    for lost in [10..11, 10..12, 9..11] {
        let outcome = second_poll(WINDOW, &[Fault::Drop(lost.clone())]).await;
        assert!(!outcome.accepted, "without {lost:?}");
        assert!(matches!(
            outcome.errors[..],
            [ErrorKind::Malformed { .. } | ErrorKind::Timeout { .. }]
        ));
        if lost == (10..11) {
            assert!(outcome.stats.bytes_skipped > 1300, "the data are not skipped");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn w10_a_whole_lost_line_is_detected() {
    // The second poll asks for one step more: 64 points, two lines of 64 bytes.
    let window = Window::new(301..=363).unwrap();
    for line in [12..77, 77..142] {
        for fault in [Fault::Drop(line.clone()), Fault::Repeat(line.clone())] {
            let outcome = second_poll(window, std::slice::from_ref(&fault)).await;
            assert!(!outcome.accepted && outcome.errors.len() == 1, "{fault:?}: {outcome:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn w14_merged_replies_cost_one_scan() {
    let outcome = second_poll(WINDOW, &[Fault::Merged]).await;
    assert!(!outcome.accepted && outcome.errors.len() == 1);
    // One was sent at opening, and one had its reply recognised after the merged replies.
    assert_eq!((outcome.stats.fences, outcome.stats.fence_timeouts), (2, 0));
}

#[tokio::test(start_paused = true)]
async fn w16_w18_a_scan_may_arrive_bytewise() {
    use crate::common::faulty_link::FaultyLink;
    let emulator = instant_sensor().build();
    let link = FaultyLink::new(emulator.link()).short_reads(1).partial_writes(1);
    let sensor = builder().attach(link).await.unwrap();
    let scan = sensor.scan(Window::FULL).await.unwrap();
    assert_eq!(wrong_scans(&emulator, &[scan]), [""; 0]);
    assert_eq!(sensor.stats().timeouts, 0);
}

#[tokio::test(start_paused = true)]
async fn w17_unrequested_replies_before_the_right_one_are_not_accepted() {
    let few = b"L1\n0\n\nV\n0\nVEND:x\n\nG00000001\n0\n00\n\n\n\nG04472501\n6\n\n";
    // The reply has as many points as the second poll, with another echo.
    let lines = ("0".repeat(64) + "\n").repeat(21) + &"0".repeat(22);
    let alike = format!("G04272401\n0\n{lines}\n\n");
    for others in [&few[..], alike.as_bytes()] {
        let outcome = second_poll(WINDOW, &[Fault::Garbage(others.to_vec())]).await;
        assert!(!outcome.accepted, "{outcome:?}");
        let [ErrorKind::Malformed { source: MalformedError::Echo { found }, .. }] =
            &outcome.errors[..]
        else {
            panic!("{outcome:?}")
        };
        assert!(others.starts_with(found.as_bytes()), "{found}");
        assert!(outcome.stats.malformed.echo >= 1);
        // The right reply is dropped, too: the poll has failed before it arrives.
        assert!(outcome.stats.bytes_skipped >= others.len() as u64);
        assert_eq!(outcome.stats.fences, 2);
    }
}

#[tokio::test(start_paused = true)]
async fn w01_w18_a_damaged_echo_costs_one_poll() {
    let faults = [
        Fault::Drop(4..5),
        Fault::Insert(4, b"7".to_vec()),
        Fault::Flip(4, 1),
        Fault::Garbage(b"garbage".to_vec()),
        Fault::Garbage(b"garbage\n".to_vec()),
        Fault::Garbage(vec![b'x'; 5000]),
    ];
    for fault in faults {
        let emulator = instant_sensor().build();
        let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
        scans(&mut stream, 1).await;
        emulator.set_faults(Faults::none().at(0, fault.clone()));
        let start = Instant::now();
        let error = stream.next().await.unwrap().unwrap_err();
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(source.contains("expected") || source.contains("two LFs"), "{fault:?}: {source}");
        scans(&mut stream, 1).await;
        // Malformed at the poll that is due after 100 ms, a whole scan at the next one.
        assert!(start.elapsed() <= ms(250), "{fault:?}: {:?}", start.elapsed());
        assert_eq!(sensor.stats().timeouts, 0, "{fault:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn w18_garbage_in_front_costs_one_scan() {
    for length in (0..70).chain((127..4096).step_by(127)).chain([4095, 4096]) {
        let nuls = second_poll(WINDOW, &[Fault::Garbage(vec![0; length])]).await;
        assert!(nuls.accepted && nuls.stats.fences == 1, "{length} NULs: {nuls:?}");
        let noise = second_poll(WINDOW, &[Fault::Garbage(vec![b'x'; length])]).await;
        assert_eq!(noise.accepted, length == 0, "{length} bytes of garbage");
        let skipped = noise.stats.bytes_skipped >= length as u64;
        assert!(length == 0 || skipped && noise.errors.len() == 1, "{length}: {noise:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn w18_noise_of_any_kind_in_front_never_makes_a_scan() {
    let mut fired = 0;
    for seed in 0..100 {
        let emulator = instant_sensor().seed(seed).build();
        let (_sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
        let mut delivered = scans(&mut stream, 1).await;
        emulator.set_faults(Faults::none().up_to(0.5, Fault::Noise(4096)).seed(seed));
        delivered.extend(scans(&mut stream, 10).await);
        assert_eq!(wrong_scans(&emulator, &delivered), [""; 0], "seed {seed}");
        fired += emulator.fault_count(&Fault::Noise(0));
    }
    assert!(fired > 300, "{fired}");
}

/// Streams, then repeats `pattern` without an end until the link is closed, and asserts
/// that scans come again when the pattern stops. Returns the time until the link closed.
async fn endless(pattern: &[u8]) -> Duration {
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
    scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().at(0, Fault::Endless(pattern.to_vec())));
    let start = Instant::now();
    let mut state = sensor.watch_state();
    let closed = state.wait_for(|state| matches!(state, State::Disconnected { .. }));
    let lost = tokio::time::timeout(Duration::from_secs(10), closed).await;
    // Cloned at once, because `wait_for` returns a lock on the state.
    let lost = lost.expect("the link stays open").unwrap().clone();
    let State::Disconnected { error, .. } = lost else { unreachable!() };
    let ErrorKind::Disconnected { source: Some(source), .. } = error.kind() else {
        panic!("{error:?}")
    };
    assert!(source.to_string().contains("expected at most 64 KiB"), "{source}");
    let took = start.elapsed();
    tokio::time::sleep(Duration::from_secs(60)).await;
    emulator.set_faults(Faults::none());
    let start = Instant::now();
    loop {
        if stream.next().await.unwrap().is_ok_and(|scan| scan.times().requested_at > start) {
            break;
        }
    }
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    took
}

#[tokio::test(start_paused = true)]
async fn w19_endless_garbage_ends_the_link_after_64_kib() {
    // 64 KiB take 175 ms on USB, and the next poll is due 100 ms after the last.
    assert!(endless(b"x").await <= ms(100 + 175 + 20));
    assert!(endless(b"G04472501\n0\n").await <= ms(100 + 175 + 20));
}

#[tokio::test(start_paused = true)]
async fn w20_endless_line_feeds_end_the_link_after_64_frames() {
    assert!(endless(b"\n").await <= ms(100 + 20));
    assert!(endless(b"G04472501\n6\n\n\n\n").await <= ms(100 + 175 + 20));
}

#[tokio::test(start_paused = true)]
async fn w21_telnet_bytes_are_reported_with_a_hint_at_raw_mode() {
    let (near, mut far) = duplex(256);
    let _server = tokio::spawn(async move {
        let mut byte = [0];
        // DO SUPPRESS-GO-AHEAD, then silence.
        far.write_all(&[0xff, 0xfd, 0x03]).await.unwrap();
        while far.read(&mut byte).await.is_ok_and(|read| read > 0) {}
    });
    let error = builder().attach(near).await.unwrap_err();
    let source = std::error::Error::source(&error).unwrap().to_string();
    assert!(source.contains("raw mode"), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn w24_d05_d06_a_sensor_that_changes_its_protocol_is_followed() {
    for mode in [Mode::Scip2, Mode::Scip2Streaming] {
        for empty in [EmptyCommand::Silence, EmptyCommand::Status, EmptyCommand::LineFeeds] {
            let emulator = instant_sensor().empty_command(empty).build();
            let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
            scans(&mut stream, 1).await;
            assert_eq!(*sensor.geometry().await.unwrap().distances().end(), 4094);
            emulator.set_mode(mode);
            let end = Instant::now() + Duration::from_secs(5);
            while let Ok(item) = tokio::time::timeout_at(end, stream.next()).await {
                drop(item.unwrap());
            }
            assert_eq!(*sensor.geometry().await.unwrap().distances().end(), 5600, "{mode:?}");
            emulator.power_cycle();
            scans(&mut stream, 20).await;
            assert_eq!(*sensor.geometry().await.unwrap().distances().end(), 4094, "{mode:?}");
        }
    }
}
