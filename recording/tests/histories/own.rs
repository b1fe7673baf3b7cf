//! Recordings as services make them: one stream or two, observed and described in any order, with
//! a consumer that misses scans. Some are split into files, and some of those lose their oldest ones.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

use tokio_scip::{Rate, Scan, Sensor};
use urg_emulator::Model;
use urg_recording::{Compression, Recorder};

use super::file::{Message, compressed, read};
use super::wall::{Wall, set_log};
use crate::common::random::Random;
use crate::sink::{Sink, model, window};

pub(super) struct Own {
    /// Files of the recording, in order.
    pub(super) files: Vec<Vec<u8>>,
    /// Stamps of the described stream's scans that the recorder accepted.
    pub(super) recorded: BTreeSet<u64>,
    /// All scans of that stream.
    pub(super) delivered: Delivered,
    /// Stamps of all that the sensor has sent without a poll: also of scans that were not due.
    pub(super) streamed: BTreeSet<u64>,
    /// True if the sensor is described or told before its first scan, which tells its model.
    pub(super) is_told: bool,
    /// Set if the recording has no other stream.
    pub(super) is_alone: bool,
}

/// Scans of a stream by their stamps, and the stamps by the times of their first rays.
#[derive(Default)]
pub(super) struct Delivered {
    scans: BTreeMap<u64, Scan>,
    first_rays: BTreeMap<u64, u64>,
}

impl Delivered {
    fn insert(&mut self, scan: &Scan) {
        let stamp = nanos(scan.times().stamp);
        self.first_rays.insert(nanos(scan.first_ray_stamp()), stamp);
        self.scans.insert(stamp, scan.clone());
    }

    /// Returns the stamp of a scan that is read, and the scan as it was delivered. Without a reply it
    /// has the time of its message's header, which is rounded.
    pub(super) fn find(&self, scan: &Scan) -> Option<(u64, &Scan)> {
        let stamp = nanos(scan.times().stamp);
        let stamp = self.scans.get_key_value(&stamp).map(|(stamp, _)| *stamp).or_else(|| {
            let first_ray = nanos(scan.first_ray_stamp());
            let mut near = self.first_rays.range(first_ray - 2_000..first_ray + 2_000);
            near.next().map(|(_, stamp)| *stamp)
        })?;
        Some((stamp, &self.scans[&stamp]))
    }

    pub(super) fn has(&self, stamp: u64) -> bool {
        self.scans.contains_key(&stamp)
    }
}

pub(super) fn nanos(stamp: SystemTime) -> u64 {
    stamp.duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as u64
}

/// Records with a seed, which decides each byte.
pub(super) fn own(seed: u64) -> Own {
    let mut attempts = 0..5;
    loop {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_time().start_paused(true).build().unwrap();
        let began = Instant::now();
        let own = runtime.block_on(record(&mut Random::new(seed), seed));
        // On a machine that is so busy, the system's clock may have ended a chunk.
        let is_slow = began.elapsed() >= Duration::from_secs(1);
        if !is_slow || attempts.next().is_none() {
            return own;
        }
    }
}

