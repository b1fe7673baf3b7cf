//! Rows D: a sensor that restarts, refuses commands, or is not the same one.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::protocol::MalformedError;
use tokio_scip::{BaudRate, ErrorKind, Measurement, Rate, Window};
use urg_emulator::{EmptyCommand, Emulator, Fault, Faults, Firmware, Fixed, Verdict};

use super::rig::{instant_sensor, open, scans, streaming, wrong_scans};
use crate::common::{builder, ms, reply_len, request_of};

const WINDOW: Window = Window::DETECTION;

#[tokio::test(start_paused = true)]
async fn d01_a_reset_in_a_reply_is_detected() {
    let window = Window::new(300..=360).unwrap();
    for at in 0..=reply_len(window) {
        let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
        let sensor =
            builder().baud_rate(BaudRate::B115200).connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
        let mut delivered = scans(&mut stream, 1).await;
        emulator.set_faults(Faults::none().at(0, Fault::Reset(at)));
        let start = Instant::now();
        while emulator.counts().resets == 0 {
            delivered.extend(stream.next().await.unwrap());
        }
        delivered.extend(scans(&mut stream, 3).await);
        assert!(start.elapsed() < Duration::from_secs(5), "byte {at}: {:?}", start.elapsed());
        assert_eq!(wrong_scans(&emulator, &delivered), [""; 0], "byte {at}");
        assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200), "byte {at}");
        assert_eq!(sensor.stats().reconnects, 1, "byte {at}: the reset is not counted");
    }
}

#[tokio::test(start_paused = true)]
async fn d02_a_reset_laser_is_switched_off_again() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
    let sensor = builder().baud_rate(BaudRate::B115200).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    scans(&mut stream, 1).await;
    sensor.laser_off().await.unwrap();
    for _ in 0..5 {
        emulator.power_cycle();
        assert!(emulator.is_laser_on());
        // The next request finds the sensor at another baud rate.
        while sensor.set_baud_rate(BaudRate::B57600).await.is_err() {}
        while sensor.set_baud_rate(BaudRate::B115200).await.is_err() {}
        assert!(!emulator.is_laser_on());
        tokio::time::sleep(Duration::from_secs(5)).await;
    }
    let polls = emulator.log().into_iter().filter(|line| line.line == b"G04472501");
    let count = polls.count() as u64;
    assert!(count <= sensor.stats().polls, "polled while the laser was off");
    sensor.laser_on().await.unwrap();
    scans(&mut stream, 2).await;
}

#[tokio::test(start_paused = true)]
async fn d02_a_hidden_restart_leaves_the_laser_off() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    sensor.laser_off().await.unwrap();
    emulator.power_cycle();
    assert!(emulator.is_laser_on());
    // A restarted sensor has this baud rate, too.
    sensor.set_baud_rate(BaudRate::B19200).await.unwrap();
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn d03_an_hour_without_power_costs_few_attempts() {
    // The port stays open: the adapter has power, the sensor does not.
    let emulator = instant_sensor().baud_rate(BaudRate::B115200).build();
    let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
    scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().every(Fault::CommandLost));
    let before = (emulator.counts().commands, sensor.stats());
    tokio::time::sleep(Duration::from_secs(3600)).await;
    // One fence at each baud rate takes 400 ms.
    let commands = emulator.counts().commands - before.0;
    assert!(commands <= 2 * 3600 * 10 / 4 + 100, "{commands} commands");
    assert_eq!(sensor.stats().disconnects, 1);
    let mut errors = 0;
    while let Ok(item) = tokio::time::timeout(ms(100), stream.next()).await {
        errors += usize::from(item.unwrap().is_err());
    }
    assert!(errors <= 2, "{errors}");
    emulator.set_faults(Faults::none());
    let start = Instant::now();
    scans(&mut stream, 1).await;
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn d04_a_sensor_that_restarts_repeatedly_is_recovered() {
    for period in [ms(150), ms(700), ms(1900)] {
        let emulator = instant_sensor().baud_rate(BaudRate::B19200).boot_time(ms(100)).build();
        let sensor =
            builder().baud_rate(BaudRate::B115200).connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
        let mut delivered = scans(&mut stream, 1).await;
        let end = Instant::now() + Duration::from_secs(120);
        let mut next = Instant::now();
        let mut errors = 0;
        while next < end {
            emulator.power_cycle();
            next += period;
            while let Ok(item) = tokio::time::timeout_at(next, stream.next()).await {
                match item.unwrap() {
                    Ok(scan) => delivered.push(scan),
                    Err(_) => errors += 1,
                }
            }
        }
        let start = Instant::now();
        delivered.extend(scans(&mut stream, 3).await);
        assert!(start.elapsed() < Duration::from_secs(6), "{period:?}: {:?}", start.elapsed());
        // A restart loses commands that had arrived, so the numbers show only the order of
        // the replies.
        let numbers: Vec<_> = delivered.iter().map(|scan| request_of(scan).unwrap()).collect();
        assert!(numbers.is_sorted_by(|a, b| a < b), "{period:?}: {numbers:?}");
        assert!(errors <= 3 * delivered.len().max(1), "{period:?}: {errors} errors");
    }
}

#[tokio::test(start_paused = true)]
async fn d07_any_refusal_leaves_the_link_clean() {
    let emulator = instant_sensor().build();
    let sensor = open(&emulator).await;
    for status in (0x21..=0x7e).filter(|status| *status != b'0') {
        // The poll, and the one after the laser was confirmed to be on; or one poll while
        // the next attempt is not due yet.
        let fault = Fault::Status(status);
        emulator.set_faults(Faults::none().at(0, fault.clone()).at(3, fault));
        let error = sensor.scan(WINDOW).await.unwrap_err();
        let ErrorKind::Refused { status: found, .. } = error.kind() else { panic!("{error:?}") };
        assert_eq!(found.as_bytes(), [status]);
        let meaning = match status {
            b'6' => "'6': the laser is off",
            b'E' => "'E': the sensor does not know the command",
            _ => "'",
        };
        assert!(error.to_string().ends_with(meaning), "{error}");
    }
    let stats = sensor.stats();
    assert_eq!(stats.fence_timeouts, 0);
    // One at opening, one that confirmed the laser: the paused clock does not advance.
    assert_eq!(stats.fences, 2, "a refused command raised a fence");
}

