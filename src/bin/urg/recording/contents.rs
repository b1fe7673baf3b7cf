//! The contents of a recording: its time span, the number of its scans, and its
//! gaps.

use std::path::Path;
use std::time::{Duration, SystemTime};

use serde_json::{Value, json};
use tokio_scip::recording::{Recording, RecordingError};

use crate::format::time::{self, clock};

/// A property of a recording: its name, and its value as data and as text.
pub(crate) type Row = (&'static str, Value, String);

/// A gap is a time without scans that is longer than a period by this.
const GAP_TOLERANCE: Duration = Duration::from_secs(1);
/// A text lists no more than so many gaps.
const MAX_LISTED_GAPS: usize = 5;

/// Reads the whole recording; blocks for as long as that takes.
pub(crate) fn rows(path: &Path, recording: Recording) -> Result<Vec<Row>, RecordingError> {
    let (window, rate) = (recording.window(), recording.rate());
    let longest = rate.and_then(|rate| rate.period()).unwrap_or_default() + GAP_TOLERANCE;
    let mut times = Times::default();
    let mut damaged_at = Vec::new();
    // The scans that a replay has. Their stamps stay those of the original when a
    // replay is recorded.
    let mut recorded = recording.scans();
    for scan in recorded.by_ref() {
        match scan {
            Ok(scan) => times.scan(scan.stamp(), longest),
            Err(RecordingError::Damaged { offset, .. }) => damaged_at.push(offset),
            Err(RecordingError::NoReplies) => {}
            Err(error) => return Err(error),
        }
    }
    let complete = !recorded.is_truncated() && damaged_at.is_empty();
    let Times { scans, gaps, .. } = &times;
    let asked = window.map(|window| format!(" of {window}")).unwrap_or_default();
    let asked = rate.map(|rate| format!("{asked}, asked for at {rate}")).unwrap_or(asked);
    let mut end = Vec::new();
    if recorded.is_truncated() {
        end.push("its end is missing".to_owned());
    }
    if let Some(first) = damaged_at.first() {
        let parts = damaged_at.len();
        end.push(format!("{parts} damaged parts left out, the first at byte {first}"));
    }
    let end = match complete {
        true => "yes".to_owned(),
        false => format!(
            "no: {}; all the rest is above; `urg repair {}` makes a complete file of it",
            end.join("; "),
            path.display()
        ),
    };
    let mut rows = vec![
        ("scans", json!(scans), format!("{scans}{asked}")),
        ("gaps", json!(gaps), listed(gaps)),
        ("complete", json!(complete), end),
    ];
    if let Some((first, last)) = times.span {
        let (began, seconds) = (time::utc(first), since(first, last));
        let text = format!("{began}, for {}", clock(seconds));
        rows.insert(0, ("recorded", json!({ "began": began, "seconds": seconds }), text));
    }
    Ok(rows)
}

/// The times at which scans came.
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

fn listed(gaps: &[Gap]) -> String {
    if gaps.is_empty() {
        return "none".to_owned();
    }
    let one = |gap: &Gap| format!("{:.1} s at {}", gap.seconds, clock(gap.from));
    let mut text = gaps.iter().take(MAX_LISTED_GAPS).map(one).collect::<Vec<_>>().join(", ");
    if gaps.len() > MAX_LISTED_GAPS {
        text = format!("{}, the first of them {text}", gaps.len());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_listed_with_their_places_in_the_recording() {
        let mut times = Times::default();
        for tenth in (0..20).chain(320..330).chain(341..350) {
            let at = SystemTime::UNIX_EPOCH + Duration::from_millis(tenth * 100);
            times.scan(at, Duration::from_millis(1100));
        }
        assert_eq!(times.scans, 39);
        assert_eq!(listed(&times.gaps), "30.1 s at 0:01, 1.2 s at 0:32");
        assert_eq!(listed(&[]), "none");
        let many = [Gap { from: 3_661.0, seconds: 2.0 }; 6];
        assert!(listed(&many).starts_with("6, the first of them 2.0 s at 1:01:01, 2.0 s"));
    }
}
