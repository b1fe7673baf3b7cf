//! Random histories of recordings: made by this crate or by another program, cut, joined in any
//! order, cut off, damaged, repaired, and cut again. The truth is a list of messages, which the
//! crate `mcap` reads. After each step every message is there, byte for byte and on its topic,
//! except those that the damage hit; nothing is there twice; and the counts agree.
//!
//! `URG_HISTORIES=100000 cargo test --release -p urg-recording histories -- --nocapture` takes a
//! minute, and `URG_HISTORIES_FIRST=1000000` other histories.

mod file;
mod foreign;
mod form;
mod keep;
mod own;
mod wall;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io::Cursor;
use std::ops::{Range, RangeBounds};
use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

use mcap::records::Metadata;
use tokio_scip::Scan;
use urg_recording::{Compression, Copied, Entry, Recording, RecordingError, cut, repair};

use self::file::{Layout, Message, messages, metadata, plain, read, topics};
use self::foreign::bag;
use self::form::rewritten;
use self::own::{Delivered, Own, nanos, own};
use crate::common::random::{Random, seeds};
use crate::raw::MAGIC;

/// Number of scans from which the window of a stream without a description is known: the driver
/// widens three polls of four.
const WINDOW_POLLS: usize = 8;
/// Number of recordings that the histories choose from: making one takes milliseconds.
const RECORDINGS: u64 = 48;

fn recordings() -> &'static [Own] {
    static RECORDINGS_MADE: OnceLock<Vec<Own>> = OnceLock::new();
    RECORDINGS_MADE.get_or_init(|| (0..RECORDINGS).map(own).collect())
}

/// Topics of the recordings, with their types.
fn own_topics() -> &'static BTreeSet<String> {
    static TOPICS: OnceLock<BTreeSet<String>> = OnceLock::new();
    let files = || recordings().iter().flat_map(|own| &own.files);
    TOPICS.get_or_init(|| files().flat_map(|file| topics(file)).collect())
}

/// File of a history.
#[derive(Clone)]
struct File {
    bytes: Vec<u8>,
    /// Messages that must be in it, in their order.
    must: Vec<Message>,
    /// Messages that may be in it.
    may: Vec<Message>,
    /// Topics and types, with and without messages, if it is complete.
    topics: BTreeSet<String>,
    /// Metadata that must be in it.
    metadata: Vec<Metadata>,
    is_complete: bool,
    /// True if it has an index.
    has_index: bool,
    /// True if records may stand both in chunks and outside: damage then costs more.
    is_mixed: bool,
    /// True if damage that no checksum shows may have changed messages.
    is_loose: bool,
    /// True if its damage shows in a checksum.
    is_proved: bool,
    /// Scans of the only stream, if it is the file of one recording.
    stream: Option<&'static Delivered>,
}

impl File {
    fn whole(bytes: Vec<u8>) -> Result<Self, String> {
        let must = read(&bytes)?;
        let (may, topics) = (must.clone(), topics(&bytes));
        let (is_complete, has_index, is_loose, is_proved) = (true, true, false, false);
        let (metadata, stream, is_mixed) = (metadata(&bytes), None, false);
        Ok(Self {
            bytes,
            must,
            may,
            topics,
            metadata,
            is_complete,
            has_index,
            is_mixed,
            is_loose,
            is_proved,
            stream,
        })
    }

    /// Writes some files anew in another form that the format allows.
    fn rewritten(self, random: &mut Random) -> Result<Self, Wrong> {
        if random.once_in(2) {
            return Ok(self);
        }
        let is_mixed = random.once_in(4);
        let bytes = rewritten(random, &plain(&self.bytes), is_mixed);
        is_so(messages(&bytes)? == self.must, || "rewritten: another reader".to_owned())?;
        Ok(Self { bytes, has_index: false, is_mixed, ..self })
    }

    fn is_sorted(&self) -> bool {
        self.must.is_sorted_by_key(|message| message.log_time)
    }

    /// Opens the file on a disk, so that its index can be read, or as a pipe.
    fn input(&self, is_on_disk: bool) -> HistoryInput {
        if !is_on_disk {
            return HistoryInput::Pipe(Cursor::new(self.bytes.clone()));
        }
        let folder = own::folder(0);
        let path = folder.join("file.mcap");
        std::fs::write(&path, &self.bytes).unwrap();
        let file = std::fs::File::open(&path).unwrap();
        // The open file stays.
        std::fs::remove_dir_all(folder).unwrap();
        HistoryInput::Disk(file)
    }
}

