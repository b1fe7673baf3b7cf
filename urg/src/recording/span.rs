//! `--range`: part of a recording to read.

use std::fmt;
use std::ops::Bound;
use std::time::Duration;

use clap::Args;

use crate::args::clock_time;

#[derive(Debug, Clone, Copy, Default, Args)]
#[command(next_help_heading = "Recording")]
pub(crate) struct RangeArgs {
    /// Part of a recording, as times since its first scan: 1m30s..2m, 90.., or
    /// 1:30..2:00, the way `urg info` writes them
    #[arg(long, value_name = "FROM..TO", value_parser = time_span, allow_hyphen_values = true)]
    pub(crate) range: Option<TimeSpan>,
}

/// Which scans of a recording to read.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Recording")]
pub(crate) struct TopicArgs {
    /// Topic of the scans in a recording of several sensors, such as /front/scan [default: /scan]
    #[arg(long)]
    pub(crate) topic: Option<String>,
}

pub(crate) type Bounds = (Bound<Duration>, Bound<Duration>);

impl RangeArgs {
    /// Limits of the part. Default: the whole recording.
    pub(crate) fn bounds(self) -> Bounds {
        self.range.map_or((Bound::Unbounded, Bound::Unbounded), TimeSpan::bounds)
    }
}

/// Part of a recording, in times since its first scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct TimeSpan {
    from: Duration,
    /// Exclusive; `None` means to the end of the recording.
    to: Option<Duration>,
}

impl TimeSpan {
    pub(crate) fn bounds(self) -> Bounds {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_may_lack_an_end() {
        let span = |from, to: Option<u64>| {
            let (from, to) = (Duration::from_millis(from), to.map(Duration::from_millis));
            Ok(TimeSpan { from, to })
        };
        assert_eq!(time_span("1m30s..2m"), span(90_000, Some(120_000)));
        assert_eq!(time_span("1:30..2:00.5"), span(90_000, Some(120_500)));
        assert_eq!(time_span("1:00:00.."), span(3_600_000, None));
        assert_eq!(time_span("..500ms"), span(0, Some(500)));
        assert_eq!(time_span("0s..1s"), span(0, Some(1000)));
        assert_eq!(time_span("2..5"), span(2_000, Some(5_000)));
        for text in ["", "10s", "2m..1m", "1s..1s", "-1s..5s", "a..b", "1:..2:x"] {
            assert!(time_span(text).is_err(), "{text}");
        }
        assert_eq!(time_span("90s..2m").unwrap().to_string(), "90s..120s");
    }
}
