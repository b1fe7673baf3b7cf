//! What disturbs a stream of scans: the laser's commands, probes, single scans, slow lines, and a
//! sensor that sends no scans.

use std::time::Duration;

use tokio::io::{
    AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader, DuplexStream, copy_bidirectional,
    duplex, split,
};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Error, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Firmware, Model};

use super::refusals::{PARAMETERS, VERSION};
use super::{next, numbered, revolution};
use crate::common::{builder, reason};

fn commands(emulator: &Emulator, head: &[u8]) -> usize {
    emulator.log().iter().filter(|line| line.line.starts_with(head)).count()
}

#[tokio::test(start_paused = true)]
async fn a_laser_that_was_switched_off_stays_off() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    // Scans arrive before the answer, and are not read from the stream.
    emulator.set_faults(Faults::none().every(Fault::Late(Duration::from_millis(60))));
    sleep(Duration::from_secs(1)).await;
    let dropping = async {
        sleep(Duration::from_millis(30)).await;
        drop(stream);
    };
    let (outcome, ()) = tokio::join!(sensor.laser_off(), dropping);
    outcome.unwrap();
    sleep(Duration::from_secs(1)).await;
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn the_state_is_told_beside_a_stream() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let sensor = builder().connect(numbered(model).build()).await.unwrap();
        let idle = sensor.sensor_state().await.unwrap().unwrap();
        assert_eq!(idle.laser_on, Some(false), "{model:?}");
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let before = revolution(&next(&mut stream).await);
        let state = sensor.sensor_state().await.unwrap().unwrap();
        assert!(state.diagnosis.to_string().contains("work"), "{state:?}");
        assert_eq!(state.laser_on, Some(true), "{model:?}");
        assert!(state.clock > idle.clock, "{model:?}");
        let mut latest = before;
        for _ in 0..20 {
            let now = revolution(&next(&mut stream).await);
            assert!(now > latest, "{model:?}");
            latest = now;
        }
        assert!(latest - before < 60, "{model:?}: {before} to {latest}");
    }
    let sensor = builder().connect(numbered(Model::Urg04lx).build()).await.unwrap();
    assert_eq!(sensor.sensor_state().await.unwrap(), None);
}

