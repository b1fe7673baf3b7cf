//! Laser and baud rate: set, confirmed, and restored.

use crate::common::{builder, ms, truthful};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, ErrorKind, Operation, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Firmware, Pace};

async fn open(emulator: &Emulator) -> Sensor {
    builder().connect(emulator.clone()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn the_laser_is_switched_and_switching_it_twice_is_no_error() {
    for firmware in [Firmware::Text, Firmware::V3] {
        let emulator = truthful().firmware(firmware).build();
        let sensor = open(&emulator).await;
        sensor.laser_on().await.unwrap();
        assert!(emulator.is_laser_on());
        sensor.laser_off().await.unwrap();
        sensor.laser_off().await.unwrap();
        assert!(!emulator.is_laser_on());
        sensor.laser_on().await.unwrap();
        assert!(emulator.is_laser_on());
    }
}

#[tokio::test(start_paused = true)]
async fn w04_a_bad_reply_leaves_no_laser_on() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.set_faults(Faults::none().at(0, Fault::Lost));
    sensor.laser_off().await.unwrap();
    assert!(!emulator.is_laser_on());

    sensor.laser_on().await.unwrap();
    // The sensor refuses, and a flipped bit makes that a success.
    emulator
        .set_faults(Faults::none().at(0, Fault::Status(b'1')).at(0, Fault::Flip(3, b'1' ^ b'0')));
    sensor.laser_off().await.unwrap();
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn w04_a_false_status_of_success_is_detected() {
    let emulator = truthful().build();
    let sensor = builder().name("left").connect(emulator.clone()).await.unwrap();
    let mut faults = Faults::none();
    for reply in 0..10 {
        // Every second reply is that to a fence.
        if reply % 2 == 0 {
            faults = faults.at(reply, Fault::Status(b'1')).at(reply, Fault::Flip(3, b'1' ^ b'0'));
        }
    }
    emulator.set_faults(faults);
    let error = sensor.laser_off().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NotConfirmed { .. }), "{error:?}");
    let text = error.to_string();
    assert!(
        text.contains("the laser of left stays on") && text.contains("L0 with status '0'"),
        "{text}"
    );
}

#[tokio::test(start_paused = true)]
async fn w04_a_false_refusal_of_a_poll_turns_no_laser_off() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    // L0, a fence, L0, and the fence whose refusal seems to confirm it.
    let lost = Faults::none().at(0, Fault::CommandLost).at(2, Fault::CommandLost);
    emulator.set_faults(lost.at(3, Fault::Status(b'E')));
    sensor.laser_off().await.unwrap();
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn d14_a_stubborn_baud_rate_is_reported() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    // After a fence; a flipped bit makes the refusal "already at that baud rate".
    let shown = Fault::Flip(15, b'1' ^ b'3');
    emulator.set_faults(Faults::none().at(1, Fault::Status(b'1')).at(1, shown));
    let error = sensor.set_baud_rate(BaudRate::B115200).await.unwrap_err();
    let text = error.to_string();
    assert!(text.contains("baud rate") && text.contains("with status '3'"), "{text}");
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B19200));
    sensor.scan(Window::DETECTION).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn t04_an_error_names_the_command_that_failed_and_not_the_fence() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.set_faults(Faults::none().rate(1.0, Fault::CommandLost));
    let error = sensor.laser_off().await.unwrap_err();
    assert!(
        matches!(error.kind(), ErrorKind::Timeout { operation: Operation::LaserOff, .. }),
        "{error:?}"
    );
}

#[tokio::test(start_paused = true)]
async fn settings_without_a_link_apply_after_the_replug() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = builder().request_timeout(ms(10)).connect(emulator.clone()).await.unwrap();
    emulator.unplug();
    let error = sensor.laser_off().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
    assert!(sensor.set_baud_rate(BaudRate::B115200).await.is_err());
    emulator.plug_in();
    tokio::time::sleep(ms(5000)).await;
    assert_eq!((emulator.is_laser_on(), emulator.baud_rate()), (false, Some(BaudRate::B115200)));
}

