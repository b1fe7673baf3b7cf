//! Rows T: replies that are late, lost, doubled, or slow.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Instant;
use tokio_scip::emulator::{
    Call, EmptyCommand, Fault, Faults, FaultyLink, LinkFailure, Pace, Verdict,
};
use tokio_scip::{BaudRate, Error, Port, Rate, State, Window};

use super::rig::{lies, open, prompt, scans, second_poll};
use crate::common::{Rigged, builder, ms, truthful};
use crate::simulation::truth::Truth;

const WINDOW: Window = Window::DETECTION;

#[tokio::test(start_paused = true)]
async fn t01_a_late_reply_is_dropped_and_the_next_scan_is_its_own() {
    for window in [Window::DETECTION, Window::FULL] {
        for late in (450..1500).step_by(10) {
            let outcome = second_poll(window, &[Fault::Late(ms(late))]).await;
            assert_eq!(outcome.accepted, late < 500, "{late} ms late");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn t02_replies_that_are_all_very_late_end_in_a_lost_link_and_no_wrong_scan() {
    let emulator = prompt().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::FULL, Rate::hz(10.0)).await.unwrap();
    let mut delivered = scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().every(Fault::Late(ms(3000))));
    let before = sensor.stats();
    let mut state = sensor.state();
    let since = Instant::now();
    state.wait_for(|state| matches!(state, State::Recovering)).await.map(drop).unwrap();
    // One poll and six fences, half a second each.
    assert!(since.elapsed() < ms(100 + 7 * 510), "{:?}", since.elapsed());
    let stats = sensor.stats();
    assert_eq!(stats.timeouts - before.timeouts, 1);
    assert_eq!(stats.fence_timeouts - before.fence_timeouts, 6);
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.map(drop).unwrap();
    emulator.set_faults(Faults::none());
    delivered.extend(scans(&mut stream, 20).await);
    assert_eq!(lies(&emulator, &delivered), [""; 0]);
}

#[tokio::test(start_paused = true)]
async fn t03_a_second_copy_behind_a_reply_is_not_the_answer_to_the_next_poll() {
    // As fast as it goes, so that nothing reads between two polls; and the
    // whole turn, where all polls are the same.
    let emulator = prompt().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::FULL, Rate::MAX).await.unwrap();
    let mut delivered = scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().rate(0.5, Fault::Doubled));
    for _ in 0..300 {
        delivered.extend(scans(&mut stream, 1).await);
    }
    assert_eq!(lies(&emulator, &delivered), [""; 0]);
    assert!(emulator.fault_counts().doubled > 100);
    assert_eq!(sensor.stats().disconnects, 0);
}

#[tokio::test(start_paused = true)]
async fn t03_a_second_copy_that_comes_after_the_next_poll_is_not_its_answer() {
    let emulator = prompt().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let mut delivered = scans(&mut stream, 1).await;
    // The copy arrives while the poll that follows waits for its answer, whether
    // the faulty poll asked for a step more, as it does, or for the same.
    let mut faults = Faults::none().at(0, Fault::Doubled);
    for start in [43, 44] {
        let length = Window::new(start..=725).unwrap().reply_len();
        faults = faults.at(0, Fault::Pause(length, ms(150)));
    }
    emulator.set_faults(faults);
    delivered.extend(scans(&mut stream, 5).await);
    assert_eq!(lies(&emulator, &delivered), [""; 0]);
    assert!(sensor.stats().malformed.echo >= 1, "the copy was not seen");
    assert_eq!(sensor.stats().disconnects, 0);
}

