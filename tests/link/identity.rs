//! The sensor that a link belongs to is known by its serial number: another one in its
//! place is refused, and a damaged reply is not taken for another sensor.

use std::time::Duration;

use super::reconnect::open;
use crate::common::hooked::{Hooked, Hooks};
use crate::common::random::Random;
use crate::common::{ConnectFn, builder, truthful};
use tokio::time::Instant;
use tokio_scip::{BaudRate, Error, ErrorKind, Geometry, Rate, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Pace};

#[tokio::test(start_paused = true)]
async fn d09_another_sensor_is_refused_once() {
    let emulator = truthful().serial_number("H0000001").build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    emulator.unplug();
    emulator.set_serial_number("H0000002");
    emulator.plug_in();
    let mut errors = Vec::new();
    let end = Instant::now() + Duration::from_secs(60);
    while let Ok(item) = tokio::time::timeout_at(end, stream.next()).await {
        errors.extend(item.unwrap().err());
    }
    let kinds: Vec<_> = errors.iter().map(Error::kind).collect();
    assert!(
        matches!(
            kinds[..],
            [ErrorKind::Disconnected { .. }, ErrorKind::AnotherSensor { .. }]
                | [ErrorKind::AnotherSensor { .. }]
        ),
        "{errors:?}"
    );
    let State::Disconnected { error, .. } = sensor.watch_state().get() else {
        panic!("{errors:?}")
    };
    assert!(matches!(error.kind(), ErrorKind::AnotherSensor { .. }), "{error:?}");
    emulator.set_serial_number("H0000001");
    stream.next().await.unwrap().unwrap();
}

#[tokio::test(start_paused = true)]
async fn d09_any_sensor_accepts_and_sets_a_spare() {
    let emulator = truthful().serial_number("H0000001").build();
    let sensor = builder().any_sensor(true).connect(emulator.clone()).await.unwrap();
    sensor.laser_off().await.unwrap();
    let mut state = sensor.watch_state();
    emulator.unplug();
    emulator.set_serial_number("H0000002");
    emulator.power_cycle();
    emulator.plug_in();
    let spare = |state: &State| matches!(state, State::Connected { serial_number, .. } if *serial_number == "H0000002");
    state.wait_for(spare).await.unwrap();
    assert_eq!(sensor.version().await.unwrap().serial_number, "H0000002");
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn d09_waiting_continues_beside_a_wrong_sensor() {
    let emulator = truthful().serial_number("H0000002").build();
    let builder = builder().wait_for_sensor(true).serial_number("H0000001");
    let sensor = builder.connect(emulator.clone()).await.unwrap();
    let opening = tokio::spawn(async move { sensor.watch_state().connected().await });
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert!(!opening.is_finished());
    emulator.unplug();
    emulator.set_serial_number("H0000001");
    emulator.plug_in();
    opening.await.unwrap().unwrap();
}

#[tokio::test(start_paused = true)]
async fn w25_a_flipped_serial_number_refuses_nothing() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    // After the fence comes the first `V`, whose fifth line is the serial number.
    emulator.set_faults(Faults::none().at(1, Fault::Flip(160, 1)));
    emulator.plug_in();
    sensor.scan(Window::FULL).await.unwrap();
    assert_eq!(emulator.fault_count(&Fault::Flip(0, 0)), 1);
}

/// Opens a sensor whose first replies to `V` are damaged in this way, and unplugs it for a
/// moment: it must not be refused as another one.
async fn replug_after(damage: Vec<Fault>) {
    let flipped = damage.len() as u64;
    // The first command is the fence. The fifth line of a `V` is the serial number.
    let replies = (1..).zip(damage);
    let faults = replies.fold(Faults::none(), |faults, (reply, fault)| faults.at(reply, fault));
    let emulator = truthful().faults(faults).pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    assert_eq!(emulator.fault_count(&Fault::Flip(0, 0)), flipped);
    assert_eq!(sensor.version().await.unwrap().serial_number, "H0713090");
    emulator.unplug();
    emulator.plug_in();
    sensor.scan(Window::FULL).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn w25_a_damaged_first_serial_number_does_not_refuse_the_sensor_later() {
    replug_after(vec![Fault::Flip(160, 1)]).await;
}

#[tokio::test(start_paused = true)]
async fn w25_a_damaged_serial_number_is_not_pinned() {
    // A byte that no text has, in the same place of both replies.
    replug_after(vec![Fault::Flip(160, 0x80), Fault::Flip(160, 0x80)]).await;
}

#[tokio::test(start_paused = true)]
async fn w25_a_damaged_serial_number_is_requested_again() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.unplug();
    // Another digit first, then twice another name of the field, which means no serial
    // number at all.
    let digit = Fault::Flip(160, 1);
    let name = || Fault::Flip(152, 1);
    emulator.set_faults(Faults::none().at(1, digit).at(2, name()).at(3, name()));
    emulator.plug_in();
    let mut errors = Vec::new();
    while let Err(error) = stream.next().await.unwrap() {
        errors.push(error);
    }
    assert_eq!(emulator.fault_count(&Fault::Flip(0, 0)), 3);
    // Each opening of the port sends one.
    assert_eq!(sensor.stats().fences, 2);
    let [error] = &errors[..] else { panic!("{errors:?}") };
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
}

