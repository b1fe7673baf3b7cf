//! Faults on demand.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, sleep};
use tokio_scip::BaudRate;
use urg_emulator::{Emulator, Fault, Faults};

use super::{ask, instant_sensor, listen, listen_bytes};

const S: Duration = Duration::from_secs(1);

/// Returns the bytes that arrive for `L0` if its reply, `L0\n0\n\n`, has the fault.
async fn l0_with(fault: Fault) -> Vec<u8> {
    let emulator = instant_sensor().faults(Faults::none().at(0, fault.clone())).build();
    let mut link = emulator.link();
    link.write_all(b"L0\n").await.unwrap();
    let mut received = listen_bytes(&mut link).await;
    received.extend(listen_bytes(&mut link).await);
    assert_eq!(emulator.fault_count(&fault), 1);
    received
}

#[tokio::test(start_paused = true)]
async fn each_fault_leaves_the_bytes_that_its_name_says() {
    for (fault, received) in [
        (Fault::CommandLost, &b""[..]),
        (Fault::Lost, b""),
        (Fault::Late(2 * S), b"L0\n0\n\n"),
        (Fault::Doubled, b"L0\n0\n\nL0\n0\n\n"),
        (Fault::Drop(1..2), b"L\n0\n\n"),
        (Fault::Drop(4..9), b"L0\n0"),
        (Fault::Drop(8..9), b"L0\n0\n\n"),
        (Fault::Insert(2, vec![0xFF]), b"L0\xFF\n0\n\n"),
        (Fault::Insert(6, vec![0xFF]), b"L0\n0\n\n\xFF"),
        (Fault::Insert(7, vec![0xFF]), b"L0\n0\n\n"),
        (Fault::Flip(3, 0x01), b"L0\n1\n\n"),
        (Fault::Flip(6, 0x01), b"L0\n0\n\n"),
        (Fault::Repeat(0..3), b"L0\nL0\n0\n\n"),
        (Fault::Cut(4), b"L0\n0"),
        (Fault::Merged, b"L0\n0\n"),
        (Fault::Garbage(b"\0\0".to_vec()), b"\0\0L0\n0\n\n"),
        (Fault::Pause(3, 5 * S), b"L0\n0\n\n"),
        (Fault::Trickle(S), b"L0\n0\n\n"),
        (Fault::CrLf, b"L0\r\n0\r\n\r\n"),
        (Fault::Status(b'~'), b"L0\n~\n\n"),
        (Fault::Reset(2), b"L0"),
        (Fault::HangUp(9), b"L0\n0\n\n"),
    ] {
        assert_eq!(l0_with(fault.clone()).await, received, "{fault:?}");
    }
    assert_eq!(l0_with(Fault::Noise(7)).await.len(), 13);
}

#[tokio::test(start_paused = true)]
async fn a_lost_command_has_no_effect() {
    for (fault, laser) in
        [(Fault::Lost, false), (Fault::CommandLost, true), (Fault::Status(b'9'), true)]
    {
        let emulator = instant_sensor().faults(Faults::none().at(0, fault)).build();
        ask(&mut emulator.link(), "L0").await;
        assert_eq!(emulator.is_laser_on(), laser);
    }
}

#[tokio::test(start_paused = true)]
async fn faults_affect_only_their_replies() {
    let faults = Faults::none().at(1, Fault::Lost).at(3, Fault::Status(b'8'));
    let emulator = instant_sensor().faults(faults).build();
    let mut link = emulator.link();
    for reply in ["L1\n2\n\n", "", "L1\n2\n\n", "L1\n8\n\n", "L1\n2\n\n"] {
        assert_eq!(ask(&mut link, "L1").await, reply);
    }
    let counts = [Fault::Lost, Fault::Status(0)].map(|fault| emulator.fault_count(&fault));
    assert_eq!(counts, [1, 1]);
    emulator.set_faults(Faults::none().every(Fault::Lost));
    assert_eq!(ask(&mut link, "L1").await, "");
    assert_eq!(ask(&mut link, "L1").await, "");
    emulator.set_faults(Faults::none());
    assert_eq!(ask(&mut link, "L1").await, "L1\n2\n\n");
    assert_eq!(emulator.fault_count(&Fault::Lost), 3);
}