#[tokio::test(start_paused = true)]
async fn a_stream_switches_no_laser_on_that_is_to_be_off() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    emulator.set_faults(Faults::none().on("QT", Fault::Lost));
    let error = sensor.laser_off().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error}");
    emulator.set_faults(Faults::none());
    for _ in 0..500 {
        assert!(!emulator.is_laser_on());
        sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_busy_sensor_does_not_confirm_that_its_laser_is_off() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    let ignoring = Faults::none().once("QT", Fault::Ignored);
    emulator.set_faults(ignoring.clone().once("GD", Fault::Status(b'M')));
    let error = sensor.laser_off().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NotConfirmed { .. }), "{error}");
    emulator.set_faults(ignoring.on("GD", Fault::Status(b'M')));
    let error = sensor.laser_off().await.unwrap_err();
    assert!(error.to_string().contains("the sensor is not stable yet"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_laser_is_switched_once_for_a_request_during_a_search() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    sensor.laser_off().await.unwrap();
    let before = ["BM", "VV"].map(|command| commands(&emulator, command.as_bytes()));
    emulator.unplug();
    emulator.plug_in();
    while commands(&emulator, b"VV") == before[1] {
        sleep(Duration::from_millis(1)).await;
    }
    sensor.laser_on().await.unwrap();
    assert_eq!(commands(&emulator, b"BM"), before[0] + 1);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_answered_is_identified_again() {
    let lossy = Faults::none().on("PP", Fault::Lost);
    let emulator = numbered(Model::Ust10lx).faults(lossy).build();
    let mending = async {
        while commands(&emulator, b"PP") < 2 {
            sleep(Duration::from_millis(1)).await;
        }
        // It has lost both.
        sleep(Duration::from_millis(500)).await;
        emulator.set_faults(Faults::none());
    };
    // A link that cannot be opened again.
    let (outcome, ()) = tokio::join!(builder().attach(emulator.link()), mending);
    outcome.unwrap();
    assert_eq!(commands(&emulator, b"PP"), 3);
}

#[tokio::test(start_paused = true)]
async fn a_stream_is_not_probed() {
    let emulator = numbered(Model::Urg04lxUg01).build();
    let probing = builder().idle_probe(Some(Duration::from_millis(100)));
    let sensor = probing.connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(1.0)).await.unwrap();
    sleep(Duration::from_secs(2)).await;
    let before = commands(&emulator, b"");
    for _ in 0..10 {
        timeout(Duration::from_secs(3), next(&mut stream)).await.unwrap();
    }
    assert_eq!(commands(&emulator, b""), before);
}

#[tokio::test(start_paused = true)]
async fn a_single_scan_does_not_slow_a_stream_down() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
    let emulator = emulator.baud_rate(BaudRate::B115200).build();
    let asking = builder().protocol(Protocol::Scip2).depth(512);
    let sensor = asking.connect(emulator.clone()).await.unwrap();
    let right = Window::new(44..=100).unwrap();
    let mut stream = sensor.scans(right, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    assert!(commands(&emulator, b"MD") > 0);
    // With the stream's window, each takes the line twice as long as a revolution.
    for (window, len) in [(Window::DETECTION, 682), (Window::new(700..=725).unwrap(), 26)] {
        assert_eq!(sensor.scan(window).await.unwrap().len(), len);
    }
    let end = Instant::now() + Duration::from_secs(5);
    let mut count = 0;
    while next(&mut stream).await.received_at() < end {
        count += 1;
    }
    assert!(count >= 45, "{count}");
}

#[tokio::test(start_paused = true)]
async fn single_scans_leave_no_stream_behind() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().depth(512).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    emulator.set_faults(Faults::none().rate(0.5, Fault::WrongSum).seed(1));
    for _ in 0..4 {
        let sensor = sensor.clone();
        tokio::spawn(async move {
            loop {
                let _ = sensor.scan(Window::DETECTION).await;
            }
        });
    }
    sleep(Duration::from_secs(30)).await;
    let mut latest = None;
    while let Ok(item) = timeout(Duration::from_millis(1), stream.next()).await {
        latest = item.unwrap().ok().map(|scan| scan.received_at()).or(latest);
    }
    let age = latest.unwrap().elapsed();
    assert!(age < Duration::from_millis(300), "{age:?}");
}

/// Returns a sensor that answers its stream's command with `replies`, each 10 ms after the one before
/// and without the echo, and what it is asked.
fn sensor_with_a_stream_of(
    mut replies: impl FnMut(usize) -> Option<&'static str> + Send + 'static,
) -> (DuplexStream, mpsc::UnboundedReceiver<String>) {
    let (near, far) = duplex(4096);
    let (log, asked) = mpsc::unbounded_channel();
    tokio::spawn(async move {
        let (read, mut write) = split(far);
        let mut lines = BufReader::new(read).lines();
        let (mut stream, mut sent) = (None::<String>, 0);
        loop {
            let line = match timeout(Duration::from_millis(10), lines.next_line()).await {
                Ok(Ok(Some(line))) => Some(line),
                Ok(_) => return,
                Err(_) => None,
            };
            let frame = match (&line, &stream) {
                (Some(command), _) => {
                    let _ = log.send(command.clone());
                    (stream, sent) = (command.starts_with("MD").then(|| command.clone()), 0);
                    let reply = match command.get(..2) {
                        Some("VV") => VERSION,
                        Some("PP") => PARAMETERS,
                        Some("BM" | "QT") => "00P",
                        Some("GD") => "10Q",
                        Some("MD") => continue,
                        Some(_) => "0Ee",
                        None => continue,
                    };
                    format!("{command}\n{reply}\n\n")
                }
                (None, Some(command)) => {
                    let Some(reply) = replies(sent) else { continue };
                    sent += 1;
                    format!("{command}\n{reply}\n\n")
                }
                (None, None) => continue,
            };
            if write.write_all(frame.as_bytes()).await.is_err() {
                return;
            }
        }
    });
    (near, asked)
}

