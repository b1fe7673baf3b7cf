//! Contents of a recording for `urg info`: time span, number of scans, what was left out, gaps,
//! sources, the sensor's clock, and changes of the wall clock. You can pass any of these times to
//! `--range`: they count from the first scan on the steady clock. Stamps may jump.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, SystemTime};

use bytesize::ByteSize;
use serde_json::{Value, json};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Geometry, Rate, Version, Window};
use urg_recording::{ChunkBytes, Compression, LeftOut, RecordedScans, Recording, RecordingError};

use super::clock::Clock;
use super::sensor_clock::SensorClock;
use crate::format::counted;
use crate::format::time::{self, clock};

/// Property of a recording: name, value as JSON, value as text.
pub(crate) type Row = (&'static str, Value, String);

/// A pause between two scans is a gap if it exceeds the period by this time.
const GAP_TOLERANCE: Duration = Duration::from_secs(1);
/// The wall clock was set if it differs from the steady clock by more than this between two
/// scans, in seconds. Longer than any reply takes.
const CLOCK_TOLERANCE: f64 = 1.0;
const MAX_LISTED: usize = 5;
/// Number of windows to tell apart.
const MAX_WINDOWS: usize = 16;

#[derive(Debug)]
pub(crate) struct Contents {
    pub(crate) version: Version,
    /// Geometry of the sensor of the first scan.
    pub(crate) geometry: Option<Geometry>,
    /// Baud rate of the line, or `None` on USB. `None` also if the recording does not have it.
    pub(crate) baud_rate: Option<Option<BaudRate>>,
    pub(crate) rows: Vec<Row>,
    /// Messages that were read and are no scan.
    pub(crate) left_out: Vec<LeftOut>,
}

/// Reads the whole recording, which has no `path` if it is a pipe. Blocks for as long as that takes.
pub(crate) fn read(path: Option<&Path>, recording: Recording) -> Result<Contents, RecordingError> {
    let (window, rate) = (recording.window(), recording.rate());
    let baud_rate = recording.metadata().get("baud_rate").map(|rate| rate.parse().ok());
    let mut times = ScanTimes::new(rate, baud_rate.flatten());
    let mut windows = Windows::default();
    let (mut stamps, mut log_times) = (Clock::default(), Clock::default());
    let mut sensor_clock = SensorClock::default();
    let (mut damaged_at, mut geometry, mut has_intensities) = (Vec::new(), None, false);
    let mut version = Version::default();
    // Same scans as in a replay.
    let mut recorded = recording.scans().of_one_sensor();
    while let Some(scan) = recorded.next() {
        match scan {
            Ok(scan) => {
                // Another sensor's may follow.
                if geometry.is_none() {
                    version = recorded.version();
                }
                geometry.get_or_insert(*scan.geometry());
                windows.add(scan.window());
                has_intensities |= scan.intensities().is_some();
                stamps.add(scan.times().stamp);
                log_times.add(recorded.log_time());
                times.add(recorded.position(), scan.times().stamp);
                if let Some(clock) = recorded.sensor_clock() {
                    let revolution = scan.geometry().revolution();
                    let is_every =
                        rate.is_some_and(|rate| rate.period() < Some(revolution * 5 / 4));
                    sensor_clock.add(clock, recorded.position(), is_every.then_some(revolution));
                }
            }
            Err(RecordingError::Damaged { offset, .. }) => damaged_at.push(offset),
            // The sensor may have been away for the whole recording.
            Err(RecordingError::NoScans { .. }) if recorded.version() != Version::default() => {}
            Err(error) => return Err(error),
        }
    }
    times.add_gap(recorded.end());
    let left_out = recorded.recording().left_out().counts();
    let ScanTimes { scans, gaps, clock_steps, .. } = &mut times;
    if stamps.stands() || log_times.stands() {
        clock_steps.clear();
    }
    let asked = windows.describe(window);
    let asked = rate.map(|rate| format!("{asked}, asked for at {rate}")).unwrap_or(asked);
    let intensities = if has_intensities { ", with intensities" } else { "" };
    let mut end = Vec::new();
    if recorded.recording().is_truncated() {
        end.push("its end is missing or damaged".to_owned());
    }
    if let Some(first) = damaged_at.first() {
        let parts = counted(damaged_at.len() as u64, "damaged part");
        end.push(format!("{parts} left out, the first at byte {first}"));
    }
    let complete = end.is_empty();
    if !complete {
        let file = path.unwrap_or(Path::new("- whole.mcap")).display();
        end.push(format!("all the rest is above; `urg repair {file}` makes a complete file of it"));
    }
    let end = if complete { "yes".to_owned() } else { format!("no: {}", end.join("; ")) };
    let mut rows = vec![
        ("scans", json!(scans), format!("{scans}{asked}{intensities}")),
        left_out_row(&left_out),
        match log_times.stands() {
            true => ("gaps", Value::Null, "not known without log times".to_owned()),
            false => ("gaps", json!(gaps), listed(gaps, Gap::to_string)),
        },
        losses_row(&recorded, sensor_clock.lost),
        ("complete", json!(complete), end),
    ];
    rows.push(compression_row(&recorded.recording().chunk_bytes()));
    rows.extend(sensor_clock.describe().map(|(data, text)| ("sensor_clock", data, text)));
    rows.extend(source_row(&recorded));
    if recorded.is_disconnected() {
        let at = recorded.position().as_secs_f64();
        rows.push(("link", json!(at), format!("lost at {}, and not back", clock(at))));
    }
    // The row of the clock has those that were set back.
    let faults = [
        stamps.fault("stamp", clock_steps.len() as u64),
        log_times.fault("log time", 0).map(|fault| format!("{fault}: --range counts by them")),
    ];
    if faults.iter().any(Option::is_some) {
        let text = faults.into_iter().flatten().collect::<Vec<_>>().join("; ");
        rows.insert(0, ("times", json!({ "stamps": stamps, "log_times": log_times }), text));
    }
    if !clock_steps.is_empty() {
        let steps = listed(clock_steps, ClockStep::to_string);
        let text = format!("{steps}; the times here and of --range do not jump");
        rows.insert(0, ("clock", json!(clock_steps), text));
    }
    if let Some(span) = times.span {
        let (began, seconds) = (time::utc(span.began), times.length().as_secs_f64());
        let text = format!("{began}, for {}", clock(seconds));
        rows.insert(0, ("recorded", json!({ "began": began, "seconds": seconds }), text));
    }
    if version == Version::default() {
        version = recorded.version();
    }
    Ok(Contents { version, geometry, baud_rate, rows, left_out })
}

fn left_out_row(counts: &[LeftOut]) -> Row {
    let text = match counts {
        [] => "none".to_owned(),
        counts => counts.iter().map(LeftOut::to_string).collect::<Vec<_>>().join("; "),
    };
    ("left_out", json!(counts), text)
}

/// Describes what did not arrive. `lost` is the number of scans that are missing by the sensor's clock,
/// with or without an error.
fn losses_row(recorded: &RecordedScans, lost: u64) -> Row {
    let failed = recorded.failed_polls();
    if lost.max(failed) == 0 && recorded.version() == Version::default() {
        // Another program recorded only the scans.
        return ("losses", Value::Null, "not recorded".to_owned());
    }
    // Nothing tells which sensor's.
    let of = if recorded.serial_numbers().len() > 1 { " of all sensors" } else { "" };
    let polls = counted(failed, "poll") + " without a scan" + of;
    let scans = counted(lost.saturating_sub(failed), "scan") + " lost on the way";
    let text = match (failed, lost) {
        (0, 0) => "none".to_owned(),
        (0, _) => scans,
        _ if lost <= failed => polls,
        _ => format!("{polls}, {scans}"),
    };
    ("losses", json!(lost.max(failed)), text)
}

fn compression_row(bytes: &ChunkBytes) -> Row {
    let ChunkBytes { compressions, stored, plain, .. } = bytes;
    let compressed = compressions.iter().filter(|name| **name != Compression::Plain);
    let names: Vec<_> = compressed.map(Compression::to_string).collect();
    let text = match names[..] {
        [] => "none".to_owned(),
        _ => {
            let share = 100.0 * *stored as f64 / (*plain).max(1) as f64;
            let (names, plain) = (names.join(" and "), ByteSize(*plain).display().si());
            format!("{names}, to {share:.0} % of {plain:.1}")
        }
    };
    ("compression", json!({ "names": names, "bytes": stored, "plain_bytes": plain }), text)
}

/// Describes the sensors, if there are several.
fn source_row(recorded: &RecordedScans) -> Option<Row> {
    let sources = [("frames", recorded.frame_ids()), ("sensors", recorded.serial_numbers())];
    let several = |(noun, names): &(&str, &BTreeSet<String>)| {
        let listed = names.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        (names.len() > 1).then(|| format!("scans of {} {noun}: {listed}", names.len()))
    };
    let text: Vec<_> = sources.iter().filter_map(several).collect();
    let value =
        json!({ "frame_ids": recorded.frame_ids(), "serial_numbers": recorded.serial_numbers() });
    (!text.is_empty()).then(|| ("sources", value, text.join("; ")))
}

/// Windows of the scans, in the order in which they came, with the number of their scans.
#[derive(Debug, Default)]
struct Windows {
    counts: Vec<(Window, u64)>,
    others: u64,
}

impl Windows {
    fn add(&mut self, window: Window) {
        let is_full = self.counts.len() == MAX_WINDOWS;
        match self.counts.iter_mut().find(|(known, _)| *known == window) {
            Some((_, scans)) => *scans += 1,
            None if is_full => self.others += 1,
            None => self.counts.push((window, 1)),
        }
    }

    /// Describes the windows, of which one is `asked` for.
    fn describe(&self, asked: Option<Window>) -> String {
        match self.counts.as_slice() {
            [] => asked.map(|window| format!(" of {window}")).unwrap_or_default(),
            [(window, _)] => format!(" of {window}"),
            counts => {
                let text = listed(counts, |(window, scans)| format!("{scans} of {window}"));
                match self.others {
                    0 => format!(": {text}"),
                    others => format!(": {text}, and {others} of further windows"),
                }
            }
        }
    }
}

/// Span, gaps and clock changes of the scans read or recorded so far.
#[derive(Debug, Default)]
pub(crate) struct ScanTimes {
    /// Longest time between two scans that is no gap.
    longest: Duration,
    scans: u64,
    span: Option<ScanSpan>,
    pub(crate) gaps: Vec<Gap>,
    clock_steps: Vec<ClockStep>,
}

#[derive(Debug, Clone, Copy)]
struct ScanSpan {
    /// Stamp of the first scan.
    began: SystemTime,
    /// Positions of the first and the latest scan.
    first: Duration,
    last: Duration,
    /// Stamp of the latest scan.
    stamp: SystemTime,
}

/// Pause without scans, in seconds since the first scan.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Gap {
    from: f64,
    seconds: f64,
}