enum HistoryInput {
    Pipe(Cursor<Vec<u8>>),
    Disk(std::fs::File),
}

/// Copies a part of the inputs, all on a disk or none.
fn copy(
    inputs: Vec<HistoryInput>,
    range: impl RangeBounds<Duration>,
    compression: Option<Compression>,
    out: &mut Vec<u8>,
) -> Result<Copied, RecordingError> {
    let (mut pipes, mut files) = (Vec::new(), Vec::new());
    for input in inputs {
        match input {
            HistoryInput::Pipe(pipe) => pipes.push(pipe),
            HistoryInput::Disk(file) => files.push(file),
        }
    }
    match files.is_empty() {
        true => cut(pipes, range, compression, out),
        false => cut(files, range, compression, out),
    }
}

fn open(input: HistoryInput) -> Result<Recording, RecordingError> {
    match input {
        HistoryInput::Pipe(pipe) => Recording::read(pipe),
        HistoryInput::Disk(file) => Recording::read(file),
    }
}

/// What is wrong after a step.
struct Wrong(String);

impl<T: fmt::Display> From<T> for Wrong {
    fn from(text: T) -> Self {
        Self(text.to_string())
    }
}

fn is_so(fact: bool, otherwise: impl FnOnce() -> String) -> Result<(), Wrong> {
    if fact { Ok(()) } else { Err(Wrong(otherwise())) }
}

/// Number of times that each message is there. The version of the sensor is not counted: files
/// repeat it.
fn counted(messages: &[Message]) -> BTreeMap<&Message, usize> {
    let mut counts = BTreeMap::new();
    for message in messages.iter().filter(|message| !message.is_version()) {
        *counts.entry(message).or_default() += 1;
    }
    counts
}

/// Compares what a step has written with what must and what may be in it.
fn compare(
    found: &[Message],
    must: &[Message],
    may: &[Message],
    is_loose: bool,
) -> Result<(), Wrong> {
    let (found_counts, must_counts, may_counts) = (counted(found), counted(must), counted(may));
    for (message, count) in &must_counts {
        let count_found = found_counts.get(message).copied().unwrap_or_default();
        is_so(count_found >= *count, || {
            let others = found
                .iter()
                .filter(|other| other.data == message.data && other.log_time == message.log_time);
            let topics: Vec<_> = others.map(|other| &other.topic).collect();
            match topics[..] {
                [] => format!("missing: {message:?}"),
                _ => format!("on another topic {topics:?}: {message:?}"),
            }
        })?;
    }
    if is_loose {
        return Ok(());
    }
    for (message, count) in &found_counts {
        let is_same = |other: &&Message| {
            other.is_on_topic_of(message)
                && (other.log_time, &other.data) == (message.log_time, &message.data)
        };
        // Its type was lost with a damaged part. The reader knows the types of own topics, also if an
        // earlier damage has changed one that is lost now.
        let is_type_lost = || message.has_lost_type() || own_topics().contains(&message.topic);
        let mut most = may_counts.get(message).copied().unwrap_or_default();
        if *count > most && is_type_lost() {
            most = may.iter().filter(is_same).count();
        }
        is_so(*count <= most, || format!("{count} times and not {most}: {message:?}"))?;
    }
    let versions = |messages: &[Message]| -> BTreeSet<(u64, Vec<u8>)> {
        let versions = messages.iter().filter(|message| message.is_version());
        versions.map(|message| (message.publish_time, message.data.clone())).collect()
    };
    is_so(versions(found).is_superset(&versions(must)), || "no version".to_owned())?;
    is_so(versions(found).is_subset(&versions(may)), || "another version".to_owned())
}

/// Scans of a file, as the library reads them, and the number of replies and messages left out.
fn scans(bytes: &[u8]) -> Result<(Vec<Scan>, u64), Wrong> {
    let mut scans = Vec::new();
    let mut recorded = Recording::read(Cursor::new(bytes.to_vec()))?.scans();
    for scan in recorded.by_ref() {
        match scan {
            Ok(scan) => scans.push(scan),
            Err(RecordingError::NoScans { .. }) => {}
            Err(error) => return Err(error.into()),
        }
    }
    let left_out =
        recorded.recording().left_out().counts().iter().map(|count| count.messages).sum();
    Ok((scans, left_out))
}

