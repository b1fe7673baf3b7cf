//! Rows T: late, lost, doubled and slow replies.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::port::Port;
use tokio_scip::{BaudRate, ErrorKind, Rate, State, Window};
use urg_emulator::{EmptyCommand, Fault, Faults, Pace, Verdict};

use super::rig::{instant_sensor, open, scans, second_poll, streaming, wrong_scans};
use crate::common::faulty_link::{Call, FaultyLink, LinkFailure};
use crate::common::hooked::{Hooked, Hooks};
use crate::common::{ConnectFn, builder, ms, reply_len, truthful};
use crate::simulation::truth::SimulationTruth;

const WINDOW: Window = Window::DETECTION;

#[tokio::test(start_paused = true)]
async fn t01_a_late_reply_answers_no_later_poll() {
    for window in [Window::DETECTION, Window::FULL] {
        for late in (450..1500).step_by(10) {
            let outcome = second_poll(window, &[Fault::Late(ms(late))]).await;
            assert_eq!(outcome.accepted, late < 500, "{late} ms late");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn t02_very_late_replies_lose_the_link() {
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, Window::FULL, Rate::hz(10.0)).await;
    let mut delivered = scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().every(Fault::Late(ms(3000))));
    let before = sensor.stats();
    let mut state = sensor.watch_state();
    let since = Instant::now();
    state.wait_for(|state| matches!(state, State::Recovering)).await.map(drop).unwrap();
    // It waits for one poll and six fences, 500 ms each.
    assert!(since.elapsed() < ms(100 + 7 * 510), "{:?}", since.elapsed());
    let stats = sensor.stats();
    assert_eq!(stats.timeouts - before.timeouts, 1);
    assert_eq!(stats.fence_timeouts - before.fence_timeouts, 6);
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.map(drop).unwrap();
    emulator.set_faults(Faults::none());
    delivered.extend(scans(&mut stream, 20).await);
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
}

#[tokio::test(start_paused = true)]
async fn t02_lost_fences_cost_no_link() {
    let emulator = truthful().baud_rate(BaudRate::B115200).build();
    let bridged = emulator.clone();
    let bridge = ConnectFn(move || Ok(bridged.bridge(BaudRate::B115200)));
    let sensor = builder().connect(bridge).await.unwrap();
    // The poll and the fences after it.
    emulator.set_faults((0..6).fold(Faults::none(), |faults, at| faults.at(at, Fault::Lost)));
    sensor.scan(WINDOW).await.unwrap();
    let stats = sensor.stats();
    assert_eq!((stats.fence_timeouts, stats.disconnects, stats.reconnects), (5, 0, 0));
}

#[tokio::test(start_paused = true)]
async fn w12_a_reply_cut_after_its_echo_is_no_loopback() {
    let emulator = instant_sensor().build();
    let sensor = open(&emulator).await;
    // The poll is lost. Of the reply to the fence after it only the echo comes, which is all
    // that was sent.
    emulator.set_faults(Faults::none().at(0, Fault::Lost).at(1, Fault::Cut(10)));
    sensor.scan(WINDOW).await.unwrap();
    let stats = sensor.stats();
    assert_eq!((stats.fence_timeouts, stats.disconnects, stats.reconnects), (1, 0, 0));
}

#[tokio::test(start_paused = true)]
async fn t03_an_immediate_copy_is_not_delivered() {
    // Polls at the highest rate, so that the driver is never idle between two polls, and with
    // the full window, where polls cannot differ.
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, Window::FULL, Rate::UNLIMITED).await;
    let mut delivered = scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().rate(0.5, Fault::Doubled));
    for _ in 0..300 {
        delivered.extend(scans(&mut stream, 1).await);
    }
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
    assert!(emulator.fault_count(&Fault::Doubled) > 100);
    assert_eq!(sensor.stats().disconnects, 0);
}

#[tokio::test(start_paused = true)]
async fn t03_a_late_copy_is_not_delivered() {
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
    let mut delivered = scans(&mut stream, 1).await;
    // The copy arrives while the next poll waits for its reply, whether the faulty poll
    // asks for one step more, as it does, or for the same window.
    let mut faults = Faults::none().at(0, Fault::Doubled);
    for start in [43, 44] {
        let length = reply_len(Window::new(start..=725).unwrap());
        faults = faults.at(0, Fault::Pause(length, ms(150)));
    }
    emulator.set_faults(faults);
    delivered.extend(scans(&mut stream, 5).await);
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
    assert!(sensor.stats().malformed.echo >= 1, "the copy was not dropped for its echo");
    assert_eq!(sensor.stats().disconnects, 0);
}

