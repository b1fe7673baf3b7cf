//! What is in a recording, for who asks: from when to when, how many scans, and
//! where there are none.

use std::time::{Duration, SystemTime};

use serde_json::{Value, json};
use tokio_scip::recording::{Entry, Recording, RecordingError};

use crate::format::utc::Utc;

/// Something that there is to tell: its name, and it as data and as text.
pub(crate) type Row = (&'static str, Value, String);

/// So much longer than a period is a gap.
const GAP: Duration = Duration::from_secs(1);
/// How many gaps are told one by one in a text.
const TOLD: usize = 5;

/// Reads all of it; blocks for as long as that takes.
pub(crate) fn rows(mut recording: Recording) -> Result<Vec<Row>, RecordingError> {
    let (window, rate) = (recording.window(), recording.rate());
    let longest = rate.and_then(|rate| rate.period()).unwrap_or_default() + GAP;
    let mut times = Times::default();
    for record in recording.by_ref() {
        let record = record?;
        // Stamps stay those of the original when a replay is recorded.
        if let Entry::Scan(scan) = record.entry {
            times.scan(scan.stamp, longest);
        }
    }
    let complete = !recording.is_truncated();
    let Times { scans, gaps, .. } = &times;
    let asked = window.map(|window| format!(" of {window}")).unwrap_or_default();
    let asked = rate.map(|rate| format!("{asked}, asked for at {rate}")).unwrap_or(asked);
    let end = if complete { "yes" } else { "no: its end is missing; all that was read is above" };
    let mut rows = vec![
        ("scans", json!(scans), format!("{scans}{asked}")),
        ("gaps", json!(gaps), told(gaps)),
        ("complete", json!(complete), end.to_owned()),
    ];
    if let Some((first, last)) = times.span {
        let (began, seconds) = (Utc::from(first).to_string(), since(first, last));
        let text = format!("{began}, for {}", clock(seconds));
        rows.insert(0, ("recorded", json!({ "began": began, "seconds": seconds }), text));
    }
    Ok(rows)
}

/// When scans came.
#[derive(Debug, Default)]
struct Times {
    scans: u64,
    /// The first one and the last one.
    span: Option<(SystemTime, SystemTime)>,
    gaps: Vec<Gap>,
}

/// A time without scans, in seconds since the first one.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
struct Gap {
    from: f64,
    seconds: f64,
}

impl Times {
    fn scan(&mut self, at: SystemTime, longest: Duration) {
        self.scans += 1;
        let (first, last) = *self.span.get_or_insert((at, at));
        let seconds = since(last, at);
        if seconds > longest.as_secs_f64() {
            self.gaps.push(Gap { from: since(first, last), seconds });
        }
        self.span = Some((first, at));
    }
}

fn since(before: SystemTime, after: SystemTime) -> f64 {
    after.duration_since(before).unwrap_or_default().as_secs_f64()
}

fn told(gaps: &[Gap]) -> String {
    if gaps.is_empty() {
        return "none".to_owned();
    }
    let one = |gap: &Gap| format!("{:.1} s at {}", gap.seconds, clock(gap.from));
    let mut text = gaps.iter().take(TOLD).map(one).collect::<Vec<_>>().join(", ");
    if gaps.len() > TOLD {
        text = format!("{}, the first of them {text}", gaps.len());
    }
    text
}

/// `1:02:03`, hours only where there are any.
pub(crate) fn clock(seconds: f64) -> String {
    let seconds = seconds as u64;
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    match hours {
        0 => format!("{minutes}:{seconds:02}"),
        _ => format!("{hours}:{minutes:02}:{seconds:02}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_told_with_their_places_in_the_recording() {
        let mut times = Times::default();
        for tenth in (0..20).chain(320..330).chain(341..350) {
            let at = SystemTime::UNIX_EPOCH + Duration::from_millis(tenth * 100);
            times.scan(at, Duration::from_millis(1100));
        }
        assert_eq!(times.scans, 39);
        assert_eq!(told(&times.gaps), "30.1 s at 0:01, 1.2 s at 0:32");
        assert_eq!(told(&[]), "none");
        let many = [Gap { from: 3_661.0, seconds: 2.0 }; 6];
        assert!(told(&many).starts_with("6, the first of them 2.0 s at 1:01:01, 2.0 s"));
    }
}