#[tokio::test(start_paused = true)]
async fn t16_answers_without_scans_end_a_stream() {
    crate::common::limit::limit();
    let (port, _asked) = sensor_with_a_stream_of(|_| Some("00P"));
    let sensor = builder().attach(port).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    let item = timeout(Duration::from_secs(5), stream.next()).await;
    let error = item.unwrap().unwrap().unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error}");
}

#[tokio::test(start_paused = true)]
async fn nothing_goes_beside_a_stream_whose_answer_was_damaged() {
    crate::common::limit::limit();
    let (port, mut asked) = sensor_with_a_stream_of(|sent| (sent == 0).then_some("00Q"));
    let sensor = builder().attach(port).await.unwrap();
    let _stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    while !asked.recv().await.unwrap().starts_with("MD") {}
    let next = asked.recv().await.unwrap();
    assert!(next.starts_with("QT"), "{next}");
}

/// The sensor checks for an error, and finds none.
#[tokio::test(start_paused = true)]
async fn a_stream_continues_after_a_check_of_the_sensor() {
    crate::common::limit::limit();
    let statuses = [("21S", true), ("98a", true), ("10Q", false)];
    for (status, continues) in statuses {
        let [first, second, _] = SCANS;
        let replies = ["00P", first, status, second];
        let (port, mut asked) = sensor_with_a_stream_of(move |sent| replies.get(sent).copied());
        let sensor = builder().attach(port).await.unwrap();
        let mut stream =
            sensor.scans(Window::new(384..=384).unwrap(), Rate::UNLIMITED).await.unwrap();
        assert_eq!(next(&mut stream).await.raw_values().collect::<Vec<_>>(), [1344]);
        while asked.try_recv().is_ok() {}
        let error = stream.next().await.unwrap().unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Refused { .. }), "{error}");
        assert_eq!(sensor.stats().refused, 1);
        let reason = reason(&sensor.freshness());
        assert!(matches!(reason.kind(), ErrorKind::Refused { .. }), "{reason}");
        let start = Instant::now();
        while !asked.recv().await.unwrap().starts_with("QT") {}
        // At its deadline, or at once.
        assert_eq!(start.elapsed() > Duration::from_secs(1), continues, "{status}");
    }
}

/// Three scans of one step: 1,344 mm, 1,345 mm, 1,346 mm.
const SCANS: [&str; 3] = ["99b\n00000\n0E0U", "99b\n000II\n0E1V", "99b\n000bb\n0E2W"];

#[tokio::test(start_paused = true)]
async fn a_copy_after_the_next_scan_is_no_scan() {
    crate::common::limit::limit();
    let [first, second, third] = SCANS;
    // The damaged one is no scan either: its clock is not known.
    // Nor has its stream an answer in one case.
    for (at_first, lost) in [(first, 0), (first, 1), ("99b\n00000\n0E0V", 0)] {
        let replies = ["00P", at_first, second, first, third];
        let (port, _asked) = sensor_with_a_stream_of(move |sent| replies.get(sent + lost).copied());
        let sensor = builder().attach(port).await.unwrap();
        let front = Window::new(384..=384).unwrap();
        let mut stream = sensor.scans(front, Rate::UNLIMITED).await.unwrap();
        let mut values = Vec::new();
        while values.last() != Some(&1346) {
            if let Ok(scan) = stream.next().await.unwrap() {
                values.extend(scan.raw_values());
            }
        }
        let expected = if at_first == first { &[1344, 1345, 1346][..] } else { &[1345, 1346] };
        assert_eq!(values, expected);
    }
}