/// Checks a file that a step has written, and reads it.
fn written(bytes: Vec<u8>, counts: (u64, u64)) -> Result<File, Wrong> {
    let file = File::whole(bytes)?;
    let (messages, scans_told) = counts;
    is_so(messages == file.must.len() as u64, || {
        format!("{messages} messages told, {} there", file.must.len())
    })?;
    let found = scans(&file.bytes)?.0.len() as u64;
    is_so(scans_told == found, || format!("{scans_told} scans told, {found} there"))?;
    let again = repair(Cursor::new(file.bytes.clone()), std::io::sink())?;
    is_so(!again.was_truncated && again.damaged_parts == 0, || format!("not whole: {again:?}"))?;
    is_so(again.scans == found, || format!("{} scans repaired of {found}", again.scans))?;
    Ok(file)
}

/// Says what differs between a scan and the same one as it was delivered. Without a reply, codes are
/// known by their ranges alone.
fn difference(found: &Scan, delivered: &Scan, has_reply: bool, is_told: bool) -> Option<String> {
    let ranges = |scan: &Scan| -> Vec<u32> { scan.ranges().map(f32::to_bits).collect() };
    let angles = |scan: &Scan| (scan.window(), scan.angle_min(), scan.angle_increment());
    let limits = |scan: &Scan| (scan.range_min(), scan.range_max());
    let text = match () {
        () if angles(found) != angles(delivered) => "directions",
        () if ranges(found) != ranges(delivered) => "ranges",
        () if found.intensities() != delivered.intensities() => "intensities",
        () if has_reply && !found.raw_values().eq(delivered.raw_values()) => "codes",
        () if (has_reply || is_told) && found.geometry() != delivered.geometry() => "geometry",
        () if (has_reply || is_told) && limits(found) != limits(delivered) => "limits",
        () => return None,
    };
    Some(format!("{text} of scan {}: {found:?} of {delivered:?}", delivered.sequence()))
}

/// Returns true for a scan of SCIP 1 that has further steps beside the delivered one's: the driver
/// has polled more than it was asked for.
fn is_wider(found: &Scan, delivered: &Scan) -> bool {
    let (wider, window) = (found.window(), delivered.window());
    let surplus = window.start().saturating_sub(wider.start()) / u16::from(window.cluster_count());
    let values = found.raw_values().skip(surplus.into()).take(window.points());
    wider.start() <= window.start()
        && window.end() <= wider.end()
        && values.eq(delivered.raw_values())
}

/// Number of histories whose files other readers read.
const FOR_OTHERS: u64 = 60;

/// Returns whether one of the places overlaps another one.
fn is_in(places: &[Range<usize>]) -> impl Fn(&Range<usize>) -> bool + Copy {
    |place| places.iter().any(|hit| hit.start < place.end && place.start < hit.end)
}

/// Kinds of steps, for the report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Step {
    Join,
    Cut,
    Repair,
    CutOff,
    Damage,
}

struct History {
    random: Random,
    shelf: Vec<File>,
    /// True if the files are on a disk, where their indexes can be read before the rest.
    is_on_disk: bool,
    steps: Vec<Step>,
}

impl History {
    fn new(seed: u64) -> Result<Self, Wrong> {
        let mut random = Random::new(seed);
        let (is_on_disk, mut shelf) = (random.once_in(3), Vec::new());
        for _ in 0..1 + random.below(3) {
            if random.once_in(2) {
                let recording = random.pick(recordings());
                let stream = Some(&recording.delivered).filter(|_| recording.is_alone);
                for file in &recording.files {
                    let file = File { stream, ..File::whole(file.clone())? };
                    shelf.push(file.rewritten(&mut random)?);
                }
            } else {
                let bag = bag(&mut random);
                shelf.push(File::whole(bag)?.rewritten(&mut random)?);
            }
        }
        Ok(Self { random, shelf, is_on_disk, steps: Vec::new() })
    }

    fn run(&mut self) -> Result<(), Wrong> {
        for _ in 0..1 + self.random.below(5) {
            let place = self.random.below(self.shelf.len() as u64) as usize;
            let File { is_complete, is_mixed, .. } = self.shelf[place];
            let step = match (self.random.below(5), is_complete) {
                (0, _) => Step::Join,
                (1, true) => Step::Cut,
                (2, true) => Step::CutOff,
                (3, true) if !is_mixed => Step::Damage,
                _ => Step::Repair,
            };
            self.steps.push(step);
            let file = match step {
                Step::Join => self.join()?,
                Step::Cut => self.cut(place)?,
                Step::Repair => self.repair(place)?,
                Step::CutOff => self.cut_off(place),
                Step::Damage => self.damage(place),
            };
            self.shelf[place] = file;
        }
        Ok(())
    }

