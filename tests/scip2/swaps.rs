//! Sensors that take each other's place while streams of several windows run, some in clusters, with
//! intensities where the sensor has them. Each scan is compared with what its sensor measured.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use tokio::time::{Instant, timeout, timeout_at};
use tokio_scip::{Rate, Scan, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, Model, Values, World, WorldTime};

use crate::common::limit::limit;
use crate::common::random::{Random, seeds};
use crate::common::{ConnectFn, builder, ms};

const MODELS: [(Model, u32); 3] =
    [(Model::Ust10lx, 30_000), (Model::Utm30lx, 60_000), (Model::Urg04lxUg01, 5600)];

/// Distance at a step in a revolution, and at each 11th step an error code.
fn distance(revolution: u64, step: usize) -> u32 {
    let step = step as u64;
    if step % 11 == 3 { 1 } else { 1000 + ((revolution * 7 + step * 13) % 3000) as u32 }
}

fn intensity(revolution: u64, step: usize) -> u32 {
    ((revolution + 3 * step as u64) % 4000) as u32
}

struct Numbers;

impl World for Numbers {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        for (step, slot) in values.iter_mut().enumerate() {
            *slot = distance(time.revolution, step);
        }
    }

    fn measure_intensities(&mut self, time: WorldTime, _: &Values, intensities: &mut Values) {
        for (step, slot) in intensities.iter_mut().enumerate() {
            *slot = intensity(time.revolution, step);
        }
    }
}

/// Points that a sensor sends of a window: of a cluster the nearest, without error codes.
fn points(revolution: u64, window: Window) -> impl Iterator<Item = (u32, u32)> {
    let (start, end) = (usize::from(window.start()), usize::from(window.end()));
    let clusters = usize::from(window.cluster_count());
    (start..=end).step_by(clusters).map(move |first| {
        let steps = first..=end.min(first + clusters - 1);
        let rank = |step: &usize| (distance(revolution, *step) < 20, distance(revolution, *step));
        let nearest = steps.min_by_key(rank).unwrap();
        (distance(revolution, nearest), intensity(revolution, nearest))
    })
}

/// A stream, and what it delivered last: the sensor's number, the link's, and the revolution.
struct Followed {
    stream: ScanStream,
    rate: Rate,
    latest: Option<(usize, u64, u64)>,
    /// True if the sensor may have restarted since, and counts anew.
    restarts: bool,
}

/// Sensors that a driver may find.
struct Sensors {
    emulators: Vec<Emulator>,
    asks_intensities: bool,
    seed: u64,
}

impl Sensors {
    /// Returns the sensor's number and the revolution that a scan shows.
    fn find(&self, scan: &Scan, asked: Window) -> (usize, u64) {
        let seed = self.seed;
        let reach = *scan.geometry().distances().end();
        let which = MODELS.iter().position(|(_, most)| *most == reach).unwrap();
        let window = asked.resolve(scan.geometry()).unwrap();
        assert_eq!(scan.window(), window, "seed {seed}");
        let sent = self.emulators[which].sent_scans();
        let shown = |revolution| points(revolution, window).map(|(distance, _)| distance);
        let mut newest_first = sent.iter().rev().map(|sent| sent.time.revolution);
        let revolution = newest_first.find(|revolution| shown(*revolution).eq(scan.raw_values()));
        let revolution = revolution.unwrap_or_else(|| panic!("seed {seed}: {scan:?} is no scan"));
        let expected: Vec<u32> = points(revolution, window).map(|(_, other)| other).collect();
        let has_intensities = self.asks_intensities && MODELS[which].0 != Model::Urg04lxUg01;
        let expected = has_intensities.then_some(&expected[..]);
        assert_eq!(scan.intensities(), expected, "seed {seed}: {window}");
        (which, revolution)
    }