#[tokio::test(start_paused = true)]
async fn a_late_copy_in_each_of_two_streams_is_no_scan() {
    crate::common::limit::limit();
    let [first, second, third] = SCANS;
    let (mut streams, mut ticks) = (0, 0);
    let (port, _asked) = sensor_with_a_stream_of(move |sent| {
        if sent == 0 {
            (streams, ticks) = (streams + 1, 0);
        }
        ticks += 1;
        // Each copy comes 70 ms later, when the next scan is nearly due.
        match (streams, ticks) {
            (_, 1) => Some("00P"),
            (1, 2 | 9) => Some(first),
            (2, 2 | 9) => Some(second),
            (2, 12) => Some(third),
            _ => None,
        }
    });
    let sensor = builder().attach(port).await.unwrap();
    let front = Window::new(384..=384).unwrap();
    let mut stream = sensor.scans(front, Rate::UNLIMITED).await.unwrap();
    let mut values = Vec::from_iter(next(&mut stream).await.raw_values());
    sleep(Duration::from_millis(90)).await;
    // The request ends the stream.
    sensor.sensor_state().await.unwrap_err();
    for _ in 0..2 {
        values.extend(next(&mut stream).await.raw_values());
    }
    assert_eq!(values, [1344, 1345, 1346]);
}

#[tokio::test(start_paused = true)]
async fn t14_a_copy_on_a_slow_line_is_no_scan() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
    let emulator = emulator.baud_rate(BaudRate::B57600).build();
    let asking = builder().protocol(Protocol::Scip2).baud_rate(BaudRate::B57600).depth(64);
    let sensor = asking.connect(emulator.clone()).await.unwrap();
    // A reply takes longer than half a revolution.
    let window = Window::new(300..=420).unwrap();
    let mut stream = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
    emulator.set_faults(Faults::none().rate(0.3, Fault::Doubled).seed(1));
    let mut latest = revolution(&next(&mut stream).await);
    for _ in 0..100 {
        let now = revolution(&next(&mut stream).await);
        assert!(latest < now, "{now} after {latest}");
        latest = now;
    }
    assert!(commands(&emulator, b"MD") > 0);
}