/// Windows whose polls have no room to differ.
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
async fn t13_a_copy_right_behind_a_reply_is_not_the_next_scan_where_polls_cannot_differ() {
    for (window, baud_rate) in without_room().into_iter().flat_map(|window| {
        [BaudRate::B19200, BaudRate::B115200, BaudRate::B750000].map(|rate| (window, rate))
    }) {
        for behind in [1, 5] {
            // Whose values tell their request in groups, too.
            let truth = Truth::default();
            let emulator = truthful().world(truth.world()).baud_rate(baud_rate).build();
            let sensor = open(&emulator).await;
            let mut stream = sensor.scans(window, Rate::MAX).await.unwrap();
            let mut faults = Faults::none();
            for reply in (0..200).step_by(5) {
                let pause = Fault::Pause(window.reply_len(), ms(behind));
                faults = faults.at(reply, Fault::Doubled).at(reply, pause);
            }
            let mut delivered = scans(&mut stream, 1).await;
            emulator.set_faults(faults);
            while emulator.fault_counts().doubled < 20 {
                delivered.extend(stream.next().await.unwrap().ok());
            }
            let wrong: Vec<_> =
                delivered.iter().filter_map(|s| truth.check(&s.into(), 0).err()).collect();
            assert_eq!(wrong, [""; 0], "{window} at {baud_rate} baud, {behind} ms");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn t13_a_reply_that_begins_before_its_command_has_left_the_wire_is_refused() {
    let window = Window::FULL.with_cluster_count(99).unwrap();
    let truth = Truth::default();
    let emulator = truthful().pace(Pace::AtOnce).baud_rate(BaudRate::B19200);
    let emulator = emulator.world(truth.world()).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
    let mut delivered = scans(&mut stream, 2).await;
    let took = delivered[1].received_at() - delivered[1].requested_at();
    for after in 1..=4 {
        // The copy begins so many milliseconds after the next poll was sent, which takes
        // 5.2 ms on the wire.
        let pause = Fault::Pause(window.reply_len(), ms(100 + after) - took);
        emulator.set_faults(Faults::none().at(0, Fault::Doubled).at(0, pause));
        for _ in 0..5 {
            delivered.extend(stream.next().await.unwrap().ok());
        }
    }
    let wrong: Vec<_> = delivered.iter().filter_map(|s| truth.check(&s.into(), 0).err()).collect();
    assert_eq!(wrong, [""; 0]);
    assert!(sensor.stats().malformed.echo >= 3, "{:?}", sensor.stats());
}

/// A port that has a baud rate, and brings bytes at once.
struct Claiming<P>(P);

impl<P: Port> Port for Claiming<P> {
    fn baud_rate(&self) -> Option<BaudRate> {
        Some(BaudRate::B19200)
    }
}

impl<P: AsyncRead + Unpin> AsyncRead for Claiming<P> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_read(cx, buffer)
    }
}

impl<P: AsyncWrite + Unpin> AsyncWrite for Claiming<P> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.0).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(cx)
    }
}

#[tokio::test(start_paused = true)]
async fn o26_a_baud_rate_that_replies_outrun_is_disproved() {
    let slow = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&slow).await;
    sensor.scan(WINDOW).await.unwrap();
    assert!(!sensor.stats().baud_rate_outrun);
    let fast = truthful().pace(Pace::AtOnce).latency(ms(1)).usb().build();
    let sensor = builder().connect(Rigged(move || Ok(Claiming(fast.link())))).await.unwrap();
    let mut stream = sensor.scans(Window::FULL, Rate::MAX).await.unwrap();
    scans(&mut stream, 20).await;
    let stats = sensor.stats();
    assert!(stats.baud_rate_outrun && stats.malformed.total() == 0, "{stats:?}");
    assert_eq!(stats.fences, 1, "a fence between polls on a link without a serial line");
}