    /// Leaves the files for `urg/tests/recording_histories.py`, each with its messages: topic, log
    /// time and checksum.
    fn write_for_others(&self, seed: u64) {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("histories");
        std::fs::create_dir_all(&folder).unwrap();
        for (number, file) in self.shelf.iter().enumerate().filter(|(_, file)| file.is_complete) {
            let path = folder.join(format!("{seed}_{number}.mcap"));
            let line = |message: &Message| {
                let topic = message.topic.split(' ').next().unwrap_or_default();
                format!("{topic} {} {}\n", message.log_time, crc32fast::hash(&message.data))
            };
            std::fs::write(
                path.with_extension("txt"),
                file.must.iter().map(line).collect::<String>(),
            )
            .unwrap();
            std::fs::write(path, &file.bytes).unwrap();
        }
    }

    /// Draws the compression of a copy, or `None` to keep the compression of the inputs.
    fn compression(&mut self) -> Option<Compression> {
        (!self.random.once_in(2)).then(|| *self.random.pick(&own::compressions()))
    }

    /// Joins some files in any order.
    fn join(&mut self) -> Result<File, Wrong> {
        let mut files: Vec<File> = self.shelf.clone();
        while files.len() > 3 || files.len() > 1 && self.random.once_in(3) {
            files.remove(self.random.below(files.len() as u64) as usize);
        }
        for place in (1..files.len()).rev() {
            files.swap(place, self.random.below(place as u64 + 1) as usize);
        }
        let mut out = Vec::new();
        let outcome = {
            let inputs = files.iter().map(|file| file.input(self.is_on_disk)).collect();
            copy(inputs, .., self.compression(), &mut out)?
        };
        let joined = written(out, (outcome.messages, outcome.scans))?;
        let all = |of: fn(&File) -> &Vec<Message>| -> Vec<Message> {
            files.iter().flat_map(of).cloned().collect()
        };
        let is_loose = files.iter().any(|file| file.is_loose);
        compare(&joined.must, &all(|file| &file.must), &all(|file| &file.may), is_loose)?;
        let complete = files.iter().filter(|file| file.is_complete);
        let expected: BTreeSet<_> = complete.flat_map(|file| &file.topics).cloned().collect();
        is_so(joined.topics.is_superset(&expected), || {
            format!("topics lost: {:?}", expected.difference(&joined.topics))
        })?;
        is_so(
            joined.is_sorted() || !files.iter().all(|file| file.is_complete && file.is_sorted()),
            || "joined out of order".to_owned(),
        )?;
        Ok(joined)
    }

