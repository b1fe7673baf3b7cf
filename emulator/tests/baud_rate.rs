//! Baud rates, and links whose two ends have different ones.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, sleep};
use tokio_scip::BaudRate;
use tokio_scip::port::Port;
use urg_emulator::{Emulator, Pace};

use super::{ask, instant_sensor, listen, listen_bytes};

const MS: Duration = Duration::from_millis(1);

fn serial(baud_rate: BaudRate) -> Emulator {
    instant_sensor().baud_rate(baud_rate).build()
}

#[tokio::test(start_paused = true)]
async fn a_link_has_no_baud_rate_on_usb() {
    let mut link = serial(BaudRate::B750000).link();
    assert_eq!(link.baud_rate(), Some(BaudRate::B19200));
    link.set_baud_rate(BaudRate::B750000).unwrap();
    assert_eq!(link.baud_rate(), Some(BaudRate::B750000));
    let mut usb = instant_sensor().build().link();
    assert_eq!(usb.baud_rate(), None);
    usb.set_baud_rate(BaudRate::B115200).unwrap();
    assert_eq!(usb.baud_rate(), None);
    assert_eq!(ask(&mut usb, "L0").await, "L0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn at_a_wrong_baud_rate_the_sensor_receives_no_command() {
    for baud_rate in &BaudRate::ALL[1..] {
        let emulator = serial(*baud_rate);
        let mut link = emulator.link();
        link.write_all(b"L0\nL0\nL0\n").await.unwrap();
        assert_ne!(listen_bytes(&mut link).await, b"L0\n0\n\n");
        assert!(emulator.is_laser_on(), "{baud_rate}");
        assert_eq!(emulator.counts().malformed, 0, "garbled lines are counted apart");
        link.set_baud_rate(*baud_rate).unwrap();
        link.write_all(b"\n").await.unwrap();
        listen_bytes(&mut link).await;
        assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
    }
}

#[tokio::test(start_paused = true)]
async fn at_a_wrong_baud_rate_the_host_reads_no_reply() {
    for sensor in BaudRate::ALL {
        for host in BaudRate::ALL.into_iter().filter(|host| *host != sensor) {
            let emulator = instant_sensor().baud_rate(sensor).latency(10 * MS).build();
            let mut link = emulator.link();
            link.set_baud_rate(sensor).unwrap();
            link.write_all(b"V\n").await.unwrap();
            // The command has arrived, and its reply has not begun.
            sleep(5 * MS).await;
            link.set_baud_rate(host).unwrap();
            let received = listen_bytes(&mut link).await;
            assert!(!received.starts_with(b"V\n0\nVEND:"), "{sensor} {host}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn an_accepted_baud_rate_applies_later() {
    let emulator = serial(BaudRate::B19200);
    let mut link = emulator.link();
    let start = Instant::now();
    assert_eq!(ask(&mut link, "S1152000000000").await, "S1152000000000\n0\n\n");
    link.set_baud_rate(BaudRate::B115200).unwrap();
    // 15 bytes took 7.8 ms; the revolution begins then.
    sleep(100 * MS - start.elapsed()).await;
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B19200));
    assert_eq!(link.read_u8().await.unwrap(), 0);
    assert!((107..=109).contains(&start.elapsed().as_millis()), "{:?}", start.elapsed());
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200));
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn the_stray_byte_can_be_left_out() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).stray_byte(false).build();
    let mut link = emulator.link();
    ask(&mut link, "S5000000000000").await;
    link.set_baud_rate(BaudRate::B500000).unwrap();
    assert_eq!(listen(&mut link).await, "");
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B500000));
}

#[tokio::test(start_paused = true)]
async fn an_early_command_is_served_after_the_change() {
    let mut link = serial(BaudRate::B19200).link();
    link.write_all(b"S0576000000000\nL0\n").await.unwrap();
    assert_eq!(listen(&mut link).await, "S0576000000000\n0\n\n");
    link.set_baud_rate(BaudRate::B57600).unwrap();
    assert_eq!(listen(&mut link).await, "\0L0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn a_baud_rate_survives_the_link() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).stray_byte(false).build();
    ask(&mut emulator.link(), "S2500000000000").await;
    sleep(200 * MS).await;
    let mut link = emulator.link();
    link.set_baud_rate(BaudRate::B250000).unwrap();
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
    emulator.power_cycle();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B19200));
    assert!(emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn a_bridge_keeps_its_own_baud_rate() {
    let emulator = serial(BaudRate::B19200);
    let mut link = emulator.bridge(BaudRate::B19200);
    assert_eq!(link.baud_rate(), Some(BaudRate::B19200));
    assert!(link.set_baud_rate(BaudRate::B57600).is_err());
    assert_eq!(ask(&mut link, "S0576000000000").await, "S0576000000000\n0\n\n");
    sleep(200 * MS).await;
    link.write_all(b"V\n").await.unwrap();
    assert!(!listen_bytes(&mut link).await.starts_with(b"V\n"));
    emulator.power_cycle();
    let mut link = emulator.bridge(BaudRate::B19200);
    while !listen_bytes(&mut link).await.is_empty() {}
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn a_change_of_baud_rate_waits_for_the_motor_too() {
    let emulator =
        Emulator::builder().baud_rate(BaudRate::B19200).pace(Pace::PerRevolution).build();
    let mut link = emulator.link();
    let start = Instant::now();
    ask(&mut link, "S5000000000000").await;
    link.set_baud_rate(BaudRate::B500000).unwrap();
    assert_eq!(link.read_u8().await.unwrap(), 0);
    assert!((200..=202).contains(&start.elapsed().as_millis()), "{:?}", start.elapsed());
}
