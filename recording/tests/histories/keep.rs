//! Histories of recordings that remove their oldest files: runs under one name, with any limits,
//! after kills, beside the files of others. The truth has the size of each file that is gone,
//! because a twin of each run has the same files and removes none.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use tokio::time::Instant;
use tokio_scip::{Error, Scan};
use urg_recording::{Progress, Recorder, RecorderBuilder};

use super::file::{Message, chunks_end, read};
use super::own::folder;
use crate::common::random::{Random, seeds};
use crate::sink::window;

/// Files that are no parts, although their names look like it.
const OTHERS: [&str; 6] = [
    "run_2.mcap",
    "run_x.mcap",
    "run_00002.mcap",
    "run_4294967295.mcap",
    "other_0002.mcap",
    "run.txt",
];
const HOUR: Duration = Duration::from_secs(3600);

/// File of an earlier run.
struct Old {
    bytes: Vec<u8>,
    /// Time since it was written. `None` if the clock was not set then.
    age: Option<Duration>,
}

/// Limits of a run.
struct KeepLimits {
    split_duration: Option<Duration>,
    split_bytes: Option<u64>,
    keep_duration: Option<Duration>,
    keep_bytes: Option<u64>,
}

impl KeepLimits {
    fn draw(random: &mut Random) -> Self {
        let by_bytes = random.once_in(2);
        Self {
            split_duration: random.once_in(2).then(|| 2 * random.ms(1_500)),
            split_bytes: random.once_in(2).then(|| 2_000 + random.below(10_000)),
            keep_duration: (!by_bytes || random.once_in(3)).then_some(HOUR),
            keep_bytes: by_bytes.then(|| random.below(60_000)),
        }
    }

    fn builder(&self) -> RecorderBuilder {
        let mut builder = Recorder::builder().sync_interval(None);
        if let Some(duration) = self.split_duration {
            builder = builder.split_duration(duration);
        }
        if let Some(bytes) = self.split_bytes {
            builder = builder.split_bytes(bytes);
        }
        builder
    }

    fn keeping_builder(&self) -> RecorderBuilder {
        let mut builder = self.builder();
        if let Some(duration) = self.keep_duration {
            builder = builder.keep_duration(duration);
        }
        if let Some(bytes) = self.keep_bytes {
            builder = builder.keep_bytes(bytes);
        }
        builder
    }

    /// Numbers of the files that remain of the old ones and of the parts of a run.
    fn remaining(&self, old: &BTreeMap<u64, Old>, parts: &BTreeMap<u64, Vec<u8>>) -> Vec<u64> {
        let is_too_old = |old: &Old| self.keep_duration.is_some_and(|keep| old.age > Some(keep));
        let old = old.iter().filter(|(_, old)| !is_too_old(old));
        let old = old.map(|(number, old)| (*number, old.bytes.len()));
        let new = parts.iter().map(|(number, bytes)| (*number, bytes.len()));
        let files: Vec<_> = old.chain(new).collect();
        let (last, last_bytes) = parts.last_key_value().unwrap();
        // The index of the current file is extra.
        let mut total = chunks_end(last_bytes);
        let fits = |(number, bytes): &&(u64, usize)| {
            total += if number == last { 0 } else { *bytes };
            number == last || self.keep_bytes.is_none_or(|keep| total as u64 <= keep)
        };
        let mut numbers: Vec<_> = files.iter().rev().take_while(fits).map(|file| file.0).collect();
        numbers.reverse();
        numbers
    }
}

/// Records the same scans twice. Returns the counts of both recordings.
async fn record(
    random: &mut Random,
    recorders: [RecorderBuilder; 2],
    paths: [&Path; 2],
) -> [Progress; 2] {
    let [kept, twin] = recorders;
    let (mut kept, mut twin) = (kept.create(paths[0]).unwrap(), twin.create(paths[1]).unwrap());
    let (window, mut sequence) = (window(300, 300 + random.below(60) as u16, 1), 0);
    let began = Instant::now();
    for _ in 0..random.below(60) {
        tokio::time::advance(random.ms(400)).await;
        sequence += 1 + u64::from(random.once_in(8));
        let values: Vec<u32> = (0..window.points()).map(|_| random.below(4096) as u32).collect();
        let stamp = SystemTime::UNIX_EPOCH + 500_000 * HOUR + began.elapsed();
        let scan = Scan::builder(window, values).sequence(sequence).stamp(stamp);
        let item: Result<_, Error> = Ok(scan.received_at(Instant::now()).build().unwrap());
        kept.record(&item).unwrap();
        twin.record(&item).unwrap();
    }
    [kept.finish().await.unwrap(), twin.finish().await.unwrap()]
}

/// Returns the name of a recording without its ending: on Linux any bytes.
fn stem(random: &mut Random) -> OsString {
    #[cfg(target_os = "linux")]
    if random.once_in(4) {
        return std::os::unix::ffi::OsStringExt::from_vec(b"r\xffn".to_vec());
    }
    "run".into()
}

/// Returns the name of a part, as the documentation has it.
fn part(stem: &OsStr, number: u64) -> OsString {
    let mut name = stem.to_owned();
    name.push(if number == 1 { ".mcap".to_owned() } else { format!("_{number:04}.mcap") });
    name
}

