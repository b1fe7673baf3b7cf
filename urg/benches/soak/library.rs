//! The process that uses the library: a recorder and eight streams share one sensor. It
//! writes a line of counts for each line of its standard input, and ends with it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout_at};
use tokio_scip::{Rate, ScanStream, Sensor, Window};
use urg_recording::{Recorder, RecorderBuilder};

/// 6.4 s at 10 Hz: nobody who reads at once misses a scan, also on a busy machine.
const DEPTH: usize = 64;
const STREAMS: u64 = 8;
const SPLIT: Duration = Duration::from_secs(60);

/// Scans that were missed by streams that read at once, and by the one that does not.
#[derive(Default)]
struct Missed {
    keeping_up: AtomicU64,
    slow: AtomicU64,
    opened: AtomicU64,
}

pub(crate) async fn run(port: &str, file: &str) {
    let builder: RecorderBuilder = Recorder::builder().split_duration(SPLIT);
    let mut recorder = builder.create(file).unwrap();
    let builder = Sensor::builder().on_reply(recorder.observer()).depth(DEPTH);
    let sensor = builder.open(port).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    recorder.describe(&sensor, &scans).await.unwrap();

    let missed = Arc::new(Missed::default());
    let mut streams = JoinSet::new();
    for place in 0..STREAMS {
        streams.spawn(come_and_go(place, sensor.clone(), Arc::clone(&missed)));
    }
    let mut requests = BufReader::new(tokio::io::stdin()).lines();
    let (mut last, mut longest_gap) = (None, Duration::ZERO);
    let mut recorded = 0;
    loop {
        tokio::select! {
            item = scans.next() => {
                let item = item.expect("a stream that goes on");
                recorder.record(&item).unwrap();
                if let Ok(scan) = item {
                    recorded += 1;
                    let gap = last.replace(scan.received_at());
                    let gap = gap.map_or(Duration::ZERO, |last| scan.received_at() - last);
                    longest_gap = longest_gap.max(gap);
                }
            }
            request = requests.next_line() => {
                if request.unwrap().is_none() {
                    break;
                }
                report(&recorder, &sensor, &scans, &missed, recorded, longest_gap);
            }
        }
    }
    streams.shutdown().await;
    report(&recorder, &sensor, &scans, &missed, recorded, longest_gap);
    drop(scans);
    sensor.close().await;
    let progress = recorder.finish().await.unwrap();
    assert_eq!(progress.scans, recorded);
    println!("files={}", progress.files);
}

fn report(
    recorder: &Recorder,
    sensor: &Sensor,
    scans: &ScanStream,
    missed: &Missed,
    recorded: u64,
    longest_gap: Duration,
) {
    let (progress, stats) = (recorder.progress(), sensor.stats());
    let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
    println!(
        "recorded={recorded} files={} lost={} missed={} slow_missed={} opened={} reconnects={} \
         skipped={} longest_gap_ms={}",
        progress.files,
        progress.lost + progress.lost_replies,
        scans.missed() + count(&missed.keeping_up),
        count(&missed.slow),
        count(&missed.opened),
        stats.reconnects,
        stats.polls_skipped,
        longest_gap.as_millis(),
    );
}

/// Opens streams, one after the other, each for a different time. The last of the eight
/// takes a scan a second and keeps one only, so it misses scans.
async fn come_and_go(place: u64, sensor: Sensor, missed: Arc<Missed>) {
    let is_slow = place == STREAMS - 1;
    let windows = [
        (Window::DETECTION, Rate::hz(10.0)),
        (Window::FULL, Rate::hz(1.0)),
        (Window::degrees(-90.0..=90.0).unwrap(), Rate::hz(2.0)),
        (Window::new(44..=725).unwrap().with_cluster_count(2).unwrap(), Rate::hz(0.5)),
    ];
    for round in 0_u64.. {
        let kind = if is_slow { 0 } else { (place + round) as usize % windows.len() };
        let (window, rate) = windows[kind];
        let depth = if is_slow { 1 } else { DEPTH };
        let mut scans = sensor.scans(window, rate).depth(depth).await.unwrap();
        missed.opened.fetch_add(1, Ordering::Relaxed);
        let counter = if is_slow { &missed.slow } else { &missed.keeping_up };
        let end = Instant::now() + Duration::from_secs(1 + (place * 7 + round * 11) % 30);
        let mut counted = 0;
        while let Ok(item) = timeout_at(end, scans.next()).await {
            item.expect("a stream that goes on").ok();
            counter.fetch_add(scans.missed() - counted, Ordering::Relaxed);
            counted = scans.missed();
            if is_slow {
                sleep(Duration::from_secs(1)).await;
            }
        }
        drop(scans);
        sleep(Duration::from_secs((place + round) % 5)).await;
    }
}