#[tokio::test(start_paused = true)]
async fn a_late_reply_delays_those_behind_it() {
    let emulator = instant_sensor().faults(Faults::none().at(0, Fault::Late(3 * S))).build();
    let mut link = emulator.link();
    let start = Instant::now();
    link.write_all(b"L0\n").await.unwrap();
    sleep(S).await;
    link.write_all(b"L1\n").await.unwrap();
    assert_eq!(listen(&mut link).await, "L0\n0\n\n");
    assert_eq!(start.elapsed().as_millis() / 10, 300);
    assert_eq!(listen(&mut link).await, "L1\n0\n\n");
    assert_eq!(start.elapsed().as_millis() / 10, 300);
}

#[tokio::test(start_paused = true)]
async fn a_trickle_and_a_pause_delay_the_reply() {
    let faults = Faults::none().at(0, Fault::Trickle(S / 10)).at(1, Fault::Pause(5, 2 * S));
    let mut link = instant_sensor().faults(faults).build().link();
    let start = Instant::now();
    ask(&mut link, "L0").await;
    assert_eq!(start.elapsed().as_millis() / 10, 60);
    link.write_all(b"L1\n").await.unwrap();
    let mut part = [0; 5];
    link.read_exact(&mut part).await.unwrap();
    assert_eq!((&part, start.elapsed().as_millis() / 10), (b"L1\n0\n", 60));
    assert_eq!(link.read_u8().await.unwrap(), b'\n');
    assert_eq!(start.elapsed().as_millis() / 10, 260);
}

#[tokio::test(start_paused = true)]
async fn a_reset_restores_baud_rate_and_laser() {
    let baud_rate = BaudRate::B115200;
    for after in 0..=1399 {
        let emulator = instant_sensor()
            .baud_rate(baud_rate)
            .boot_time(S)
            .laser(false)
            .faults(Faults::none().at(1, Fault::Reset(after)))
            .build();
        let mut link = emulator.link();
        link.set_baud_rate(baud_rate).unwrap();
        sleep(S).await;
        assert_eq!(ask(&mut link, "L1").await, "L1\n0\n\n");
        link.write_all(b"G04472501\n").await.unwrap();
        let mut part = vec![0; after];
        link.read_exact(&mut part).await.unwrap();
        // It is silent while it starts, then answers at another baud rate.
        link.write_all(b"V\n").await.unwrap();
        sleep(2 * S).await;
        assert_eq!(emulator.baud_rate(), Some(BaudRate::B19200));
        assert!(emulator.is_laser_on());
        link.set_baud_rate(BaudRate::B19200).unwrap();
        assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n", "after {after}");
        assert_eq!((emulator.counts().resets, emulator.fault_count(&Fault::Reset(0))), (1, 1));
    }
}

#[tokio::test(start_paused = true)]
async fn a_hang_up_ends_the_link_after_its_byte() {
    let emulator = instant_sensor().faults(Faults::none().at(0, Fault::HangUp(4))).build();
    let mut link = emulator.link();
    link.write_all(b"L0\n").await.unwrap();
    let mut received = Vec::new();
    link.read_to_end(&mut received).await.unwrap();
    assert_eq!(received, b"L0\n0");
    assert_eq!(link.read(&mut [0; 8]).await.unwrap(), 0);
    assert!(link.write_all(b"V\n").await.is_err());
    assert!(!emulator.is_connected());
    // A new link reaches the same sensor.
    assert_eq!(ask(&mut emulator.link(), "L0").await, "L0\n2\n\n");
}