#[tokio::test(start_paused = true)]
async fn a_stream_that_would_fill_the_line_is_polled() {
    // Scans take 100 ms, 75 ms and 87 ms of each 100 ms, and of the 87 ms that a fast motor takes.
    for (last, revolution_ms, rate, is_polled) in [
        (472, 100, Rate::UNLIMITED, true),
        (472, 100, Rate::hz(5.0), false),
        (420, 100, Rate::UNLIMITED, false),
        (446, 100, Rate::UNLIMITED, false),
        (446, 87, Rate::UNLIMITED, true),
    ] {
        let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
        let emulator = emulator.revolution(Duration::from_millis(revolution_ms));
        let emulator = emulator.baud_rate(BaudRate::B57600).build();
        let asking = builder().protocol(Protocol::Scip2).baud_rate(BaudRate::B57600);
        let sensor = asking.connect(emulator.clone()).await.unwrap();
        let window = Window::new(300..=last).unwrap();
        let mut stream = sensor.scans(window, rate).await.unwrap();
        for _ in 0..100 {
            revolution(&next(&mut stream).await);
        }
        let polls = commands(&emulator, b"GD");
        for _ in 0..10 {
            revolution(&next(&mut stream).await);
        }
        assert_eq!(commands(&emulator, b"GD") > polls, is_polled, "{window}, {revolution_ms} ms");
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_of_another_program_leaves_the_laser_as_it_was() {
    for on in [true, false] {
        let emulator = numbered(Model::Ust10lx).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        sensor.scan(Window::DETECTION).await.unwrap();
        if !on {
            sensor.laser_off().await.unwrap();
        }
        let stops = commands(&emulator, b"QT");
        for _ in 0..2 {
            emulator.inject("MD0000108001000\n99b\n\n");
            sleep(Duration::from_secs(1)).await;
        }
        assert_eq!((commands(&emulator, b"QT"), emulator.is_laser_on()), (stops + 1, on));
        sensor.sensor_state().await.unwrap();
        assert_eq!(commands(&emulator, b"QT"), stops + 1);
    }
}

#[tokio::test(start_paused = true)]
async fn late_replies_are_no_stream() {
    let late = Faults::none().on("BM", Fault::Late(Duration::from_millis(60)));
    let emulator = numbered(Model::Ust10lx).faults(late).build();
    let hasty = builder().reply_latency(Duration::from_millis(50));
    let sensor = hasty.connect(emulator.clone()).await.unwrap();
    let stops = commands(&emulator, b"QT");
    for _ in 0..2 {
        sensor.scan(Window::DETECTION).await.unwrap();
    }
    assert_eq!(commands(&emulator, b"QT"), stops);
    let stats = sensor.stats();
    assert!(stats.timeouts > 0 && stats.bytes_skipped > 0, "{stats:?}");
}

#[tokio::test(start_paused = true)]
async fn scans_that_come_with_each_reply_are_a_stream() {
    let heads = [("MD", true), ("NE", true), ("VV", false)];
    // Such a stream is ended before a request for the state, before another one, and with the driver.
    for ((head, is_stream), next) in heads.into_iter().flat_map(|head| [0, 1, 2].map(|n| (head, n)))
    {
        let emulator = numbered(Model::Ust10lx).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        sensor.scan(Window::DETECTION).await.unwrap();
        let stops = commands(&emulator, b"QT");
        let scan = format!("{head}0000108001000\n99b\n\n");
        emulator.set_faults(Faults::none().once("GD", Fault::Garbage(scan.into_bytes())));
        sensor.scan(Window::DETECTION).await.unwrap();
        let mut stream = None;
        match next {
            0 => drop(sensor.sensor_state().await.unwrap()),
            1 => {
                let scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
                stream.insert(scans).next().await.unwrap().unwrap();
            }
            _ => sensor.close().await,
        }
        assert_eq!(commands(&emulator, b"QT") - stops, usize::from(is_stream), "{head}, {next}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_laser_is_switched_although_its_replies_are_lost() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    emulator.set_faults(Faults::none().on("QT", Fault::Lost).on("BM", Fault::Lost));
    for on in [true, false] {
        if on { sensor.laser_on().await } else { sensor.laser_off().await }.unwrap();
        assert_eq!(emulator.is_laser_on(), on);
    }
}

#[tokio::test(start_paused = true)]
async fn requests_wait_for_the_scans_on_a_slow_line() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
    let emulator = emulator.baud_rate(BaudRate::B19200).build();
    let hasty = builder().reply_latency(Duration::from_millis(120));
    let sensor = hasty.protocol(Protocol::Scip2).connect(emulator.clone()).await.unwrap();
    let window = Window::new(200..=400).unwrap();
    let mut stream = sensor.scans(window, Rate::hz(1.0)).await.unwrap();
    for n in 0..20 {
        next(&mut stream).await;
        sleep(Duration::from_millis(50 * n)).await;
        sensor.sensor_state().await.unwrap();
    }
    let stats = sensor.stats();
    assert_eq!((stats.timeouts, stats.bytes_skipped), (0, 0));
}

#[tokio::test(start_paused = true)]
async fn observers_take_no_probe_for_a_scan() {
    let (log, mut probes) = mpsc::unbounded_channel();
    let observed = builder().idle_probe(Some(Duration::from_millis(100))).on_reply(move |reply| {
        if reply.bytes.starts_with(b"GD") {
            let _ = log.send(reply.request.is_some());
        }
    });
    let sensor = observed.connect(numbered(Model::Ust10lx).build()).await.unwrap();
    assert!(!probes.recv().await.unwrap());
    sensor.scan(Window::DETECTION).await.unwrap();
    while !probes.recv().await.unwrap() {}
}

#[tokio::test(start_paused = true)]
async fn silence_is_told_before_a_stream_begins_anew() {
    for rate in [Rate::UNLIMITED, Rate::hz(0.5)] {
        let emulator = numbered(Model::Ust10lx).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
        next(&mut stream).await;
        emulator.set_faults(Faults::none().every(Fault::CommandLost));
        let start = Instant::now();
        let error = stream.next().await.unwrap().unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error}");
        assert!(start.elapsed() < Duration::from_millis(2600), "{rate}: {:?}", start.elapsed());
        // Nothing tells whether the sensor still sends one.
        let mut state = sensor.watch_state();
        let silent = state.wait_for(|state| matches!(state, State::Recovering));
        timeout(Duration::from_secs(5), silent).await.unwrap().unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn d16_a_stream_that_goes_on_is_ended_again() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let emulator = numbered(model).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        emulator.set_faults(Faults::none().once("QT", Fault::Ignored));
        drop(stream);
        sleep(Duration::from_secs(1)).await;
        revolution(&sensor.scan(Window::DETECTION).await.unwrap());
        sleep(Duration::from_secs(1)).await;
        let sent = emulator.counts().scans;
        sleep(Duration::from_secs(1)).await;
        assert_eq!(emulator.counts().scans, sent, "{model:?}");
        // Its laser was on.
        assert_eq!(sensor.stats().refused, 0, "{model:?}");
    }
}

/// Calls the request of this number.
async fn request(sensor: Sensor, number: usize) -> Result<(), Error> {
    match number {
        0 => sensor.laser_on().await,
        1 => sensor.laser_off().await,
        2 => sensor.scan(Window::DETECTION).await.map(drop),
        3 => sensor.sensor_state().await.map(drop),
        4 => sensor.set_baud_rate(BaudRate::B57600).await,
        _ => sensor.reboot().await,
    }
}

#[tokio::test(start_paused = true)]
async fn a17_closing_at_silence_takes_two_commands() {
    // Before the call, and whether there is a stream.
    let cases = (0..3000).step_by(230).flat_map(|ms| [(ms, true), (ms, false)]);
    for ((ms, streams), number) in cases.flat_map(|case| (0..6).map(move |number| (case, number))) {
        let emulator = numbered(Model::Ust10lx).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        let _stream = streams.then_some(stream);
        sleep(Duration::from_millis(100)).await;
        emulator.set_faults(Faults::none().every(Fault::CommandLost));
        tokio::spawn(request(sensor.clone(), number));
        sleep(Duration::from_millis(ms)).await;
        let start = Instant::now();
        sensor.close().await;
        // A scan is due after another revolution, and a restart takes longer.
        let limit = Duration::from_millis(if number < 5 { 1525 } else { 2000 });
        let took = start.elapsed();
        assert!(took <= limit, "{number} after {ms} ms, {streams}: {took:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_refuses_to_stop_is_told_again() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
    let emulator = emulator.baud_rate(BaudRate::B57600).build();
    let asking = builder().protocol(Protocol::Scip2).baud_rate(BaudRate::B57600);
    let sensor = asking.connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    let (stops, overlapping) = (commands(&emulator, b"QT"), emulator.counts().overlapping);
    emulator.set_faults(Faults::none().once("QT", Fault::Status(b'E')));
    drop(stream);
    sensor.set_baud_rate(BaudRate::B19200).await.unwrap();
    sensor.scan(Window::DETECTION).await.unwrap();
    assert_eq!(commands(&emulator, b"QT"), stops + 2);
    assert_eq!(emulator.counts().overlapping, overlapping);
}

#[tokio::test(start_paused = true)]
async fn scans_that_a_server_had_kept_are_no_flood() {
    let emulator = numbered(Model::Utm30lx).build();
    let (near, mut far) = duplex(256 * 1024);
    let mut link = emulator.link();
    let server = async {
        let mut command = [0; 16];
        let read = far.read(&mut command).await.unwrap();
        // 30 scans with intensities.
        far.write_all(&[&[b'x'; 6715][..], b"\n\n"].concat().repeat(30)).await.unwrap();
        link.write_all(&command[..read]).await.unwrap();
        copy_bidirectional(&mut far, &mut link).await
    };
    let sensor = tokio::select! {
        sensor = builder().attach(near) => sensor.unwrap(),
        ended = server => panic!("{ended:?}"),
    };
    drop(sensor);
}