/// Change of the wall clock, in seconds since the first scan.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
struct ClockStep {
    at: f64,
    seconds: f64,
}

impl ScanTimes {
    /// Starts before the first scan of a stream of this rate, on a line of this baud rate.
    pub(crate) fn new(rate: Option<Rate>, line: Option<BaudRate>) -> Self {
        let period = rate.and_then(|rate| rate.period()).unwrap_or_default();
        // The longest scan of the slowest line takes longer than the tolerance.
        let wire_time = line.map(|line| Window::FULL.wire_time(line, Protocol::Scip2));
        let longest = period.max(wire_time.unwrap_or_default()) + GAP_TOLERANCE;
        Self { longest, ..Self::default() }
    }

    /// Time from the first scan to the last one.
    pub(crate) fn length(&self) -> Duration {
        self.span.map_or(Duration::ZERO, |span| span.last - span.first)
    }

    /// Adds a gap if there was no scan up to here for too long.
    fn add_gap(&mut self, position: Duration) {
        let from = self.span.map_or(position, |span| span.last);
        let (since, from) = (position.saturating_sub(from), from.as_secs_f64());
        if since > self.longest {
            self.gaps.push(Gap { from, seconds: since.as_secs_f64() });
        }
    }

    /// Adds a scan. `position` counts on a steady clock.
    pub(crate) fn add(&mut self, position: Duration, stamp: SystemTime) {
        self.scans += 1;
        self.add_gap(position);
        let Some(span) = &mut self.span else {
            self.span = Some(ScanSpan { began: stamp, first: position, last: position, stamp });
            return;
        };
        let since = position.saturating_sub(span.last);
        let seconds = difference(span.stamp, stamp) - since.as_secs_f64();
        if seconds.abs() > CLOCK_TOLERANCE {
            self.clock_steps.push(ClockStep { at: position.as_secs_f64(), seconds });
        }
        span.last = span.last.max(position);
        span.stamp = stamp;
    }
}