fn names(folder: &Path) -> BTreeSet<OsString> {
    fs::read_dir(folder).unwrap().map(|file| file.unwrap().file_name()).collect()
}

/// Messages of a file. Two recorders have read the wall clock at different times.
fn messages(file: &[u8]) -> Vec<Message> {
    let messages = read(file).unwrap().into_iter();
    messages.map(|message| Message { log_time: 0, ..message }).collect()
}

struct KeepHistory {
    random: Random,
    stem: OsString,
    kept: PathBuf,
    twin: PathBuf,
    old: BTreeMap<u64, Old>,
    /// Files that a kill has left without a byte: they are no parts.
    empty: BTreeSet<u64>,
}

impl KeepHistory {
    /// Records, and compares what remains. Returns false if the machine was so busy that the twin
    /// has other chunks.
    fn run(&mut self) -> Result<bool, String> {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_time().start_paused(true).build().unwrap();
        let limits = KeepLimits::draw(&mut self.random);
        fs::create_dir_all(&self.twin).unwrap();
        let progress = runtime.block_on(record(
            &mut self.random,
            [limits.keeping_builder(), limits.builder()],
            [&self.kept.join(part(&self.stem, 1)), &self.twin.join("run.mcap")],
        ));
        if progress[0].bytes != progress[1].bytes {
            return Ok(false);
        }
        let first = self.old.last_key_value().map_or(1, |(number, _)| number + 1);
        let parts = (0..progress[1].files)
            .map(|n| (first + n, fs::read(self.twin.join(part("run".as_ref(), 1 + n))).unwrap()));
        let parts: BTreeMap<u64, Vec<u8>> = parts.collect();
        fs::remove_dir_all(&self.twin).unwrap();
        let remaining = limits.remaining(&self.old, &parts);
        self.empty.retain(|number| !parts.contains_key(number));
        let files = remaining.iter().chain(&self.empty).map(|number| part(&self.stem, *number));
        let expected: BTreeSet<_> = files.chain(OTHERS.map(OsString::from)).collect();
        let found = names(&self.kept);
        if found != expected {
            return Err(format!("{found:?} remain, and not {expected:?}"));
        }
        for number in &remaining {
            let file = fs::read(self.kept.join(part(&self.stem, *number))).unwrap();
            let is_same = match self.old.get(number) {
                Some(old) => old.bytes == file,
                None => messages(&parts[number]) == messages(&file),
            };
            if !is_same {
                return Err(format!("part {number} is another one"));
            }
        }
        self.old.clear();
        remaining
            .iter()
            .for_each(|number| self.grow_old(*number, number == parts.keys().max().unwrap()));
        Ok(true)
    }

    /// Lets time pass. The last file may end in a kill, even before its first byte.
    fn grow_old(&mut self, number: u64, is_last: bool) {
        let random = &mut self.random;
        let path = self.kept.join(part(&self.stem, number));
        let file = fs::File::options().write(true).open(&path).unwrap();
        if is_last && random.once_in(3) {
            let length = file.metadata().unwrap().len();
            file.set_len(random.below(length) * random.below(4).min(1)).unwrap();
        }
        let age = *random.pick(&[Some(HOUR / 2), Some(2 * HOUR), None]);
        let written = age.map_or(SystemTime::UNIX_EPOCH + HOUR, |age| SystemTime::now() - age);
        file.set_modified(written).unwrap();
        match fs::read(path).unwrap() {
            bytes if bytes.is_empty() => drop(self.empty.insert(number)),
            bytes => drop(self.old.insert(number, Old { bytes, age })),
        }
    }
}

fn history(seed: u64) -> Result<bool, String> {
    let all = folder(seed);
    let (mut random, kept, twin) = (Random::new(seed), all.join("kept"), all.join("twin"));
    let stem = stem(&mut random);
    fs::create_dir_all(&kept).unwrap();
    for name in OTHERS {
        fs::write(kept.join(name), "precious").unwrap();
    }
    let (old, empty) = (BTreeMap::new(), BTreeSet::new());
    let mut history = KeepHistory { random, stem, kept, twin, old, empty };
    if history.random.once_in(4) {
        // Soon the numbers have five digits.
        fs::write(history.kept.join(part(&history.stem, 9_998)), [0; 5_000]).unwrap();
        history.grow_old(9_998, false);
    }
    let mut outcome = Ok(true);
    for run in 0..1 + history.random.below(4) {
        outcome = history.run().map_err(|text| format!("run {run}: {text}"));
        if outcome != Ok(true) {
            break;
        }
    }
    if OTHERS.iter().any(|name| fs::read(history.kept.join(name)).unwrap() != b"precious") {
        outcome = Err("the file of another is changed".to_owned());
    }
    fs::remove_dir_all(all).unwrap();
    outcome
}

#[test]
fn what_is_kept_is_the_newest_that_fits() {
    let seeds = seeds("URG_KEEPS", 150);
    let (count, mut busy, mut wrong) = (seeds.end - seeds.start, 0, Vec::new());
    for seed in seeds {
        match history(seed) {
            Ok(is_compared) => busy += u64::from(!is_compared),
            Err(text) => wrong.push(format!("seed {seed}: {text}")),
        }
    }
    assert!(wrong.is_empty(), "{} of {count}: {:#?}", wrong.len(), &wrong[..wrong.len().min(5)]);
    assert!(busy <= count / 10, "{busy} of {count} not compared");
}
