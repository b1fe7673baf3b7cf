//! Successive commands of the driver differ, so that a doubled reply cannot match the next
//! command. `simulation` shows the effect.

use crate::common::{Truth, builder, ms, truthful};
use tokio::time::Instant;
use tokio_scip::{BaudRate, Rate, Scan, Stats, Window};
use urg_emulator::{Emulator, Fault, Faults, Pace};

/// Streams until the sensor has had `polls` polls. Returns the scans delivered, and the
/// driver's counters.
async fn stream(emulator: &Emulator, window: Window, rate: Rate, polls: u64) -> (Vec<Scan>, Stats) {
    let sensor = builder().depth(16).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(window, rate).await.unwrap();
    let mut scans = Vec::new();
    while sensor.stats().polls < polls {
        if let Ok(scan) = stream.next().await.unwrap() {
            scans.push(scan);
        }
    }
    assert_eq!(stream.missed(), 0);
    let stats = sensor.stats();
    (scans, stats)
}

fn wrong(emulator: &Emulator, scans: &[Scan]) -> Vec<String> {
    let mut truth = Truth::from_log(&emulator.log());
    scans.iter().filter_map(|scan| truth.check(scan).err()).collect()
}

#[tokio::test(start_paused = true)]
async fn a_clean_line_needs_no_fence_after_the_first() {
    let emulator = truthful().build();
    let (scans, stats) = stream(&emulator, Window::DETECTION, Rate::hz(10.0), 100).await;
    assert_eq!(wrong(&emulator, &scans), Vec::<String>::new());
    assert_eq!((stats.fences, stats.timeouts, stats.bytes_skipped), (1, 0, 0));
    assert_eq!(emulator.counts().overlapping, 0);
}

#[tokio::test(start_paused = true)]
async fn successive_polls_differ_wherever_the_window_leaves_any_room() {
    for (steps, echoes) in [(0..=765, 4), (0..=766, 3), (0..=767, 2), (1..=768, 2), (2..=768, 3)] {
        let emulator = truthful().pace(Pace::AtOnce).build();
        stream(&emulator, Window::new(steps.clone()).unwrap(), Rate::UNLIMITED, 40).await;
        let log = emulator.log();
        let polls: Vec<_> = log.iter().filter(|line| line.line.starts_with(b"G")).skip(1).collect();
        assert!(polls.len() >= 30);
        for some in polls.windows(echoes) {
            let mut lines: Vec<_> = some.iter().map(|poll| &poll.line).collect();
            lines.sort();
            lines.dedup();
            assert_eq!(lines.len(), echoes, "{steps:?}: {some:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_doubled_fence_reply_is_no_scan() {
    // The first fence asks for step 0, and the copy of its reply is late enough to arrive
    // after the next command.
    for step in 0..4 {
        let fence = Faults::none().at(0, Fault::Doubled).rate(0.3, Fault::Late(ms(400))).seed(5);
        let emulator = truthful().pace(Pace::AtOnce).faults(fence).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let fences = sensor.stats().fences;
        assert!(fences >= 1);
        sensor.scan(Window::new(step..=step).unwrap()).await.unwrap();
        let log = emulator.log();
        let echo = |n: usize| log.iter().rev().filter(|line| line.line.starts_with(b"G")).nth(n);
        assert_ne!(echo(0).map(|g| &g.line), echo(1).map(|g| &g.line));
    }
}

#[tokio::test(start_paused = true)]
async fn equal_polls_reach_the_rate_of_the_motor() {
    let window = Window::FULL.with_cluster_count(99).unwrap();
    let emulator = truthful().baud_rate(BaudRate::B115200).build();
    let sensor = builder().connect(emulator).await.unwrap();
    let mut scans = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
    let fences = sensor.stats().fences;
    scans.next().await.unwrap().unwrap();
    let start = Instant::now();
    for _ in 0..100 {
        scans.next().await.unwrap().unwrap();
    }
    assert!(start.elapsed() <= ms(10_200), "{:?}", start.elapsed());
    assert_eq!(sensor.stats().fences, fences);
}
