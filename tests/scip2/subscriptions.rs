//! Streams of any window and rate that come and go: each has its scans, whatever the others do.

use std::time::Duration;

use futures::FutureExt;
use tokio::task::unconstrained;
use tokio::time::{Instant, sleep};
use tokio_scip::scan::StampQuality;
use tokio_scip::{Rate, ScanStream, Window};
use urg_emulator::Model;

use super::times::lateness;
use super::{numbered, revolution};
use crate::common::builder;
use crate::common::random::{Random, seeds};

/// Stream, and what was last read from it.
struct Reader {
    stream: ScanStream,
    window: Window,
    period: Duration,
    /// When the latest scan came, or the stream was asked for.
    since: Instant,
    revolution: Option<u32>,
}

fn window(random: &mut Random) -> Window {
    let start = 100 + random.below(300) as u16;
    let narrow = start..=start + 1 + random.below(200) as u16;
    let window = if random.once_in(2) { Window::DETECTION } else { Window::new(narrow).unwrap() };
    let cluster_count = if random.once_in(4) { 2 + random.below(5) as u8 } else { 1 };
    window.with_cluster_count(cluster_count).unwrap()
}

/// A rate from three a revolution to one in fifty.
fn period(random: &mut Random, revolution: Duration) -> Duration {
    let percent = match random.below(5) {
        0 => 0,
        1 => 30 + random.below(100),
        2 => 100 + random.below(900),
        3 => 100 * (1 + random.below(10)),
        _ => 1000 + random.below(4000),
    };
    revolution * percent as u32 / 100
}

async fn play(seed: u64) {
    let mut random = Random::new(seed);
    let models = [(Model::Urg04lxUg01, 100), (Model::Ust10lx, 25), (Model::Utm30lx, 25)];
    let (model, told) = *random.pick(&models);
    let told = Duration::from_millis(told);
    let turn = told * (980 + random.below(41) as u32) / 1000;
    let (reads, faster) = (random.ms(10_000_000), (random.below(401) as f64 - 200.0) / 1e5);
    let emulator = numbered(model).revolution(turn).frame(Duration::from_millis(1));
    let emulator = emulator.clock(reads, faster).build();
    let sensor = builder().depth(4096).connect(emulator.clone()).await.unwrap();
    let mut readers: Vec<Reader> = Vec::new();
    for _ in 0..40 {
        match random.below(4) {
            0 | 1 if readers.len() < 5 => {
                let (window, period) = (window(&mut random), period(&mut random, told));
                let rate = if period.is_zero() { Rate::UNLIMITED } else { Rate::every(period) };
                let since = Instant::now();
                let stream = sensor.scans(window, rate).await.unwrap();
                readers.push(Reader { stream, window, period, since, revolution: None });
            }
            2 if !readers.is_empty() => {
                let place = random.below(readers.len() as u64) as usize;
                readers.swap_remove(place);
            }
            _ => {}
        }
        if random.once_in(6) {
            revolution(&sensor.scan(window(&mut random)).await.unwrap());
        }
        let longest = if random.once_in(3) { 4000 } else { 900 };
        sleep(random.ms(longest)).await;
        for reader in &mut readers {
            // A stream that begins starts the sensor's anew, and a scan beside it does so twice.
            let most = 2 * reader.period.max(turn) + 9 * turn + Duration::from_millis(100);
            while let Some(scan) = unconstrained(reader.stream.next()).now_or_never() {
                let scan = scan.unwrap().unwrap();
                let (now, number) = (scan.received_at(), revolution(&scan));
                let gap = now.duration_since(reader.since);
                assert!(gap <= most, "seed {seed}: {gap:?} of {:?}, {model:?}", reader.period);
                assert!(
                    scan.window().is_same_wish(&reader.window),
                    "seed {seed}: {}",
                    scan.window()
                );
                let before = reader.revolution.replace(number);
                assert!(before.is_none_or(|before| before < number), "seed {seed}: {number}");
                if scan.times().quality == StampQuality::SensorClock {
                    let late = lateness(&emulator, &scan);
                    assert!(late.abs() < 2.0, "seed {seed}: {late} ms");
                }
                reader.since = now;
            }
            assert!(reader.since.elapsed() <= most, "seed {seed}: {:?}, {model:?}", reader.period);
        }
    }
    let stats = sensor.stats();
    let none = [stats.refused, stats.malformed.total(), stats.repeats, stats.missed];
    assert_eq!(none, [0; 4], "seed {seed}");
    assert_eq!((stats.bytes_skipped, stats.disconnects), (0, 0), "seed {seed}");
}

/// Seeds: `SCIP_SUBSCRIPTIONS=300 cargo test --test it subscriptions`.
#[test]
fn each_stream_has_its_scans_while_others_come_and_go() {
    for seed in seeds("SCIP_SUBSCRIPTIONS", 25) {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        runtime.enable_all().start_paused(true).build().unwrap().block_on(play(seed));
    }
}

/// A rate below a tenth of the motor's needs no poll either: its scans come from the faster stream.
#[tokio::test(start_paused = true)]
async fn nothing_waits_for_the_next_scan_of_a_slow_stream() {
    for seed in seeds("SCIP_SUBSCRIPTIONS", 50) {
        let mut random = Random::new(seed);
        let sensor = builder().connect(numbered(Model::Urg04lxUg01).build()).await.unwrap();
        let mut streams = Vec::new();
        for rate in [1.0, 0.4] {
            streams.push(sensor.scans(Window::DETECTION, Rate::hz(rate)).await.unwrap());
        }
        sleep(Duration::from_secs(3) + random.ms(5000)).await;
        let asked = Instant::now();
        let mut fast = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        fast.next().await.unwrap().unwrap();
        assert!(asked.elapsed() < Duration::from_millis(500), "seed {seed}: {:?}", asked.elapsed());
        drop(fast);
        sleep(random.ms(5000)).await;
        let asked = Instant::now();
        sensor.laser_off().await.unwrap();
        assert!(asked.elapsed() < Duration::from_millis(500), "seed {seed}: {:?}", asked.elapsed());
    }
}