#[tokio::test(start_paused = true)]
async fn a_laser_command_that_was_abandoned_precedes_a_scan() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let versions = || emulator.log().iter().filter(|line| line.line == b"V").count();
    let before = versions();
    emulator.unplug();
    emulator.plug_in();
    // The search has begun with the laser as it was.
    while versions() == before {
        tokio::time::sleep(ms(1)).await;
    }
    assert!(tokio::time::timeout(ms(1), sensor.laser_off()).await.is_err());
    let error = sensor.scan(Window::DETECTION).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::LaserOff), "{error}");
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn a_baud_rate_without_a_link_is_tried_thrice_unless_it_is_refused() {
    for (fault, times) in [(Fault::Status(b'1'), 1), (Fault::Ignored, 3)] {
        let emulator = truthful().baud_rate(BaudRate::B19200).build();
        let sensor = builder().request_timeout(ms(10)).connect(emulator.clone()).await.unwrap();
        emulator.unplug();
        assert!(sensor.set_baud_rate(BaudRate::B115200).await.is_err());
        emulator.set_faults(Faults::none().on("S", fault.clone()));
        emulator.plug_in();
        tokio::time::sleep(ms(20_000)).await;
        let asked = emulator.log().iter().filter(|line| line.line.starts_with(b"S")).count();
        assert_eq!(asked, times, "{fault:?}");
        sensor.scan(Window::DETECTION).await.unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn a_baud_rate_that_is_not_restored_is_tried_again() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let fast = builder().baud_rate(BaudRate::B115200);
    let sensor = fast.connect(emulator.clone()).await.unwrap();
    for n in 0..4 {
        emulator.set_faults(Faults::none().once("S", Fault::Ignored));
        emulator.power_cycle();
        while sensor.scan(Window::DETECTION).await.is_err() {}
        tokio::time::sleep(ms(5000)).await;
        assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200), "{n}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_laser_that_another_program_switched_off_is_switched_on() {
    use tokio::io::AsyncWriteExt;
    let emulator = truthful().build();
    let mut link = emulator.link();
    link.write_all(b"L0\n").await.unwrap();
    drop(link);
    let sensor = open(&emulator).await;
    assert!(!emulator.is_laser_on());
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    assert!(emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn a_stubborn_laser_is_retried_after_scans() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    // This is long enough for waits of eight seconds between two attempts.
    emulator.set_faults(Faults::none().every(Fault::Status(b'6')));
    stream.next().await.unwrap().unwrap_err();
    tokio::time::sleep(ms(10_000)).await;
    emulator.set_faults(Faults::none());
    stream.next().await.unwrap().unwrap();
    emulator.set_faults(Faults::none().at(0, Fault::Status(b'6')));
    for _ in 0..3 {
        stream.next().await.unwrap().unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn a08_the_baud_rate_changes_under_a_stream_and_back() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    for speed in BaudRate::ALL.into_iter().rev() {
        sensor.set_baud_rate(speed).await.unwrap();
        assert_eq!(emulator.baud_rate(), Some(speed));
        let state = sensor.watch_state().get();
        assert!(matches!(state, State::Connected { baud_rate, .. } if baud_rate == Some(speed)));
        stream.next().await.unwrap().unwrap();
    }
    assert_eq!(sensor.stats().disconnects, 0);
}

#[tokio::test(start_paused = true)]
async fn o10_setting_the_current_baud_rate_is_not_an_error() {
    let emulator = truthful().baud_rate(BaudRate::B57600).build();
    let sensor = open(&emulator).await;
    sensor.set_baud_rate(BaudRate::B57600).await.unwrap();
    for firmware in [Firmware::Text, Firmware::V3] {
        let usb = truthful().firmware(firmware).build();
        open(&usb).await.set_baud_rate(BaudRate::B115200).await.unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn o09_a_lost_reply_to_s_does_not_lose_the_sensor() {
    for fault in [Fault::Lost, Fault::CommandLost, Fault::Drop(3..4), Fault::Late(ms(900))] {
        let emulator = truthful().baud_rate(BaudRate::B19200).pace(Pace::AtOnce).build();
        let sensor = open(&emulator).await;
        // Reply 0 answers the fence after the trial of the port's baud rate.
        emulator.set_faults(Faults::none().at(1, fault.clone()));
        let outcome = sensor.set_baud_rate(BaudRate::B115200).await;
        let lost = fault == Fault::CommandLost;
        assert_eq!(outcome.is_err(), lost, "{fault:?}: {outcome:?}");
        let expected = if lost { BaudRate::B19200 } else { BaudRate::B115200 };
        assert_eq!(emulator.baud_rate(), Some(expected));
        sensor.scan(Window::DETECTION).await.unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn o09_two_lost_replies_after_s_do_not_lose_the_sensor() {
    let emulator = truthful().baud_rate(BaudRate::B19200).pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    emulator.set_faults(Faults::none().at(2, Fault::Lost).at(3, Fault::Lost));
    sensor.set_baud_rate(BaudRate::B115200).await.unwrap();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200));
    let stats = sensor.stats();
    assert_eq!((stats.fence_timeouts, stats.reconnects), (2, 0), "{stats:?}");
}

#[tokio::test(start_paused = true)]
async fn a_refused_baud_rate_changes_neither_side() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = builder().name("left").connect(emulator.clone()).await.unwrap();
    emulator.set_faults(Faults::none().at(1, Fault::Status(b'1')));
    let error = sensor.set_baud_rate(BaudRate::B115200).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Refused { .. }), "{error:?}");
    assert!(error.to_string().starts_with("left refused S"), "{error}");
    sensor.scan(Window::DETECTION).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn d01_a_repeated_baud_rate_is_confirmed() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    sensor.set_baud_rate(BaudRate::B115200).await.unwrap();
    // Nothing is polled, so the restart is not detected.
    emulator.power_cycle();
    let outcome = sensor.set_baud_rate(BaudRate::B115200).await;
    assert!(outcome.is_err());
    sensor.scan(Window::DETECTION).await.unwrap();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200));
}

#[tokio::test(start_paused = true)]
async fn a_command_has_its_latency_and_wire_time() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    emulator.set_faults(Faults::none().at(0, Fault::Lost).at(2, Fault::Lost));
    let error = sensor.scan(Window::DETECTION).await.unwrap_err();
    let ErrorKind::Timeout { operation: Operation::Scan, command, after, .. } = error.kind() else {
        panic!("{error:?}");
    };
    let command = command.to_string();
    let asked = Window::new(command[1..4].parse().unwrap()..=command[4..7].parse().unwrap());
    assert_eq!(*after, ms(500) + asked.unwrap().wire_time(BaudRate::B19200, Protocol::Scip1));
}
