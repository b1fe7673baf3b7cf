//! What is in a recording, for who asks: from when to when, how many scans, and
//! where there are none.

use std::time::{Duration, SystemTime};

use serde_json::{Value, json};
use tokio_scip::recording::{Entry, Recording, RecordingError};

use crate::format::utc::Utc;

/// A row of what there is to tell: its name, and it as data and as text.
pub(crate) type Row = (&'static str, Value, String);

/// So much longer than a period is a gap.
const GAP: Duration = Duration::from_secs(1);
/// How many gaps are told one by one.
const TOLD: usize = 5;

/// Reads all of it; blocks for as long as that takes.
pub(crate) fn rows(mut recording: Recording) -> Result<Vec<Row>, RecordingError> {
    let window = recording.window();
    let rate = recording.rate();
    let longest = rate.and_then(|rate| rate.period()).unwrap_or_default() + GAP;
    let mut times = Times::default();
    let (mut scans, mut replies) = (0_u64, 0_u64);
    for record in recording.by_ref() {
        let record = record?;
        match record.entry {
            Entry::Scan(_) => {
                scans += 1;
                times.scan(record.at, longest);
            }
            Entry::Reply(_) => replies += 1,
            _ => {}
        }
    }
    let whole = !recording.is_truncated();
    let took = times.last - times.first;
    let seconds = took.as_secs_f64();
    let began = Utc::from(times.began);
    todo!()
}