impl std::fmt::Display for ClockStep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let direction = if self.seconds < 0.0 { "back" } else { "forward" };
        write!(f, "set {direction} by {} at {}", clock(self.seconds.abs()), clock(self.at))
    }
}

/// Computes the seconds from `from` to `to`, negative if `to` is earlier.
fn difference(from: SystemTime, to: SystemTime) -> f64 {
    match to.duration_since(from) {
        Ok(after) => after.as_secs_f64(),
        Err(before) => -before.duration().as_secs_f64(),
    }
}

impl std::fmt::Display for Gap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.1} s at {}", self.seconds, clock(self.from))
    }
}

/// Lists the first items.
fn listed<T>(items: &[T], one: impl Fn(&T) -> String) -> String {
    if items.is_empty() {
        return "none".to_owned();
    }
    let mut text = items.iter().take(MAX_LISTED).map(one).collect::<Vec<_>>().join(", ");
    if items.len() > MAX_LISTED {
        text = format!("{}, the first of them {text}", items.len());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_listed_with_their_places_in_the_recording() {
        let mut times = ScanTimes::new(Some(Rate::hz(10.0)), None);
        for tenth in (0..20).chain(320..330).chain(341..350) {
            let position = Duration::from_millis(tenth * 100);
            times.add(position, SystemTime::UNIX_EPOCH + position);
        }
        assert_eq!(times.clock_steps, []);
        assert_eq!(times.scans, 39);
        let listed = |gaps: &[Gap]| listed(gaps, Gap::to_string);
        assert_eq!(listed(&times.gaps), "30.1 s at 0:01, 1.2 s at 0:32");
        assert_eq!(listed(&[]), "none");
        let mut slow = ScanTimes::new(Some(Rate::UNLIMITED), Some(BaudRate::B19200));
        for millis in [0, 1_200, 2_400, 5_000] {
            slow.add(Duration::from_millis(millis), SystemTime::UNIX_EPOCH);
        }
        assert_eq!(listed(&slow.gaps), "2.6 s at 0:02");
        let many = [Gap { from: 3_661.0, seconds: 2.0 }; 6];
        assert!(listed(&many).starts_with("6, the first of them 2.0 s at 1:01:01, 2.0 s"));
    }
}
