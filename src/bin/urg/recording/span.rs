//! `--range`: the part of a recording that is read.

use std::fmt;
#[cfg(feature = "mcap")]
use std::ops::Bound;
use std::time::Duration;

use clap::Args;
use jiff::SignedDuration;

use super::AVAILABLE;

/// The part of a recording that is read.
#[derive(Debug, Clone, Copy, Default, Args)]
#[command(next_help_heading = "Recording")]
pub(crate) struct RangeArgs {
    /// Part of a recording, as times since its first scan: 1m30s..2m, 90s.., or
    /// 1:30..2:00 as `urg info` writes them
    #[arg(long, value_name = "FROM..TO", value_parser = time_span, hide = !AVAILABLE)]
    pub(crate) range: Option<TimeSpan>,
}

/// A part of a recording, in times since its first scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct TimeSpan {
    from: Duration,
    /// Not part of it; `None` for the end of the recording.
    to: Option<Duration>,
}

impl TimeSpan {
    #[cfg(feature = "mcap")]
    pub(crate) fn bounds(self) -> (Bound<Duration>, Bound<Duration>) {
        (Bound::Included(self.from), self.to.map_or(Bound::Unbounded, Bound::Excluded))
    }
}

impl fmt::Display for TimeSpan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}s..", self.from.as_secs_f64())?;
        self.to.map_or(Ok(()), |to| write!(f, "{}s", to.as_secs_f64()))
    }
}

/// Parses `1m30s..2m`, `90s..`, `..2m` or `1:30..2:00`.
fn time_span(text: &str) -> Result<TimeSpan, &'static str> {
    const EXPECTED: &str = "expected two times since the first scan, the earlier one first, such \
                            as 1m30s..2m, 90s.., or 1:30..2:00";
    let (from, to) = text.split_once("..").ok_or(EXPECTED)?;
    let bound = |text: &str| match text {
        "" => Ok(None),
        text => clock_time(text).map(Some).ok_or(EXPECTED),
    };
    let (from, to) = (bound(from)?.unwrap_or_default(), bound(to)?);
    match to {
        Some(to) if to <= from => Err(EXPECTED),
        to => Ok(TimeSpan { from, to }),
    }
}

/// Parses `90s`, `1m 30s`, `0s`, `1:30` or `1:02:03`.
fn clock_time(text: &str) -> Option<Duration> {
    if !text.contains(':') {
        return text.parse::<SignedDuration>().ok()?.try_into().ok();
    }
    let parts = text.split(':').map(|part| part.parse::<f64>().ok().filter(|n| *n >= 0.0));
    let seconds = parts.into_iter().try_fold(0.0, |sum, part| Some(sum * 60.0 + part?))?;
    Duration::try_from_secs_f64(seconds).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_a_recording_has_a_beginning_and_maybe_an_end() {
        let span = |from, to: Option<u64>| {
            let (from, to) = (Duration::from_millis(from), to.map(Duration::from_millis));
            Ok(TimeSpan { from, to })
        };
        assert_eq!(time_span("1m30s..2m"), span(90_000, Some(120_000)));
        assert_eq!(time_span("1:30..2:00.5"), span(90_000, Some(120_500)));
        assert_eq!(time_span("1:00:00.."), span(3_600_000, None));
        assert_eq!(time_span("..500ms"), span(0, Some(500)));
        assert_eq!(time_span("0s..1s"), span(0, Some(1000)));
        for text in ["", "10s", "10..20", "2m..1m", "1s..1s", "-1s..5s", "a..b", "1:..2:x"] {
            assert!(time_span(text).is_err(), "{text}");
        }
        assert_eq!(time_span("90s..2m").unwrap().to_string(), "90s..120s");
    }
}