/// Number of times that the sensor was asked for its version.
fn requests(emulator: &Emulator) -> usize {
    emulator.log().iter().filter(|received| received.line.starts_with(b"V")).count()
}

/// Opens a sensor some of whose replies to `V` have a serial number with a flipped bit, each another
/// one. Returns the serial number of the sensor, and how often it was asked.
async fn serial_number_after(damaged: &[bool]) -> (String, usize) {
    // The first command is the fence. The fifth line of a `V` is the serial number.
    let flips = (0..).zip(damaged).filter(|(_, damaged)| **damaged);
    let faults = flips.fold(Faults::none(), |faults, (reply, _)| {
        faults.at(reply + 1, Fault::Flip(160, 1 << reply))
    });
    let emulator = truthful().faults(faults).pace(Pace::AtOnce).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let version = sensor.version().await.unwrap();
    (version.serial_number.to_string(), requests(&emulator))
}

#[tokio::test(start_paused = true)]
async fn any_two_equal_serial_numbers_settle() {
    for (damaged, count) in [
        (&[false][..], 2),
        (&[false, true, false, true], 3),
        (&[true, false, false], 3),
        (&[false, true, true, false], 4),
        (&[true, false, true, false], 4),
        (&[true, true, false, false], 4),
    ] {
        let found = serial_number_after(damaged).await;
        assert_eq!(found, ("H0713090".to_owned(), count), "{damaged:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_serial_number_is_requested_twice() {
    let nameless = truthful().serial_number("").build();
    builder().connect(nameless.clone()).await.unwrap();
    let other = truthful().serial_number("H0000001").build();
    let error = builder().serial_number("H0000002").connect(other.clone()).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::AnotherSensor { .. }), "{error:?}");
    assert_eq!((requests(&nameless), requests(&other)), (2, 2));
}

/// Hooks of a port that delivers all bytes intact, as a sensor's own USB port does.
struct Intact;

impl Hooks for Intact {
    fn delivers_intact(&self) -> bool {
        true
    }
}

