//! The times of replies.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, sleep, sleep_until};
use tokio_scip::BaudRate;
use urg_emulator::{
    Emulator, EmulatorBuilder, Fault, Faults, Fixed, Link, Model, Pace, Values, WorldTime,
};

use super::{ask, instant_sensor, listen};

const MS: Duration = Duration::from_millis(1);

/// Returns the time that bytes take at a baud rate: ten bits each.
fn wire_time(baud_rate: BaudRate, bytes: u32) -> Duration {
    Duration::from_secs(10) * bytes / u32::from(baud_rate)
}

/// Returns a sensor on USB, which serves one command a revolution.
fn turning(revolution: Duration) -> Emulator {
    Emulator::builder().revolution(revolution).world(Fixed::filled(1234)).build()
}

/// Returns the times after `start` of the first and the last byte of a reply.
async fn times(link: &mut Link, command: &str, start: Instant) -> (Duration, Duration) {
    link.write_all(format!("{command}\n").as_bytes()).await.unwrap();
    link.read_u8().await.unwrap();
    let first = start.elapsed();
    listen(link).await;
    (first, start.elapsed())
}

/// Reads a scan of the full window with as few reads as possible.
async fn scan(link: &mut Link) {
    link.write_all(b"G04472501\n").await.unwrap();
    let mut reply = [0; 1399];
    link.read_exact(&mut reply).await.unwrap();
    assert!(reply.starts_with(b"G04472501\n0\n") && reply.ends_with(b"\n\n"));
}

fn about(time: Duration, expected: Duration) -> bool {
    // Timers have a resolution of one millisecond, and are late but never early.
    time >= expected && time <= expected + 2 * MS
}

#[tokio::test(start_paused = true)]
async fn a_command_is_answered_when_the_next_revolution_begins() {
    let start = Instant::now();
    let mut link = turning(100 * MS).link();
    sleep(30 * MS).await;
    let (first, last) = times(&mut link, "G04472501", start).await;
    assert!(about(first, 100 * MS), "{first:?}");
    // 1,399 bytes at 375 kB/s.
    assert!(about(last, Duration::from_micros(103_700)), "{last:?}");
    sleep_until(start + 199 * MS).await;
    let (first, _) = times(&mut link, "V", start).await;
    assert!(about(first, 200 * MS), "{first:?}");
}

#[tokio::test(start_paused = true)]
async fn polling_back_to_back_delivers_one_scan_a_revolution() {
    for micros in [99_500, 100_000, 100_500] {
        let revolution = Duration::from_micros(micros);
        let emulator = turning(revolution);
        let mut link = emulator.link();
        let start = Instant::now();
        for _ in 0..1000 {
            scan(&mut link).await;
        }
        let (taken, expected) = (start.elapsed(), 1000 * revolution);
        assert!(taken >= expected && taken < expected + 10 * MS, "{taken:?}");
        assert_eq!(emulator.counts().overlapping, 0);
    }
}

#[tokio::test(start_paused = true)]
async fn the_first_scan_after_the_laser_is_switched_on_takes_one_revolution_more() {
    let start = Instant::now();
    let mut link = turning(100 * MS).link();
    assert!(about(times(&mut link, "L0", start).await.0, 100 * MS));
    // Two captures of real sensors: BM is answered after 98 ms, and the scan requested then after 189 ms.
    assert!(about(times(&mut link, "L1", start).await.0, 200 * MS));
    assert!(about(times(&mut link, "G04472501", start).await.0, 400 * MS));
    assert!(about(times(&mut link, "G04472501", start).await.0, 500 * MS));
    // Another command in between takes the time of the first.
    assert!(about(times(&mut link, "L0", start).await.0, 600 * MS));
    assert!(about(times(&mut link, "L1", start).await.0, 700 * MS));
    assert!(about(times(&mut link, "V", start).await.0, 800 * MS));
    assert!(about(times(&mut link, "G04472501", start).await.0, 900 * MS));
}