#[tokio::test(start_paused = true)]
async fn endless_bytes_go_on_until_the_faults_change() {
    let faults = Faults::none().at(0, Fault::Endless(b"\n\n".to_vec()));
    let emulator = instant_sensor().baud_rate(BaudRate::B750000).faults(faults).build();
    let mut link = emulator.link();
    link.set_baud_rate(BaudRate::B750000).unwrap();
    link.write_all(b"V\n").await.unwrap();
    let start = Instant::now();
    let mut flood = vec![0; 1_000_000];
    link.read_exact(&mut flood).await.unwrap();
    assert!(flood.iter().all(|&byte| byte == b'\n'));
    // 75 kB/s, the rate of the line.
    assert!((12..20).contains(&start.elapsed().as_secs()), "{:?}", start.elapsed());
    emulator.set_faults(Faults::none());
    let mut rest = Vec::new();
    let _ = tokio::time::timeout(S, link.read_to_end(&mut rest)).await;
    assert!(rest.len() < 20_000);
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn a_flood_that_is_not_read_is_not_buffered() {
    let faults = Faults::none().at(0, Fault::Endless(b"x".to_vec()));
    let emulator = instant_sensor().faults(faults).build();
    let mut link = emulator.link();
    link.write_all(b"V\n").await.unwrap();
    sleep(3600 * S).await;
    emulator.set_faults(Faults::none());
    let mut received = Vec::new();
    let _ = tokio::time::timeout(S, link.read_to_end(&mut received)).await;
    assert!((1000..20_000).contains(&received.len()), "{}", received.len());
}

/// Returns all bytes of 2,000 scans polled twice a second.
async fn polled(emulator: &Emulator) -> Vec<u8> {
    let mut link = emulator.link();
    let mut received = Vec::new();
    for _ in 0..2000 {
        if link.write_all(b"G38438401\n").await.is_err() {
            link = emulator.link();
        }
        let _ = tokio::time::timeout(S / 2, link.read_to_end(&mut received)).await;
    }
    received
}

#[tokio::test(start_paused = true)]
async fn random_faults_repeat_with_their_seed() {
    let spec = "late=0.05:3s,lost=0.05,command-lost=0.05,damaged=0.05,doubled=0.05,merged=0.05,\
                noise=0.05:64,pause=0.05:1s,reset=0.05,hang-up=0.05";
    let faults: Faults = spec.parse().unwrap();
    let mut received = Vec::new();
    for seed in [1, 1, 2] {
        let emulator = instant_sensor().faults(faults.clone()).seed(seed).build();
        let bytes = polled(&emulator).await;
        let counts = [
            Fault::Late(S),
            Fault::Lost,
            Fault::CommandLost,
            Fault::Damaged,
            Fault::Doubled,
            Fault::Merged,
            Fault::Noise(0),
            Fault::Pause(0, S),
            Fault::Reset(0),
            Fault::HangUp(0),
        ]
        .map(|fault| emulator.fault_count(&fault));
        assert!(counts.iter().all(|count| (60..=140).contains(count)), "{counts:?}");
        received.push((bytes, counts, emulator.counts()));
    }
    assert!(received[0] == received[1], "the same seed makes the same bytes");
    assert!(received[0].0 != received[2].0, "another seed makes other bytes");
}

#[tokio::test(start_paused = true)]
async fn faults_with_a_seed_do_not_depend_on_the_sensors() {
    let faults: Faults = "damaged=0.5,seed=7".parse().unwrap();
    let one = polled(&instant_sensor().faults(faults.clone()).seed(1).build()).await;
    let two = polled(&instant_sensor().faults(faults).seed(2).build()).await;
    assert!(one == two);
}

#[test]
fn a_text_parses_to_the_calls_it_stands_for() {
    let parsed: Faults = "late=0.01:3s, lost=0.005,noise=1:9,reset=0.1,seed=7".parse().unwrap();
    let called = Faults::none()
        .up_to(0.01, Fault::Late(3 * S))
        .up_to(0.005, Fault::Lost)
        .up_to(1.0, Fault::Noise(9))
        .up_to(0.1, Fault::Reset(1599))
        .seed(7);
    assert_eq!(parsed, called);
    let parsed: Faults = "ignored=0.5,wrong-sum=0.1,clock-jump=1:250ms".parse().unwrap();
    let called = Faults::none()
        .up_to(0.5, Fault::Ignored)
        .up_to(0.1, Fault::WrongSum)
        .up_to(1.0, Fault::ClockJump(250));
    assert_eq!(parsed, called);
    assert_eq!("".parse(), Ok(Faults::none()));
    let paused = Faults::none().up_to(1.0, Fault::Pause(63, Duration::from_millis(250)));
    assert_eq!("pause=1:250ms".parse(), Ok(paused));
    let jumps = Faults::none().up_to(1.0, Fault::ClockJump(i64::MAX));
    assert_eq!("clock-jump=1:1e17s".parse(), Ok(jumps));
}

#[test]
fn an_error_names_part_expectation_and_finding() {
    for (bad, reason) in [
        ("late", "expected a probability from 0 to 1 after `=`"),
        ("late=2", "expected a probability from 0 to 1, found 2"),
        ("lost=NaN", "expected a probability from 0 to 1, found NaN"),
        ("late=0.1:3", "expected a time such as 250ms or 3s after `:`, found `3`"),
        ("pause=0.1:-3s", "expected a time such as 250ms or 3s after `:`, found `-3s`"),
        (
            "noise=1:99999999999999",
            "expected a number of bytes up to 65536 after `:`, found `99999999999999`",
        ),
        ("noise=0.1:x", "expected a number of bytes up to 65536 after `:`, found `x`"),
        ("lost=0.1:3s", "lost takes no limit, found `:3s`"),
        ("seed=x", "expected seed=NUMBER, found `x`"),
    ] {
        let error = format!("lost=0.1,{bad}").parse::<Faults>().unwrap_err();
        assert_eq!(error.to_string(), format!("invalid fault `{bad}`: {reason}"));
    }
    let error = "lots=0.1".parse::<Faults>().unwrap_err().to_string();
    assert!(error.starts_with("invalid fault `lots=0.1`: unknown name `lots`, expected late,"));
}

#[tokio::test(start_paused = true)]
async fn random_damage_takes_every_form() {
    let mut lengths = std::collections::BTreeSet::new();
    for seed in 0..200 {
        let faults = Faults::none().every(Fault::Damaged).seed(seed);
        let mut link = instant_sensor().faults(faults).build().link();
        link.write_all(b"L0\n").await.unwrap();
        let mut received = listen_bytes(&mut link).await;
        received.extend(listen_bytes(&mut link).await);
        assert_ne!(received, b"L0\n0\n\n");
        lengths.insert(received.len());
    }
    assert_eq!(lengths.into_iter().collect::<Vec<_>>(), (0..=7).collect::<Vec<_>>());
}

#[tokio::test(start_paused = true)]
async fn a_reply_pauses_at_each_place() {
    // In any order; a place past the end has no pause.
    let pauses = [(4, S), (1, 2 * S), (9, S)];
    let add = |faults: Faults, (at, pause)| faults.at(0, Fault::Pause(at, pause));
    let faults = pauses.into_iter().fold(Faults::none(), add);
    let mut link = instant_sensor().faults(faults).build().link();
    let start = Instant::now();
    link.write_all(b"L0\n").await.unwrap();
    let mut arrived = Vec::new();
    for _ in 0..6 {
        link.read_u8().await.unwrap();
        arrived.push(start.elapsed().as_secs());
    }
    assert_eq!(arrived, [0, 2, 2, 2, 3, 3]);
}