/// Windows that leave no room for polls to differ.
fn without_room() -> [Window; 4] {
    let clustered = |window: Window, count| window.with_cluster_count(count).unwrap();
    [
        Window::FULL,
        clustered(Window::DETECTION, 45),
        clustered(Window::new(0..=725).unwrap(), 4),
        clustered(Window::new(1..=768).unwrap(), 2),
    ]
}

#[tokio::test(start_paused = true)]
async fn t13_an_immediate_copy_is_no_scan() {
    for (window, baud_rate) in without_room().into_iter().flat_map(|window| {
        [BaudRate::B19200, BaudRate::B115200, BaudRate::B750000].map(|rate| (window, rate))
    }) {
        for behind in [1, 5] {
            // This truth's values name their request also in clusters.
            let truth = SimulationTruth::default();
            let emulator = truthful().world(truth.world()).baud_rate(baud_rate).build();
            let (_sensor, mut stream) = streaming(&emulator, window, Rate::UNLIMITED).await;
            let mut faults = Faults::none();
            for reply in (0..200).step_by(5) {
                let pause = Fault::Pause(reply_len(window), ms(behind));
                faults = faults.at(reply, Fault::Doubled).at(reply, pause);
            }
            let mut delivered = scans(&mut stream, 1).await;
            emulator.set_faults(faults);
            while emulator.fault_count(&Fault::Doubled) < 20 {
                delivered.extend(stream.next().await.unwrap().ok());
            }
            let wrong: Vec<_> =
                delivered.iter().filter_map(|s| truth.check(&s.into(), 0).err()).collect();
            assert_eq!(wrong, [""; 0], "{window} at {baud_rate} baud, {behind} ms");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn t13_a_premature_reply_is_refused() {
    let window = Window::FULL.with_cluster_count(99).unwrap();
    let truth = SimulationTruth::default();
    let emulator = truthful().pace(Pace::AtOnce).baud_rate(BaudRate::B19200);
    let emulator = emulator.world(truth.world()).build();
    let (sensor, mut stream) = streaming(&emulator, window, Rate::hz(10.0)).await;
    let mut delivered = scans(&mut stream, 2).await;
    let took = delivered[1].received_at() - delivered[1].times().requested_at;
    assert_eq!(sensor.stats().malformed.total(), 0, "an answer without delay is refused");
    for after in 1..=4 {
        // The copy begins `after` ms after the next poll was sent, which takes 5.2 ms on the
        // wire.
        let pause = Fault::Pause(reply_len(window), ms(100 + after) - took);
        emulator.set_faults(Faults::none().at(0, Fault::Doubled).at(0, pause));
        for _ in 0..5 {
            delivered.extend(stream.next().await.unwrap().ok());
        }
    }
    let wrong: Vec<_> = delivered.iter().filter_map(|s| truth.check(&s.into(), 0).err()).collect();
    assert_eq!(wrong, [""; 0]);
    assert!(sensor.stats().malformed.echo >= 3, "{:?}", sensor.stats());
}

/// Claims a baud rate for a port that delivers bytes at once.
struct ClaimBaudRate;

impl Hooks for ClaimBaudRate {
    fn baud_rate(&self, _of_port: Option<BaudRate>) -> Option<BaudRate> {
        Some(BaudRate::B19200)
    }
}

#[tokio::test(start_paused = true)]
async fn o26_prompt_replies_disprove_no_baud_rate() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    sensor.scan(WINDOW).await.unwrap();
    // Confirmed by a fence that is refused.
    sensor.laser_off().await.unwrap();
    assert!(!sensor.stats().baud_rate_disproved);
}

#[tokio::test(start_paused = true)]
async fn o26_replies_faster_than_the_baud_rate_disprove_it() {
    let slow = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&slow).await;
    sensor.scan(WINDOW).await.unwrap();
    assert!(!sensor.stats().baud_rate_disproved);
    let fast = truthful().pace(Pace::AtOnce).latency(ms(1)).usb().build();
    let sensor = builder()
        .connect(ConnectFn(move || Ok(Hooked { port: fast.link(), hooks: ClaimBaudRate })))
        .await
        .unwrap();
    let mut stream = sensor.scans(Window::FULL, Rate::UNLIMITED).await.unwrap();
    scans(&mut stream, 20).await;
    let stats = sensor.stats();
    assert!(stats.baud_rate_disproved && stats.malformed.total() == 0, "{stats:?}");
    assert_eq!(stats.fences, 1, "a fence between polls on a link without a serial line");
}

#[tokio::test(start_paused = true)]
async fn o26_a_scan_disproves_the_baud_rate() {
    let fast = truthful().pace(Pace::AtOnce).latency(ms(100)).usb().build();
    let sensor = builder()
        .connect(ConnectFn(move || Ok(Hooked { port: fast.link(), hooks: ClaimBaudRate })))
        .await
        .unwrap();
    assert!(!sensor.stats().baud_rate_disproved);
    // 734 ms at 19,200 baud.
    sensor.scan(Window::DETECTION).await.unwrap();
    assert!(sensor.stats().baud_rate_disproved);
}

/// A port that ignores its baud rate is replaced by a serial line.
#[tokio::test(start_paused = true)]
async fn o26_a_new_link_has_no_disproved_baud_rate() {
    let fast = truthful().pace(Pace::AtOnce).latency(ms(1)).usb().build();
    let slow = truthful().baud_rate(BaudRate::B19200).build();
    let unplugged = fast.clone();
    let mut first = Some(Hooked { port: fast.link(), hooks: ClaimBaudRate });
    let connect = move || {
        let first = first.take().map(|port| Box::new(port) as Box<dyn Port>);
        Ok(first.unwrap_or_else(|| Box::new(slow.link())))
    };
    let sensor = builder().connect(ConnectFn(connect)).await.unwrap();
    sensor.scan(WINDOW).await.unwrap();
    assert!(sensor.stats().baud_rate_disproved);
    let mut state = sensor.watch_state();
    unplugged.unplug();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
    state.connected().await.unwrap();
    sensor.scan(WINDOW).await.unwrap();
    assert!(!sensor.stats().baud_rate_disproved);
}

#[tokio::test(start_paused = true)]
async fn t04_a_lost_command_is_retried_and_counted() {
    let emulator = instant_sensor().baud_rate(BaudRate::B115200).build();
    let sensor = open(&emulator).await;
    for fault in [Fault::CommandLost, Fault::Lost] {
        let before = sensor.stats().timeouts;
        emulator.set_faults(Faults::none().at(0, fault.clone()));
        sensor.scan(WINDOW).await.unwrap();
        emulator.set_faults(Faults::none().at(0, fault.clone()));
        sensor.laser_off().await.unwrap();
        emulator.set_faults(Faults::none().at(0, fault.clone()));
        sensor.laser_on().await.unwrap();
        assert!(emulator.is_laser_on());
        assert_eq!(sensor.stats().timeouts - before, 3, "{fault:?}");
    }
    // Lost twice in a row, with a fence in between, it is an error.
    emulator.set_faults(Faults::none().at(0, Fault::Lost).at(2, Fault::Lost));
    let error = sensor.scan(WINDOW).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error:?}");
    sensor.scan(WINDOW).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn t05_half_a_stalled_command_is_terminated() {
    for empty in [EmptyCommand::Silence, EmptyCommand::Status, EmptyCommand::LineFeeds] {
        for stalled_after in 1..10 {
            let emulator = instant_sensor().empty_command(empty).build();
            let (inner, mut opened) = (emulator.clone(), 0);
            let connect = ConnectFn(move || {
                let link = FaultyLink::new(inner.link()).partial_writes(1);
                opened += 1;
                // The commands are a fence of ten bytes, `V` LF twice, and a `G`.
                let stall = if opened == 1 { 14 + stalled_after } else { u64::MAX };
                Ok(link.fail(Call::Write, stall, LinkFailure::Stall))
            });
            let sensor = builder().connect(connect).await.unwrap();
            let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
            let delivered = scans(&mut stream, 3).await;
            assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
            let log = emulator.log();
            let halves = log.iter().filter(|line| line.verdict == Verdict::Malformed);
            let halves: Vec<_> = halves.map(|line| line.line.clone()).collect();
            let expected = b"G04472501"[..stalled_after as usize].to_vec();
            // A complete command without its LF becomes valid by the LF that ends it.
            let expected = if stalled_after == 9 { vec![] } else { vec![expected] };
            assert_eq!(halves, expected, "stalled after {stalled_after} bytes");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn t06_a_slow_line_gets_no_backlog() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
    let delivered = scans(&mut stream, 50).await;
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
    let stats = sensor.stats();
    assert_eq!((emulator.counts().overlapping, stats.timeouts), (0, 0));
    assert!(stats.polls_skipped > 6 * stats.polls, "{stats:?}");
}

#[tokio::test(start_paused = true)]
async fn t07_a_reply_that_trickles_in_times_out_at_its_deadline() {
    let emulator = instant_sensor().build();
    let (_sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(10.0)).await;
    scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().at(0, Fault::Trickle(ms(100))));
    let start = Instant::now();
    let error = stream.next().await.unwrap().unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error:?}");
    // The deadline of 500 ms, and at most 100 ms until the poll is due.
    assert!(start.elapsed() <= ms(601), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn t08_a_last_byte_at_the_deadline_counts() {
    let window = Window::new(384..=384).unwrap();
    // The time of command and reply on USB, 2,666 ns a byte.
    let wire = Duration::from_nanos(2_666) * (10 + 16);
    let mut last = 0;
    for tenths in 4970..5030 {
        let latency = Duration::from_micros(tenths * 100);
        let emulator = instant_sensor().build();
        let sensor = open(&emulator).await;
        let before = sensor.stats();
        emulator.set_faults(Faults::none().at(0, Fault::Late(latency)));
        let scan = sensor.scan(window).await.unwrap();
        assert_eq!(wrong_scans(&emulator, &[scan]), [""; 0]);
        let timeouts = sensor.stats().timeouts - before.timeouts;
        if latency + wire <= ms(500) {
            assert_eq!(timeouts, 0, "{latency:?}: in time, but not accepted");
            last = tenths;
        } else if latency + wire > ms(501) {
            assert_eq!(timeouts, 1, "{latency:?}: too late, but accepted");
        }
    }
    assert_eq!(last, 4999);
}

#[tokio::test(start_paused = true)]
async fn t09_unrequested_bytes_are_read_counted_and_dropped() {
    let emulator = instant_sensor().build();
    let sensor = open(&emulator).await;
    sensor.scan(Window::FULL).await.unwrap();
    // A reply to the very next poll, and parts of one.
    let data = vec![b'0'; 2 * 769];
    let lines = data.chunks(64).collect::<Vec<_>>().join(&b'\n');
    let reply = [&b"G00076801\n0\n"[..], &lines, b"\n\n"].concat();
    for stray in [&reply[..], &reply[..700], &reply[..reply.len() - 1], b"\0", b"\n", b"V\n0\n\n"] {
        let before = sensor.stats();
        emulator.inject(stray);
        tokio::time::sleep(Duration::from_secs(10)).await;
        let scan = sensor.scan(Window::FULL).await.unwrap();
        assert_eq!(wrong_scans(&emulator, &[scan]), [""; 0]);
        let stats = sensor.stats();
        assert_eq!(stats.timeouts, before.timeouts);
        let skipped = stats.bytes_skipped - before.bytes_skipped;
        assert!((1..=stray.len() as u64).contains(&skipped) || stray == b"\0", "{skipped} bytes");
        assert!(stats.fences > before.fences || stray == b"\0", "no fence was raised");
    }
}

#[tokio::test(start_paused = true)]
async fn t10_a_booting_sensor_is_awaited() {
    for speed in [None, Some(BaudRate::B115200)] {
        let boot = Duration::from_secs(7);
        let mut sensor = instant_sensor().boot_time(boot);
        if let Some(speed) = speed {
            sensor = sensor.baud_rate(speed);
        }
        let emulator = sensor.build();
        let sensor = builder().wait_for_sensor(true).connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(WINDOW, Rate::hz(2.0)).await.unwrap();
        scans(&mut stream, 1).await;
        emulator.unplug();
        tokio::time::sleep(Duration::from_secs(2)).await;
        emulator.power_cycle();
        emulator.plug_in();
        let start = Instant::now();
        while stream.next().await.unwrap().map_or(true, |s| s.times().requested_at < start) {}
        let limit = boot + Duration::from_secs(5);
        assert!(start.elapsed() < limit, "{speed:?}: {:?}", start.elapsed());
    }
}

#[tokio::test(start_paused = true)]
async fn t12_a_late_fence_reply_is_not_mistaken() {
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, Window::FULL, Rate::hz(10.0)).await;
    let mut delivered = scans(&mut stream, 1).await;
    let polls = emulator.log().len();
    // The poll is lost; its fence is late, and so is the next fence.
    let faults = Faults::none().at(0, Fault::Lost).at(1, Fault::Late(ms(700)));
    emulator.set_faults(faults.at(2, Fault::Late(ms(600))));
    let before = sensor.stats();
    delivered.extend(scans(&mut stream, 5).await);
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0]);
    let stats = sensor.stats();
    assert!(stats.fence_timeouts - before.fence_timeouts >= 2, "{stats:?}");
    // No poll is sent before the last fence is answered, and no two fences are equal.
    let log = emulator.log();
    let sent: Vec<&[u8]> = log[polls..].iter().map(|line| &line.line[..]).collect();
    let poll = &b"G00076801"[..];
    assert_eq!(sent[0], poll);
    let fences: Vec<_> = sent[1..].iter().take_while(|line| **line != poll).collect();
    assert_eq!(fences.len() as u64, stats.fences - before.fences);
    assert!(fences.iter().enumerate().all(|(n, fence)| !fences[..n].contains(fence)));
    assert_eq!(stats.disconnects, 0);
}