    /// Copies a part of a whole file.
    fn cut(&mut self, place: usize) -> Result<File, Wrong> {
        let compression = self.compression();
        let file = &self.shelf[place];
        let (from, length) = (self.random.ms(4_000), self.random.ms(10_000));
        let range = from..from + length;
        let mut out = Vec::new();
        let outcome =
            copy(vec![file.input(self.is_on_disk)], range.clone(), compression, &mut out)?;
        let told = outcome.was_truncated || outcome.damaged_parts > 0;
        is_so(!told, || format!("a part of a whole file: {outcome:?}"))?;
        let part = written(out, (outcome.messages, outcome.scans))?;
        let (mut first, mut inside) = (None, Vec::new());
        // Last message before the part of each latched topic and frame.
        let mut latched: BTreeMap<_, (u64, usize)> = BTreeMap::new();
        for (place, message) in file.must.iter().enumerate() {
            if message.is_scan() {
                first.get_or_insert(message.log_time);
            }
            let since = message.log_time.saturating_sub(first.unwrap_or(message.log_time));
            let since = Duration::from_nanos(since);
            if range.contains(&since) {
                inside.push(message.clone());
            } else if since < range.start && inside.is_empty() {
                for topic in message.latched() {
                    let last = latched.entry(topic).or_default();
                    *last = (*last).max((message.log_time, place));
                }
            }
        }
        let latched: BTreeSet<usize> = latched.values().map(|(_, place)| *place).collect();
        let mut expected = inside.clone();
        if let Some(begin) = inside.first() {
            let at_begin =
                |place: usize| Message { log_time: begin.log_time, ..file.must[place].clone() };
            expected.extend(latched.into_iter().map(at_begin));
        }
        let is_other = |message: &&Message| !message.is_version();
        let others = |messages: &[Message]| -> Vec<Message> {
            messages.iter().filter(is_other).cloned().collect()
        };
        compare(&others(&part.must), &others(&expected), &others(&expected), false)?;
        let places = |of: &Message| -> Vec<usize> {
            let all = part.must.iter().enumerate().filter(|(_, message)| *message == of);
            all.map(|(place, _)| place).collect()
        };
        let latched = &expected[inside.len()..];
        // An equal one may be latched, in a file that was joined with its own part.
        let equal = latched.iter().filter(|latched| inside.first() == Some(latched)).count();
        is_so(
            latched.iter().all(|one| places(one).first() <= places(&inside[0]).get(equal)),
            || "a latched message after the beginning of the part".to_owned(),
        )?;
        is_so(part.topics == file.topics, || {
            format!("other topics: {:?}", part.topics.symmetric_difference(&file.topics))
        })?;
        // The library reads the same part.
        let records = open(file.input(self.is_on_disk))?.range(range);
        let records = records.collect::<Result<Vec<_>, _>>()?;
        let read = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_))).count();
        let there = inside.iter().filter(|message| message.is_laser_scan() && message.is_scan());
        let there = there.count();
        is_so(read == there, || format!("{read} scan messages read of {there} in the part"))?;
        Ok(File { stream: file.stream, ..part })
    }

    fn repair(&mut self, place: usize) -> Result<File, Wrong> {
        let compression = self.compression();
        let file = &self.shelf[place];
        let mut out = Vec::new();
        let outcome = copy(vec![file.input(self.is_on_disk)], .., compression, &mut out)?;
        let repaired = written(out, (outcome.messages, outcome.scans))?;
        compare(&repaired.must, &file.must, &file.may, file.is_loose)?;
        is_so(!file.is_complete || repaired.topics == file.topics, || {
            format!("other topics: {:?}", repaired.topics.symmetric_difference(&file.topics))
        })?;
        let told = outcome.was_truncated || outcome.damaged_parts > 0;
        is_so(!file.is_complete || !told, || format!("a whole file: {outcome:?}"))?;
        let is_same = file.is_loose || repaired.must.len() == file.may.len();
        is_so(told || is_same && !file.is_proved, || "a loss untold".to_owned())?;
        is_so(file.metadata.iter().all(|metadata| repaired.metadata.contains(metadata)), || {
            "metadata lost".to_owned()
        })?;
        // What no checksum proves may be damaged: values, and the window of the stream.
        let is_known = |message: &Message| file.may.iter().any(|may| may.is_but_for_type(message));
        let is_intact = repaired.metadata.iter().all(|metadata| file.metadata.contains(metadata))
            && repaired.must.iter().all(is_known);
        let stream = file.stream.filter(|_| is_intact);
        let is_described = !repaired.metadata.is_empty();
        let is_told = is_described || file.must.iter().any(Message::tells_sensor);
        // Each scan of a stream is given back that the damage left, as a reply or a message.
        let left = file.must.iter().filter(|message| message.is_scan());
        let left = left.filter(|message| is_told || !message.needs_sensor());
        let left = left.map(|message| message.publish_time);
        let left: BTreeSet<u64> =
            left.filter(|stamp| stream.is_some_and(|stream| stream.has(*stamp))).collect();
        let has_window = is_described || left.len() >= WINDOW_POLLS;
        // The library reads as much of the damaged file.
        let (mut read, mut damaged, mut given) = (0, 0, BTreeSet::new());
        for scan in open(file.input(self.is_on_disk))?.scans() {
            match scan {
                Ok(scan) => {
                    if let Some((stamp, delivered)) = stream.and_then(|stream| stream.find(&scan)) {
                        let wrong = difference(&scan, delivered, false, false);
                        is_so(
                            wrong.is_none() || !has_window && is_wider(&scan, delivered),
                            || wrong.unwrap_or_default(),
                        )?;
                        given.insert(stamp);
                    }
                    read += 1;
                }
                Err(RecordingError::Damaged { .. }) => damaged += 1,
                Err(RecordingError::NoScans { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        is_so(read == outcome.scans, || format!("{read} scans read, {} repaired", outcome.scans))?;
        is_so(damaged == outcome.damaged_parts, || {
            format!("{damaged} damaged parts read, {} repaired", outcome.damaged_parts)
        })?;
        let hidden = left.difference(&given).count();
        is_so(hidden == 0 || !has_window, || format!("hidden: {hidden} scans of {}", left.len()))?;
        Ok(File { stream, ..repaired })
    }

    /// Cuts a file off, as a kill or a full disk does.
    fn cut_off(&mut self, place: usize) -> File {
        let mut file = self.shelf[place].clone();
        let length = 8 + self.random.below(file.bytes.len() as u64 - 8) as usize;
        let layout = Layout::new(&file.bytes, &file.must);
        file.must = layout.survivors(|place| place.end > length, false);
        file.metadata = layout.metadata(|place| place.end > length);
        file.bytes.truncate(length);
        File { is_complete: false, ..file }
    }

    /// Overwrites some bytes, inserts some, removes some, or gives a record another length.
    fn damage(&mut self, place: usize) -> File {
        let whole = &self.shelf[place];
        let layout = Layout::new(&whole.bytes, &whole.must);
        let random = &mut self.random;
        let mut places: Vec<usize> = Vec::new();
        for _ in 0..1 + random.below(3) {
            let last = places.last().filter(|_| random.once_in(3));
            places.push(match (last, random.once_in(2)) {
                // Near the last one.
                (Some(last), _) => (last + random.below(100) as usize).min(whole.bytes.len() - 1),
                (None, true) => *random.pick(&layout.boundaries),
                (None, false) => random.below(whole.bytes.len() as u64) as usize,
            });
        }
        // From the end, so that the places before it stay.
        places.sort_unstable_by_key(|place| std::cmp::Reverse(*place));
        let mut file = whole.clone();
        let (mut hits, mut struck) = (Vec::<Range<usize>>::new(), Vec::<Range<usize>>::new());
        // Number of bytes that each chunk has lost or gained, by its place.
        let mut moved: BTreeMap<usize, usize> = BTreeMap::new();
        for at in places {
            // A damage after it took the rest.
            if at + 9 > file.bytes.len() {
                continue;
            }
            let is_boundary = layout.boundaries.contains(&at);
            let kind = random.below(6);
            let widths = [1, 1 + random.below(3), 1 + random.below(40), 1 + random.below(600)];
            let width = *random.pick(&widths);
            // What lies after an earlier damage has another place now.
            let earlier = struck.last().map_or(file.bytes.len(), |hit| hit.start.max(at + 1));
            let end = (at + width as usize).min(earlier).min(file.bytes.len());
            match kind {
                0 => file.bytes[at..end].fill_with(|| random.next() as u8),
                1 => file.bytes[at] ^= 1 << random.below(8),
                5 => file.bytes[at..end].fill(0),
                2 => {
                    let stray = (0..end - at).map(|_| match random.once_in(2) {
                        true => random.below(0x12) as u8,
                        false => random.next() as u8,
                    });
                    let mut stray: Vec<u8> = stray.collect();
                    // It would take the place of a kind that no search finds.
                    if let Some(last) = stray.last_mut().filter(|_| whole.bytes[at] >= 0x10) {
                        *last |= 0x10;
                    }
                    file.bytes.splice(at..at, stray);
                }
                // The byte before would take the place of the kind.
                3 if at.checked_sub(1).is_some_and(|at| whole.bytes[at] < 0x10) => continue,
                3 => drop(file.bytes.drain(at..end)),
                _ if is_boundary && at < layout.summary.start => {
                    let length = random.below((file.bytes.len() - at) as u64);
                    let aim = random.pick(&layout.boundaries).checked_sub(at + 9);
                    let (aim, is_aimed) = (aim.unwrap_or(0) as u64, random.once_in(2));
                    let is_data = matches!(whole.bytes[at], 0x05 | 0x10..);
                    let length = if is_aimed && !is_data { aim } else { length };
                    file.bytes[at + 1..at + 9].copy_from_slice(&length.to_le_bytes());
                    hits.push(at + 1..at + 9);
                    struck.push(at + 1..at + 9);
                    hits.extend(layout.swallowed(&whole.bytes, &file.bytes, at));
                    continue;
                }
                _ => continue,
            }
            struck.push(at..end);
            hits.extend(layout.swallowed(&whole.bytes, &file.bytes, at));
            match kind {
                0 | 5 => {
                    hits.push(at..end);
                    let heads = layout.boundaries.iter().filter(|head| (at..end).contains(head));
                    hits.extend(
                        heads.filter_map(|head| layout.swallowed(&whole.bytes, &file.bytes, *head)),
                    );
                }
                1 => hits.push(at..at + 1),
                _ => {
                    hits.push(if kind == 2 { at..at } else { at..end });
                    // What it is in keeps its length, and so loses its last bytes or gains others.
                    let width = end - at;
                    let record = layout.boundaries.iter().find(|end| **end > at).copied();
                    let is_around =
                        |chunk: &&(Range<usize>, usize)| chunk.0.start < at && at < chunk.0.end;
                    let chunk = layout.chunks.iter().find(is_around);
                    let width = chunk.map_or(width, |(chunk, _)| {
                        let moved = moved.entry(chunk.start).or_default();
                        *moved += width;
                        *moved
                    });
                    for end_of in record.into_iter().chain(chunk.map(|(chunk, _)| chunk.end)) {
                        if kind == 3 {
                            hits.extend([end_of..end_of + width, end..end + width]);
                        }
                        hits.extend(layout.swallowed(&whole.bytes, &file.bytes, end_of));
                    }
                    if let Some((chunk, records)) = chunk {
                        hits.push(records.saturating_sub(width)..*records);
                        // Nothing shows the end of one with more fields.
                        if *records < chunk.end {
                            hits.push(chunk.clone());
                        }
                    }
                }
            }
        }
        let mut is_loose = layout.is_unproved(is_in(&hits)) || layout.hides_kind(&struck);
        let struck_end = struck.iter().map(|hit| hit.end).max().unwrap_or(MAGIC.len());
        if let Some(rest @ 1..) = whole.bytes.len().checked_sub(struck_end)
            && random.once_in(4)
        {
            // Cut off, too: nothing proves the last chunk.
            let end = struck_end + random.below(rest as u64) as usize;
            file.bytes.truncate((file.bytes.len() + end).saturating_sub(whole.bytes.len()));
            hits.push(end..usize::MAX);
            is_loose |= layout.chunks.iter().any(|(chunk, _)| {
                let moved = moved.get(&chunk.start).unwrap_or(&0);
                (chunk.start..chunk.end + moved).contains(&end) && is_in(&struck)(chunk)
            });
        }
        let is_hit = is_in(&hits);
        // The footer has the position of the index.
        let has_index = whole.has_index && file.bytes.len() == whole.bytes.len();
        file.must = layout.survivors(is_hit, self.is_on_disk && has_index);
        file.metadata = layout.metadata(is_hit);
        // So much of the beginning may be damaged that this could be any file.
        if file.must.is_empty() {
            return whole.clone();
        }
        let is_proved = layout.has_sum
            && !is_hit(&(layout.summary.start..layout.summary.start + 13))
            && file.bytes[..layout.summary.start.min(file.bytes.len())]
                != whole.bytes[..layout.summary.start];
        File { is_complete: false, is_loose, is_proved, ..file }
    }
}

/// Outcome of a history: its steps, a checksum of its files, and what went wrong.
struct Outcome {
    steps: Vec<Step>,
    checksum: u32,
    result: Result<(), String>,
}

/// Runs the history of a seed.
fn run(seed: u64) -> Outcome {
    let mut history = match History::new(seed) {
        Ok(history) => history,
        Err(Wrong(text)) => return Outcome { steps: Vec::new(), checksum: 0, result: Err(text) },
    };
    let result = history.run();
    if seed < FOR_OTHERS && result.is_ok() {
        history.write_for_others(seed);
    }
    let checksum = checksum(history.shelf.iter().map(|file| &file.bytes));
    let result = result.map_err(|Wrong(text)| format!("{:?}: {text}", history.steps));
    Outcome { steps: history.steps, checksum, result }
}

fn checksum(parts: impl Iterator<Item = impl AsRef<[u8]>>) -> u32 {
    let mut checksum = crc32fast::Hasher::new();
    parts.for_each(|part| checksum.update(part.as_ref()));
    checksum.finalize()
}

/// Otherwise a history that fails may pass the next time.
#[test]
fn each_seed_repeats_its_bytes() {
    for seed in 0..24 {
        let digest = || checksum(own(seed).files.iter());
        assert_eq!(digest(), digest(), "recording {seed}");
    }
    for seed in FOR_OTHERS..FOR_OTHERS + 24 {
        assert_eq!(run(seed).checksum, run(seed).checksum, "history {seed}");
    }
}

#[test]
fn histories_lose_nothing_and_mix_nothing() {
    let seeds = seeds("URG_HISTORIES", 700);
    let count = seeds.end - seeds.start;
    let threads = std::thread::available_parallelism().unwrap().get();
    let outcomes = std::thread::scope(|scope| {
        let part =
            |thread| seeds.clone().skip(thread).step_by(threads).map(|seed| (seed, run(seed)));
        let run_part = |thread| scope.spawn(move || part(thread).collect::<Vec<_>>());
        let parts: Vec<_> = (0..threads).map(run_part).collect();
        parts.into_iter().flat_map(|part| part.join().unwrap()).collect::<BTreeMap<_, _>>()
    });
    let mut wrong: BTreeMap<String, (u64, u64, String)> = BTreeMap::new();
    let mut counts = BTreeMap::new();
    let checksums: Vec<_> = outcomes.values().map(|one| one.checksum.to_le_bytes()).collect();
    for (seed, Outcome { steps, result, .. }) in outcomes {
        steps.into_iter().for_each(|step| *counts.entry(step).or_insert(0_u64) += 1);
        if let Err(text) = result {
            // By the last step and what is wrong after it.
            let kind = text.split(']').take(1).flat_map(|steps| steps.rsplit([' ', '['])).next();
            let what = text.split("]: ").nth(1).unwrap_or_default();
            let what = what.split([':', '[']).next().unwrap_or_default();
            let what = what.replace(|letter: char| letter.is_ascii_digit(), "");
            let kind = format!("{}: {what}", kind.unwrap_or_default());
            wrong.entry(kind).or_insert((seed, 0, text)).1 += 1;
        }
    }
    let checksum = checksum(checksums.iter());
    println!("{count} histories: {counts:?}, checksum {checksum:08x}");
    for (kind, (seed, count, text)) in &wrong {
        println!("{count} times {kind}, first seed {seed}: {text:.600}");
    }
    assert!(wrong.is_empty(), "went wrong: {:?}", wrong.keys());
}

/// Joined, so that a reply and its scan may be in two files, and as a folder of files.
#[test]
fn each_recorded_scan_is_given_back_once() {
    let mut wrong = Vec::new();
    for (seed, recording) in recordings().iter().enumerate() {
        let mut joined = Vec::new();
        let inputs = recording.files.iter().map(|file| Cursor::new(file.clone()));
        cut(inputs, .., None, &mut joined).unwrap();
        let (found, left_out) = scans(&joined).map_err(|Wrong(text)| text).unwrap();
        // Each reply and each message without one is a scan or counted. So is a message whose reply
        // is counted.
        let messages = read(&joined).unwrap();
        let (scans, replies): (Vec<_>, Vec<_>) =
            messages.iter().filter(|one| one.is_scan()).partition(|one| one.is_laser_scan());
        let stamps: BTreeSet<u64> = replies.iter().map(|reply| reply.publish_time).collect();
        let (mut given, mut other) = (BTreeSet::new(), 0);
        for scan in &found {
            let stamp = nanos(scan.times().stamp);
            let Some((delivered_at, delivered)) = recording.delivered.find(scan) else {
                other += u64::from(!recording.streamed.contains(&stamp));
                continue;
            };
            given.insert(delivered_at);
            let has_reply = stamps.contains(&stamp);
            let text = difference(scan, delivered, has_reply, recording.is_told);
            wrong.extend(text.map(|text| format!("seed {seed}: {text:.400}")));
        }
        let alone = scans.iter().filter(|scan| !stamps.contains(&scan.publish_time)).count();
        let least = (replies.len() + alone) as u64;
        let told = found.len() as u64 + left_out;
        let is_told = (least..=(replies.len() + scans.len()) as u64).contains(&told);
        assert!(is_told, "seed {seed}: {told} of {least} messages");
        let stamps: BTreeSet<u64> = found.iter().map(|scan| nanos(scan.times().stamp)).collect();
        let folder = own::folder(1);
        for (number, file) in recording.files.iter().enumerate() {
            std::fs::write(folder.join(format!("bag_{number}.mcap")), file).unwrap();
        }
        let in_folder = Recording::open(&folder).unwrap().scans().map(Result::unwrap);
        let in_folder: BTreeSet<u64> = in_folder.map(|scan| nanos(scan.times().stamp)).collect();
        std::fs::remove_dir_all(folder).unwrap();
        if in_folder != stamps {
            wrong.push(format!("seed {seed}: {} scans in a folder", in_folder.len()));
        }
        let missing = recording.recorded.difference(&given).count() as u64;
        let doubled = (found.len() - stamps.len()) as u64;
        if missing + other + doubled > 0 {
            wrong
                .push(format!("seed {seed}: {missing} missing, {other} others, {doubled} doubled"));
        }
    }
    assert!(wrong.is_empty(), "{} of {RECORDINGS}: {wrong:#?}", wrong.len());
}