#[tokio::test(start_paused = true)]
async fn a_stream_that_switches_the_laser_on_begins_as_late() {
    let mut link = Emulator::builder().model(Model::Urg04lxUg01).build().link();
    let start = Instant::now();
    assert!(about(times(&mut link, "MD0044072501001", start).await.0, 100 * MS));
    link.read_u8().await.unwrap();
    assert!(about(start.elapsed(), 300 * MS), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn commands_that_come_together_are_served_one_a_revolution() {
    let emulator = turning(100 * MS);
    let mut link = emulator.link();
    let start = Instant::now();
    link.write_all(b"L0\nL1\nL2\n").await.unwrap();
    for (reply, at) in [("L0\n0\n\n", 100), ("L1\n0\n\n", 200), ("L2\n4\n\n", 300)] {
        assert_eq!(listen(&mut link).await, reply);
        assert!(about(start.elapsed(), at * MS), "{:?}", start.elapsed());
    }
    assert_eq!(emulator.counts().overlapping, 2);
}

#[tokio::test(start_paused = true)]
async fn a_scan_shows_the_revolution_finished_last() {
    let world = |time: WorldTime, codes: &mut Values| {
        assert_eq!(time.at, 100 * MS * (time.revolution as u32 + 1));
        codes.fill(100 + time.revolution as u32);
    };
    let mut link = Emulator::builder().world(world).build().link();
    let start = Instant::now();
    // Requested in revolution 4, answered when revolution 5 begins.
    sleep_until(start + 420 * MS).await;
    assert_eq!(ask(&mut link, "G00000001").await, "G00000001\n0\n1X\n\n");

    // At this pace it sends the distances in its memory at that moment.
    let mut link = Emulator::builder().pace(Pace::AtOnce).world(world).build().link();
    let start = Instant::now();
    sleep_until(start + 420 * MS).await;
    assert_eq!(ask(&mut link, "G00000001").await, "G00000001\n0\n1W\n\n");
    assert_eq!(ask(&mut link, "G00000001").await, "G00000001\n0\n1W\n\n");
    sleep_until(start + 501 * MS).await;
    assert_eq!(ask(&mut link, "G00000001").await, "G00000001\n0\n1X\n\n");
}

#[tokio::test(start_paused = true)]
async fn a_reply_takes_its_time_on_the_line() {
    // 1,576 bytes of ten bits each.
    for (baud_rate, micros) in [
        (BaudRate::B19200, 820_833),
        (BaudRate::B57600, 273_611),
        (BaudRate::B115200, 136_805),
        (BaudRate::B250000, 63_040),
        (BaudRate::B500000, 31_520),
        (BaudRate::B750000, 21_013),
    ] {
        let mut link = instant_sensor().baud_rate(baud_rate).build().link();
        link.set_baud_rate(baud_rate).unwrap();
        let start = Instant::now();
        let (first, last) = times(&mut link, "G00076801", start).await;
        // The ten bytes of the command precede it.
        let command = wire_time(baud_rate, 10);
        assert!(about(first, command + wire_time(baud_rate, 1)), "{baud_rate}: {first:?}");
        let expected = command + Duration::from_micros(micros);
        assert!(about(last, expected), "{baud_rate}: {last:?} for {expected:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_reply_longer_than_a_revolution_costs_whole_revolutions() {
    for (baud_rate, scans) in [(BaudRate::B19200, 125), (BaudRate::B115200, 500)] {
        let mut link =
            Emulator::builder().baud_rate(baud_rate).world(Fixed::filled(1)).build().link();
        link.set_baud_rate(baud_rate).unwrap();
        let start = Instant::now();
        for _ in 0..scans {
            ask(&mut link, "G04472501").await;
        }
        let taken = start.elapsed();
        assert!((99..=101).contains(&taken.as_secs()), "{baud_rate}: {taken:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn replies_come_in_order_behind_each_other() {
    let mut link = instant_sensor().baud_rate(BaudRate::B19200).build().link();
    let start = Instant::now();
    link.write_all(b"G00003101\nV\nL0\n").await.unwrap();
    assert!(listen(&mut link).await.starts_with("G"));
    assert!(listen(&mut link).await.starts_with("V"));
    assert_eq!(listen(&mut link).await, "L0\n0\n\n");
    // 10 bytes to the sensor; 78, 206 and 6 bytes back without a pause.
    assert!(about(start.elapsed(), wire_time(BaudRate::B19200, 300)), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn a_sensor_is_silent_while_it_starts() {
    let emulator = instant_sensor().boot_time(Duration::from_secs(3)).build();
    let mut link = emulator.link();
    sleep(2900 * MS).await;
    link.write_all(b"L0\nL").await.unwrap();
    sleep(200 * MS).await;
    // The restart also reverts the `L` from before.
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
    assert_eq!(emulator.counts().commands, 1);
    emulator.power_cycle();
    assert_eq!(ask(&mut link, "L0").await, "");
}

#[tokio::test(start_paused = true)]
async fn a_latency_is_added_to_every_reply() {
    let mut link = instant_sensor().latency(40 * MS).build().link();
    let (first, _) = times(&mut link, "V", Instant::now()).await;
    assert!(about(first, 40 * MS), "{first:?}");
}

#[tokio::test(start_paused = true)]
async fn five_thousand_sensors_run_on_one_thread() {
    let mut tasks = tokio::task::JoinSet::new();
    for seed in 0..5000 {
        let mut link = Emulator::builder().seed(seed).build().link();
        tasks.spawn(async move {
            scan(&mut link).await;
        });
    }
    assert_eq!(tasks.join_all().await.len(), 5000);
}

#[tokio::test(start_paused = true)]
async fn a_sent_scan_has_the_true_end_of_its_revolution() {
    let emulator = turning(100 * MS);
    let start = Instant::now();
    let mut link = emulator.link();
    sleep(30 * MS).await;
    scan(&mut link).await;
    sleep_until(start + 250 * MS).await;
    scan(&mut link).await;
    emulator.delay_motor(40 * MS);
    scan(&mut link).await;
    let sent = emulator.sent_scans();
    let times: Vec<_> = sent.iter().map(|scan| scan.revolution_end - start).collect();
    assert_eq!(times, [100 * MS, 300 * MS, 440 * MS]);
    for (scan, asked) in sent.iter().zip([30, 250, 303]) {
        assert!(about(scan.requested_at - start, asked * MS), "{:?}", scan.requested_at - start);
    }
}

#[tokio::test(start_paused = true)]
async fn a_reply_begins_with_a_usb_frame() {
    let start = Instant::now();
    let emulator = Emulator::builder()
        .revolution(Duration::from_micros(99_760))
        .frame(10 * MS)
        .world(Fixed::filled(1234))
        .build();
    let (first, _) = times(&mut emulator.link(), "G04472501", start).await;
    assert!(about(first, 100 * MS), "{first:?}");
    let truth = emulator.sent_scans()[0].revolution_end - start;
    assert_eq!(truth, Duration::from_micros(99_760));
}

#[tokio::test(start_paused = true)]
async fn a_drifting_motor_slows_until_power_cycled() {
    let emulator = Emulator::builder().drift(0.001).world(Fixed::filled(1234)).build();
    let mut link = emulator.link();
    let mut period = async || {
        scan(&mut link).await;
        scan(&mut link).await;
        let sent = emulator.sent_scans();
        sent[sent.len() - 1].revolution_end - sent[sent.len() - 2].revolution_end
    };
    let within = |period: Duration, micros: u64| {
        assert!(
            period.abs_diff(Duration::from_micros(micros)) < Duration::from_micros(1),
            "{period:?}"
        );
    };
    within(period().await, 100_000);
    sleep(3_600_000 * MS).await;
    within(period().await, 100_100);
    emulator.set_drift(-0.001);
    sleep(3_600_000 * MS).await;
    within(period().await, 100_000);
    sleep(3_600_000 * MS).await;
    emulator.power_cycle();
    within(period().await, 100_000);
}

#[tokio::test(start_paused = true)]
async fn no_time_is_too_long_or_too_short() {
    for time in [Duration::MAX, Duration::from_secs(u64::MAX / 2), Duration::from_nanos(1)] {
        let settings: [fn(EmulatorBuilder, Duration) -> EmulatorBuilder; 4] = [
            EmulatorBuilder::frame,
            EmulatorBuilder::latency,
            EmulatorBuilder::revolution,
            EmulatorBuilder::boot_time,
        ];
        let faults = [
            Faults::none().every(Fault::Late(time)),
            Faults::none().every(Fault::Pause(3, time)),
            Faults::none().every(Fault::Trickle(time)),
            Faults::none().up_to(1.0, Fault::Late(time)).up_to(1.0, Fault::Pause(63, time)),
        ];
        let emulators = settings.map(|set| set(Emulator::builder(), time).build());
        let faulty = faults.map(|faults| Emulator::builder().faults(faults).build());
        for emulator in emulators.into_iter().chain(faulty) {
            emulator.delay_motor(time);
            emulator.delay_motor(time);
            let mut link = emulator.link();
            link.write_all(b"V\nG04472501\nL1\n").await.unwrap();
            let mut reply = Vec::new();
            let read =
                tokio::time::timeout(Duration::from_secs(3600), link.read_to_end(&mut reply));
            assert!(read.await.is_err(), "the sensor never hangs up");
        }
    }
}