#[tokio::test(start_paused = true)]
async fn t04_a_lost_command_is_given_again_and_counted() {
    let emulator = prompt().baud_rate(BaudRate::B115200).build();
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
    // Twice in a row (with a fence between) it is an error.
    emulator.set_faults(Faults::none().at(0, Fault::Lost).at(2, Fault::Lost));
    let error = sensor.scan(WINDOW).await.unwrap_err();
    assert!(matches!(error, Error::Timeout { .. }), "{error:?}");
    sensor.scan(WINDOW).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn t05_half_a_command_left_by_a_stalled_write_is_ended_before_the_next_one() {
    for empty in [EmptyCommand::Silence, EmptyCommand::Status, EmptyCommand::LineFeeds] {
        for stalled_after in 1..10 {
            let emulator = prompt().empty_command(empty).build();
            let (inner, mut opened) = (emulator.clone(), 0);
            let connect = Rigged(move || {
                let link = FaultyLink::new(inner.link()).partial_writes(1);
                opened += 1;
                // LF, a fence of ten bytes, twice V with its LF, and then a G.
                let stall = if opened == 1 { 15 + stalled_after } else { u64::MAX };
                Ok(link.fail(Call::Write, stall, LinkFailure::Stall))
            });
            let sensor = builder().connect(connect).await.unwrap();
            let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
            let delivered = scans(&mut stream, 3).await;
            assert_eq!(lies(&emulator, &delivered), [""; 0]);
            let log = emulator.log();
            let halves = log.iter().filter(|line| line.verdict == Verdict::Malformed);
            let halves: Vec<_> = halves.map(|line| line.line.clone()).collect();
            let expected = b"G04472501"[..stalled_after as usize].to_vec();
            // A whole command without its LF is a command.
            let expected = if stalled_after == 9 { vec![] } else { vec![expected] };
            assert_eq!(halves, expected, "stalled after {stalled_after} bytes");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn t06_a_slow_line_is_polled_without_overlap_and_without_a_backlog() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let delivered = scans(&mut stream, 50).await;
    assert_eq!(lies(&emulator, &delivered), [""; 0]);
    let stats = sensor.stats();
    assert_eq!((emulator.counts().overlapping, stats.timeouts), (0, 0));
    assert!(stats.polls_skipped > 6 * stats.polls, "{stats:?}");
}

#[tokio::test(start_paused = true)]
async fn t07_a_reply_that_trickles_in_is_given_up_at_its_deadline() {
    let emulator = prompt().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().at(0, Fault::Trickle(ms(100))));
    let start = Instant::now();
    let error = stream.next().await.unwrap().unwrap_err();
    assert!(matches!(error, Error::Timeout { .. }), "{error:?}");
    // Half a second, after at most a tenth until the poll is due.
    assert!(start.elapsed() <= ms(601), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn t08_a_reply_whose_last_byte_comes_at_the_deadline_is_in_time() {
    let window = Window::new(384..=384).unwrap();
    // What the command and the reply take on USB, 2,666 ns a byte.
    let wire = Duration::from_nanos(2_666) * (10 + 16);
    let mut last = 0;
    for tenths in 4970..5030 {
        let latency = Duration::from_micros(tenths * 100);
        let emulator = prompt().build();
        let sensor = open(&emulator).await;
        let before = sensor.stats();
        emulator.set_faults(Faults::none().at(0, Fault::Late(latency)));
        let scan = sensor.scan(window).await.unwrap();
        assert_eq!(lies(&emulator, &[scan]), [""; 0]);
        let timeouts = sensor.stats().timeouts - before.timeouts;
        if latency + wire <= ms(500) {
            assert_eq!(timeouts, 0, "{latency:?}: in time, and not taken");
            last = tenths;
        } else if latency + wire > ms(501) {
            assert_eq!(timeouts, 1, "{latency:?}: too late, and taken");
        }
    }
    assert_eq!(last, 4999);
}

#[tokio::test(start_paused = true)]
async fn t09_what_comes_while_nothing_is_asked_for_is_read_counted_and_dropped() {
    let emulator = prompt().build();
    let sensor = open(&emulator).await;
    sensor.scan(Window::FULL).await.unwrap();
    // A reply to the very poll that comes next, and half a one.
    let data = vec![b'0'; 2 * 769];
    let lines = data.chunks(64).collect::<Vec<_>>().join(&b'\n');
    let reply = [&b"G00076801\n0\n"[..], &lines, b"\n\n"].concat();
    for stray in [&reply[..], &reply[..700], &reply[..reply.len() - 1], b"\0", b"\n", b"V\n0\n\n"] {
        let before = sensor.stats();
        emulator.inject(stray);
        tokio::time::sleep(Duration::from_secs(10)).await;
        let scan = sensor.scan(Window::FULL).await.unwrap();
        assert_eq!(lies(&emulator, &[scan]), [""; 0]);
        let stats = sensor.stats();
        assert_eq!(stats.timeouts, before.timeouts);
        let skipped = stats.bytes_skipped - before.bytes_skipped;
        assert!((1..=stray.len() as u64).contains(&skipped) || stray == b"\0", "{skipped} bytes");
        assert!(stats.fences > before.fences || stray == b"\0", "no fence was raised");
    }
}

#[tokio::test(start_paused = true)]
async fn t10_a_sensor_that_boots_after_a_replug_is_back_when_it_has_booted() {
    for speed in [None, Some(BaudRate::B115200)] {
        let boot = Duration::from_secs(7);
        let mut sensor = prompt().boot_time(boot);
        if let Some(speed) = speed {
            sensor = sensor.baud_rate(speed);
        }
        let emulator = sensor.build();
        let sensor = builder().wait_for_sensor().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(WINDOW, Rate::hz(2.0)).await.unwrap();
        scans(&mut stream, 1).await;
        emulator.unplug();
        tokio::time::sleep(Duration::from_secs(2)).await;
        emulator.power_cycle();
        emulator.plug_in();
        let start = Instant::now();
        while stream.next().await.unwrap().map_or(true, |s| s.requested_at() < start) {}
        let limit = boot + Duration::from_secs(5);
        assert!(start.elapsed() < limit, "{speed:?}: {:?}", start.elapsed());
    }
}

#[tokio::test(start_paused = true)]
async fn t12_the_late_answer_of_one_fence_is_not_that_of_the_next() {
    let emulator = prompt().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::FULL, Rate::hz(10.0)).await.unwrap();
    let mut delivered = scans(&mut stream, 1).await;
    let polls = emulator.log().len();
    // The poll is lost, its fence is late, and the fence after that too.
    let faults = Faults::none().at(0, Fault::Lost).at(1, Fault::Late(ms(700)));
    emulator.set_faults(faults.at(2, Fault::Late(ms(600))));
    let before = sensor.stats();
    delivered.extend(scans(&mut stream, 5).await);
    assert_eq!(lies(&emulator, &delivered), [""; 0]);
    let stats = sensor.stats();
    assert!(stats.fence_timeouts - before.fence_timeouts >= 2, "{stats:?}");
    // Nothing is asked for before the last fence, and no fence is like another.
    let log = emulator.log();
    let sent: Vec<&[u8]> = log[polls..].iter().map(|line| &line.line[..]).collect();
    let poll = &b"G00076801"[..];
    assert_eq!(sent[0], poll);
    let fences: Vec<_> = sent[1..].iter().take_while(|line| **line != poll).collect();
    assert_eq!(fences.len() as u64, stats.fences - before.fences);
    assert!(fences.iter().enumerate().all(|(n, fence)| !fences[..n].contains(fence)));
    assert_eq!(stats.disconnects, 0);
}