/// On USB a sensor answers once a revolution: a fence, `V` and `G`, and `V` once more if its serial
/// number is new and could be damaged.
#[tokio::test(start_paused = true)]
async fn the_first_scan_comes_after_three_replies_where_the_first_serial_number_is_certain() {
    for (is_expected, is_intact, limit) in
        [(true, false, 270), (false, true, 270), (false, false, 370)]
    {
        let mut times = Vec::new();
        for phase in 0..20 {
            let emulator = truthful().serial_number("H0000001").usb().build();
            tokio::time::sleep(Duration::from_millis(5 * phase)).await;
            let begin = Instant::now();
            let builder = builder();
            let builder = if is_expected { builder.serial_number("H0000001") } else { builder };
            let sensor = if is_intact {
                let port = move || Ok(Hooked { port: emulator.link(), hooks: Intact });
                builder.connect(ConnectFn(port)).await
            } else {
                builder.connect(emulator).await
            };
            sensor.unwrap().scan(Window::DETECTION).await.unwrap();
            times.push(begin.elapsed());
        }
        times.sort();
        assert!(times[10] <= Duration::from_millis(limit), "{times:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn an_intact_serial_number_is_expected_after_one_reply() {
    let emulator = truthful().serial_number("H0000001").build();
    let plugged_in = emulator.clone();
    let port = move || Ok(Hooked { port: plugged_in.link(), hooks: Intact });
    let sensor = builder().connect(ConnectFn(port)).await.unwrap();
    assert_eq!(requests(&emulator), 1);
    emulator.unplug();
    emulator.set_serial_number("H0000002");
    emulator.plug_in();
    let mut state = sensor.watch_state();
    let is_refused = |state: &State| {
        matches!(state, State::Disconnected { error, .. }
            if matches!(error.kind(), ErrorKind::AnotherSensor { .. }))
    };
    state.wait_for(is_refused).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_scan_knows_the_stated_revolution() {
    let emulator = |specification: &str| {
        let lines = [
            "VEND:Hokuyo Automatic Co.,Ltd.",
            "PROD:SOKUIKI Sensor URG-04LX",
            &format!("FIRM:3.3.00,08/04/16{specification}"),
            "PROT:00003,(SCIP 1.0)",
            "SERI:H0713090",
        ];
        truthful().version_lines(lines).build()
    };
    let with = emulator("(20-4095[mm],240[deg],44-725[step],1200[rpm])");
    for (emulator, milliseconds) in [(with, 50), (emulator(""), 100)] {
        let sensor = builder().connect(emulator).await.unwrap();
        assert_eq!(
            sensor.scan(Window::DETECTION).await.unwrap().scan_time(),
            Duration::from_millis(milliseconds)
        );
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_measures_what_its_firmware_line_tells() {
    let usual = Geometry::URG_04LX;
    let told = [
        ("(60-4000[mm],180[deg],128-640[step],600[rpm])", 128..=640, 60..=4000),
        ("(20-5600[mm],270[deg],0-768[step])", 0..=768, 20..=4094),
        ("(0-10[mm],240[deg],0-1080[step])", usual.steps(), usual.distances()),
        ("", usual.steps(), usual.distances()),
    ];
    for (bracket, steps, distances) in told {
        let lines = [format!("FIRM:3.3.00,08/04/16{bracket}"), "SERI:H0713090".to_owned()];
        let sensor = builder().connect(truthful().version_lines(lines).build()).await.unwrap();
        let geometry = sensor.geometry().await.unwrap();
        assert_eq!((geometry.steps(), geometry.distances()), (steps, distances), "{bracket}");
        let scan = sensor.scan(Window::DETECTION).await.unwrap();
        let window = scan.window();
        assert_eq!((*scan.geometry(), window.start()..=window.end()), (geometry, geometry.steps()));
    }
}

#[tokio::test(start_paused = true)]
async fn no_flipped_bit_changes_the_geometry() {
    let firmware = "FIRM:3.3.00,08/04/16(20-4095[mm],240[deg],44-725[step],600[rpm])";
    let lines = [firmware, "SERI:H0713090"];
    let speed = "V\n0\n".len() + firmware.find("600[").unwrap();
    let bracket = "V\n0\n".len() + firmware.find('(').unwrap();
    for seed in 0..300 {
        let mut random = Random::new(seed);
        // The bit is in one of the first three replies after the fence, mostly in the bracket.
        let mut flip = || {
            let at = match random.below(3) {
                0 => random.below(85) as usize,
                1 => bracket + random.below(45) as usize,
                _ => speed + random.below(3) as usize,
            };
            let bit = 1 << random.below(8);
            Faults::none().at(1 + random.below(3), Fault::Flip(at, bit))
        };
        let emulator = truthful().version_lines(lines).pace(Pace::AtOnce).faults(flip()).build();
        let builder = builder().wait_for_sensor(true);
        let sensor = builder.connect(emulator.clone()).await.unwrap();
        for _ in 0..3 {
            let scan = loop {
                if let Ok(scan) = sensor.scan(Window::FULL).await {
                    break scan;
                }
            };
            assert_eq!(*scan.geometry(), Geometry::URG_04LX, "seed {seed}");
            assert_eq!(scan.scan_time(), Duration::from_millis(100), "seed {seed}");
            emulator.unplug();
            emulator.set_faults(flip());
            emulator.plug_in();
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_refused_baud_rate_is_not_expected_later() {
    let emulator = truthful().serial_number("H0000001").baud_rate(BaudRate::B19200).build();
    // Five replies precede it: to a fence at the wrong baud rate and to one at the right one, to
    // two `V` and another fence.
    emulator.set_faults(Faults::none().at(5, Fault::Status(b'1')));
    let builder = builder().wait_for_sensor(true).baud_rate(BaudRate::B115200);
    let (sensor, driver) = builder.build(emulator.clone());
    tokio::spawn(driver);
    let refused = |state: &State| match state {
        State::Connecting { error: Some(error) } => {
            matches!(error.kind(), ErrorKind::Refused { .. })
        }
        _ => false,
    };
    sensor.watch_state().wait_for(refused).await.map(drop).unwrap();
    emulator.unplug();
    emulator.set_serial_number("H0000002");
    emulator.plug_in();
    tokio::time::timeout(Duration::from_secs(60), sensor.watch_state().connected())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(sensor.version().await.unwrap().serial_number, "H0000002");
}

#[tokio::test(start_paused = true)]
async fn a_spare_inherits_no_motor_speed() {
    let lines = |serial_number: &str, bracket: &str| {
        [format!("FIRM:3.3.00,08/04/16{bracket}"), format!("SERI:{serial_number}")]
    };
    let slow = "(20-4095[mm],240[deg],44-725[step],300[rpm])";
    let first = truthful().version_lines(lines("H0000001", slow)).build();
    let spare = truthful().version_lines(lines("H0000002", "")).build();
    let sensors = [first.clone(), spare];
    let mut opened = 0;
    let connect = move || {
        opened += 1;
        Ok(sensors[(opened - 1).min(1)].link())
    };
    let sensor = builder().any_sensor(true).connect(ConnectFn(connect)).await.unwrap();
    assert_eq!(
        sensor.scan(Window::DETECTION).await.unwrap().scan_time(),
        Duration::from_millis(200)
    );
    first.unplug();
    assert_eq!(
        sensor.scan(Window::DETECTION).await.unwrap().scan_time(),
        Duration::from_millis(100)
    );
}