#[tokio::test(start_paused = true)]
async fn d13_a_poll_refused_with_any_status_switches_the_laser_on() {
    for status in [b'1', b'5', b'6', b'E'] {
        let emulator = instant_sensor().build();
        let sensor = open(&emulator).await;
        emulator.set_faults(Faults::none().at(0, Fault::Status(status)));
        sensor.scan(WINDOW).await.unwrap();
        let stats = sensor.stats();
        assert_eq!((stats.refused, stats.scans), (1, 1));
    }
}

/// Returns a sensor that answers each command but `V` at once with what `reply` returns.
fn peer(reply: impl Fn(&str) -> &'static str + Send + 'static) -> tokio::io::DuplexStream {
    use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, duplex, split};
    let (near, far) = duplex(4096);
    tokio::spawn(async move {
        let (read, mut write) = split(far);
        let mut commands = BufReader::new(read).lines();
        while let Ok(Some(command)) = commands.next_line().await {
            let reply = if command == "V" { "0\nSERI:H0713090" } else { reply(&command) };
            if !command.is_empty() {
                write.write_all(format!("{command}\n{reply}\n\n").as_bytes()).await.unwrap();
            }
        }
    });
    near
}

#[tokio::test(start_paused = true)]
async fn d14_a_stubborn_laser_is_reported_and_retried() {
    for (answer, refusal) in [("2", "6"), ("0", "6"), ("1", "5")] {
        let sent = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&sent);
        let sensor = builder()
            .attach(peer(move |command| {
                count.fetch_add(usize::from(command == "L1"), Ordering::Relaxed);
                if command.starts_with('G') { refusal } else { answer }
            }))
            .await
            .unwrap();
        let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
        let mut errors = Vec::new();
        let end = Instant::now() + Duration::from_secs(5);
        while let Ok(item) = tokio::time::timeout_at(end, stream.next()).await {
            errors.extend(item.unwrap().err());
        }
        let [error] = &errors[..] else { panic!("{errors:?}") };
        let text = error.to_string();
        for part in ["laser", &format!("'{answer}'"), &format!("'{refusal}'")] {
            assert!(text.contains(part), "{text}");
        }
        // It was sent after 0, 1 and 3 seconds, each twice where the status means success.
        assert!((3..=6).contains(&sent.load(Ordering::Relaxed)), "{sent:?}");
        assert!(sensor.stats().polls >= 50);
    }
}

#[tokio::test(start_paused = true)]
async fn d08_only_the_four_commands_are_sent() {
    for firmware in [Firmware::Text, Firmware::V3] {
        for empty in [EmptyCommand::Silence, EmptyCommand::Status, EmptyCommand::LineFeeds] {
            let emulator = instant_sensor()
                .firmware(firmware)
                .empty_command(empty)
                .baud_rate(BaudRate::B57600)
                .build();
            let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
            emulator.set_faults(Faults::none().rate(0.2, Fault::Damaged).rate(0.1, Fault::Lost));
            scans(&mut stream, 20).await;
            let _ = sensor.laser_off().await;
            let _ = sensor.laser_on().await;
            let _ = sensor.set_baud_rate(BaudRate::B250000).await;
            scans(&mut stream, 5).await;
            let log = emulator.log();
            let odd = log.iter().find(|line| !line.garbled && line.verdict == Verdict::Malformed);
            assert_eq!(odd, None);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn d10_miscounted_points_are_malformed() {
    // A fence asks for one point, which is two characters.
    let two_points = MalformedError::LineLength { line: 0, expected: 2, found: 4 };
    for (miscount, told) in [(1, two_points), (-1, MalformedError::NoData)] {
        let error =
            builder().connect(instant_sensor().miscount(miscount).build()).await.unwrap_err();
        let ErrorKind::Malformed { source, .. } = error.kind() else {
            panic!("{miscount}: {error:?}")
        };
        assert_eq!(*source, told, "{miscount}");
    }
}

#[tokio::test(start_paused = true)]
async fn d11_odd_version_lines_prevent_no_scans() {
    let cases: [&[&str]; 5] = [
        &["VEND:x", "PROD:y"],
        &["WHAT: is this", "SERI: H1", "  ", "no colon at all"],
        &["SERI:", "SERI:H2"],
        &["STAT:only this"],
        &["VEND: a: b: c", "FIRM:(((1000[rpm]", "SERI:H3"],
    ];
    for lines in cases {
        let emulator = instant_sensor().version_lines(lines.iter().copied()).build();
        let sensor = open(&emulator).await;
        sensor.scan(WINDOW).await.unwrap();
        sensor.version().await.unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn d12_a_scan_of_error_codes_alone_is_delivered() {
    for code in 0..20 {
        let emulator = Emulator::builder().world(Fixed::filled(code)).build();
        let sensor = open(&emulator).await;
        let scan = sensor.scan(WINDOW).await.unwrap();
        let expected = scan.geometry().measurement(code);
        assert!(matches!(expected, Measurement::Error(_)), "{code}");
        assert!(scan.rays().all(|ray| ray.measurement == expected), "{code}");
        assert!(scan.ranges().all(|range| !range.is_finite()));
        assert_eq!(scan.points().count(), 0);
    }
}