async fn record(random: &mut Random, seed: u64) -> Own {
    let folder = folder(seed);
    let path = folder.join("run.mcap");
    let (is_split, sink) = (random.once_in(3), Sink::new());
    let compressions = compressions();
    let compression = compressions[seed as usize % compressions.len()];
    let keep_bytes = (is_split && random.once_in(2)).then(|| random.below(40_000));
    let mut recorder = match is_split {
        true => {
            let limit = Duration::from_millis(500 + random.below(2000));
            let builder = Recorder::builder().sync_interval(None).split_duration(limit);
            match keep_bytes {
                Some(bytes) => builder.keep_bytes(bytes).create(&path),
                None => builder.create(&path),
            }
        }
        false => Recorder::builder().write_to(sink.clone()),
    }
    .unwrap();
    fastrand::seed(seed);
    let models = [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];
    let emulator = model(models[seed as usize / compressions.len() % models.len()]);
    let wall = Wall::new();
    let streamed = Arc::new(Mutex::new(BTreeSet::new()));
    let (seen, of_seen) = (Arc::clone(&streamed), wall.clone());
    let builder = Sensor::builder().depth(1 << 10).intensities(seed.is_multiple_of(2));
    let builder = builder.on_reply(move |reply| {
        let stamp = of_seen.reply(reply).stamp;
        if reply.bytes.starts_with(b"M") {
            seen.lock().unwrap().insert(nanos(stamp));
        }
    });
    let sensor = builder.connect(emulator).await.unwrap();
    // As `Recorder::observe`, with this wall clock.
    let observe = |recorder: &Recorder| {
        let (observer, wall) = (recorder.observer(), wall.clone());
        Some(sensor.observe_replies(move |reply| observer(wall.reply(reply))))
    };
    let mut observation = None;
    let (observed, described) = (random.below(4), random.below(3));
    let windows = [window(300, 305, 1), window(310, 313, 1), window(380, 388, 3)];
    if observed == 0 {
        observation = observe(&recorder);
    }
    let window = *random.pick(&windows);
    let rate = Rate::hz(2.0 + random.below(8) as f64);
    let mut scans = sensor.scans(window, rate).await.unwrap();
    let other = *random.pick(&windows);
    let mut others = match random.once_in(3) && other != window && described > 0 {
        true => Some(sensor.scans(other, Rate::hz(3.0)).await.unwrap()),
        false => None,
    };
    let is_alone = others.is_none();
    if observed == 1 {
        observation = observe(&recorder);
    }
    if described > 0 {
        recorder.describe(&sensor, &scans).await.unwrap();
    }
    if observed == 2 {
        observation = observe(&recorder);
    }
    let (mut recorded, mut delivered) = (BTreeSet::new(), Delivered::default());
    let (count, misses) = (5 + random.below(25), 1 + random.below(10));
    // Replies are recorded from any scan on.
    let observes_at = random.below(count);
    let mut late = None;
    for number in 0..count {
        if observed == 3 && number == observes_at {
            observation = observe(&recorder);
        }
        let item = scans.next().await.unwrap();
        let item = item.map(|scan| wall.scan(&scan));
        delivered.insert(item.as_ref().unwrap());
        let item = match random.once_in(4) {
            // The consumer is a scan behind.
            true => late.replace(item),
            false => Some(item),
        };
        for item in late.take_if(|_| random.once_in(2)).into_iter().chain(item) {
            if misses > 1 && random.once_in(misses) {
                continue;
            }
            recorder.record(&item).unwrap();
            recorded.insert(nanos(item.unwrap().times().stamp));
        }
        while let Some(others) = &mut others
            && let Some(item) = futures::FutureExt::now_or_never(others.next())
        {
            let item = item.unwrap().map(|scan| wall.scan(&scan));
            recorder.record(&item).unwrap();
        }
    }
    drop(observation);
    recorder.finish().await.unwrap();
    // Scans whose replies were recorded.
    while let Some(item) = futures::FutureExt::now_or_never(scans.next()) {
        delivered.insert(&wall.scan(&item.unwrap().unwrap()));
    }
    let mut files = match is_split {
        true => {
            let mut names: Vec<_> = std::fs::read_dir(&folder).unwrap().flatten().collect();
            names.sort_by_key(|name| name.path());
            names.iter().map(|name| std::fs::read(name.path()).unwrap()).collect()
        }
        false => vec![sink.bytes()],
    };
    std::fs::remove_dir_all(folder).unwrap();
    set_log(&mut files);
    let files: Vec<_> = files.iter().map(|file| compressed(file, compression)).collect();
    if keep_bytes.is_some() {
        // The other scans were in the files that are removed (`keep`).
        let messages = files.iter().flat_map(|file| read(file).unwrap());
        // A scan of the other stream may have come with the same reply.
        let is_own = |one: &Message| !one.is_laser_scan() || one.has_points(window.points());
        let scans = messages.filter(Message::is_scan).filter(is_own);
        let stamps: BTreeSet<_> = scans.map(|message| message.publish_time).collect();
        recorded.retain(|stamp| stamps.contains(stamp));
    }
    let streamed = streamed.lock().unwrap().clone();
    Own { files, recorded, delivered, streamed, is_told: described > 0, is_alone }
}

/// Compressions that this build writes.
pub(super) fn compressions() -> Vec<Compression> {
    let all = [Compression::Plain, Compression::Lz4, Compression::Zstd];
    all.into_iter().filter(|one| one.is_written()).collect()
}

/// Creates an empty folder, in memory where the system has one for that.
pub(super) fn folder(seed: u64) -> PathBuf {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let folder = folder.join(format!(
        "urg-histories-{}-{:?}-{seed}",
        std::process::id(),
        std::thread::current().id()
    ));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}