    async fn read(&self, followed: &mut Followed, within: Duration) -> u64 {
        let (mut count, end) = (0, Instant::now() + within);
        while let Ok(item) = timeout_at(end, followed.stream.next()).await {
            let Ok(scan) = item.unwrap() else { continue };
            let (which, revolution) = self.find(&scan, followed.stream.window());
            count += 1;
            let now = (which, scan.reconnects(), revolution);
            if let Some(latest) = followed.latest.replace(now)
                && (latest.0, latest.1) == (now.0, now.1)
            {
                let is_once = followed.rate == Rate::UNLIMITED;
                if followed.restarts && now.2 < latest.2 {
                    followed.restarts = false;
                    continue;
                }
                assert!(
                    latest.2 < now.2 || !is_once && latest.2 == now.2,
                    "seed {}: {now:?} after {latest:?}",
                    self.seed
                );
            }
        }
        count
    }
}

fn window(random: &mut Random) -> Window {
    let window = match random.below(4) {
        0 => Window::degrees(-90.0 + random.below(50) as f64..=45.0).unwrap(),
        1 => {
            let start = 44 + random.below(600) as u16;
            Window::new(start..=start + random.below(u64::from(726 - start)) as u16).unwrap()
        }
        2 => Window::FULL,
        _ => Window::DETECTION,
    };
    window
        .with_cluster_count(if random.once_in(2) { 1 } else { 1 + random.below(12) as u8 })
        .unwrap()
}

async fn subscribe(sensor: &Sensor, random: &mut Random) -> Followed {
    let rates = [
        Rate::UNLIMITED,
        Rate::UNLIMITED,
        Rate::hz(40.0),
        Rate::hz(13.0),
        Rate::hz(5.0),
        Rate::hz(0.7),
    ];
    let rate = *random.pick(&rates);
    let stream = sensor.scans(window(random), rate).depth(1000).await.unwrap();
    Followed { stream, rate, latest: None, restarts: false }
}

async fn play(seed: u64) {
    limit();
    let mut random = Random::new(seed);
    let emulators: Vec<Emulator> = MODELS
        .iter()
        .enumerate()
        .map(|(n, (model, _))| {
            Emulator::builder()
                .model(*model)
                .serial_number(format!("H000000{n}"))
                .world(Numbers)
                .log_capacity(1 << 16)
                .build()
        })
        .collect();
    let now = Arc::new(AtomicUsize::new(0));
    let (at, links) = (Arc::clone(&now), emulators.clone());
    let connect = ConnectFn(move || Ok(links[at.load(Ordering::Relaxed)].link()));
    let asks_intensities = random.once_in(2);
    let all = Sensors { emulators, asks_intensities, seed };
    let asking = builder().any_sensor(true).intensities(asks_intensities);
    let sensor = asking.connect(connect).await.unwrap();
    let mut streams = Vec::new();
    for _ in 0..3 {
        streams.push(subscribe(&sensor, &mut random).await);
    }
    for _ in 0..10 {
        let what = random.below(8);
        match what {
            0 | 1 => {
                let old = now.swap(random.below(3) as usize, Ordering::Relaxed);
                all.emulators[old].unplug();
                all.emulators[old].plug_in();
            }
            2 => all.emulators[now.load(Ordering::Relaxed)].power_cycle(),
            3 => drop(timeout(Duration::from_secs(8), sensor.reboot()).await),
            4 => streams.push(subscribe(&sensor, &mut random).await),
            5 => drop(streams.swap_remove(random.below(streams.len() as u64) as usize)),
            6 => drop(timeout(Duration::from_secs(8), sensor.sensor_state()).await),
            _ => {
                let window = window(&mut random);
                if let Ok(Ok(scan)) = timeout(Duration::from_secs(8), sensor.scan(window)).await {
                    all.find(&scan, window);
                }
            }
        }
        if what < 4 {
            streams.iter_mut().for_each(|followed| followed.restarts = true);
        }
        if streams.is_empty() {
            streams.push(subscribe(&sensor, &mut random).await);
        }
        let each = random.ms(600);
        for followed in &mut streams {
            all.read(followed, each).await;
        }
    }
    let end = Instant::now() + Duration::from_secs(12);
    for followed in &mut streams {
        let mut count = 0;
        while count < 2 {
            assert!(Instant::now() < end, "seed {seed}: {} has no scans", followed.rate);
            count += all.read(followed, ms(100)).await;
        }
    }
}

#[test]
fn each_scan_is_one_of_the_sensor_that_is_there() {
    for seed in seeds("SCIP_SWAPS", 12) {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        runtime.enable_all().start_paused(true).build().unwrap().block_on(play(seed));
    }
}
