//! Faults written down in one line, as for `urg emulate --faults SPEC`.

use std::str::FromStr;
use std::time::Duration;

use super::faults::{Fault, Faults};

/// A text that does not describe faults.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{part:?} is no fault: write NAME=PROBABILITY, separated by commas, with the names late, lost, command-lost, damaged, doubled, merged, noise, pause, reset, hang-up, and seed=NUMBER; late and pause take a longest time (late=0.01:3s), noise a longest length (noise=0.01:64)"
)]
pub struct InvalidFaults {
    part: String,
}

impl FromStr for Faults {
    type Err = InvalidFaults;

    /// Reads faults such as `late=0.01:3s,lost=0.005,seed=7`.
    ///
    /// Each name is followed by the probability, 0 to 1, that a reply has the
    /// fault: `late` (by up to 1 s, or the time after the colon, `250ms`, `3s`),
    /// `lost`, `command-lost`, `damaged`, `doubled`, `merged`, `noise` (up to 64
    /// bytes, or the number after the colon), `pause` (up to 1 s, or the time),
    /// `reset`, `hang-up`. An empty text is no faults.
    fn from_str(text: &str) -> Result<Self, InvalidFaults> {
        let parts = text.split(',').map(str::trim).filter(|part| !part.is_empty());
        parts.into_iter().try_fold(Self::none(), |faults, part| {
            add(faults, part).ok_or_else(|| InvalidFaults { part: part.to_owned() })
        })
    }
}

fn add(faults: Faults, part: &str) -> Option<Faults> {
    let (name, value) = part.split_once('=')?;
    if name == "seed" {
        return Some(faults.seed(value.parse().ok()?));
    }
    let (probability, detail) = match value.split_once(':') {
        Some((probability, detail)) => (probability, Some(detail)),
        None => (value, None),
    };
    let probability: f64 = probability.parse().ok().filter(|p| (0.0..=1.0).contains(p))?;
    let time = || detail.map_or(Some(Duration::from_secs(1)), duration);
    let plain = |fault| detail.is_none().then_some(fault);
    match name {
        "late" => Some(faults.late(probability, time()?)),
        "pause" => Some(faults.paused(probability, time()?)),
        "noise" => Some(faults.noise(probability, detail.map_or(Some(64), |n| n.parse().ok())?)),
        "reset" => plain(faults.reset(probability)),
        "hang-up" => plain(faults.hung_up(probability)),
        "lost" => plain(faults.rate(probability, Fault::Lost)),
        "command-lost" => plain(faults.rate(probability, Fault::CommandLost)),
        "damaged" => plain(faults.rate(probability, Fault::Damaged)),
        "doubled" => plain(faults.rate(probability, Fault::Doubled)),
        "merged" => plain(faults.rate(probability, Fault::Merged)),
        _ => None,
    }
}

fn duration(text: &str) -> Option<Duration> {
    let (number, unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 0.001),
        None => (text.strip_suffix('s')?, 1.0),
    };
    Duration::try_from_secs_f64(number.parse::<f64>().ok()? * unit).ok()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_spec_reads_like_the_calls_it_stands_for() {
        let read: Faults = "late=0.01:3s, lost=0.005,noise=1:9,reset=0.1,seed=7".parse().unwrap();
        let called = Faults::none()
            .late(0.01, Duration::from_secs(3))
            .rate(0.005, Fault::Lost)
            .noise(1.0, 9)
            .reset(0.1)
            .seed(7);
        assert_eq!(read, called);
        assert_eq!("".parse(), Ok(Faults::none()));
        assert_eq!(
            "pause=1:250ms".parse(),
            Ok(Faults::none().paused(1.0, Duration::from_millis(250)))
        );
    }

    #[test]
    fn a_bad_spec_names_the_part_that_is_bad() {
        for bad in
            ["late", "late=2", "late=0.1:3", "late=0.1:-3s", "lost=0.1:3s", "lots=0.1", "seed=x"]
        {
            let error = format!("lost=0.1,{bad}").parse::<Faults>().unwrap_err();
            assert!(error.to_string().starts_with(&format!("{bad:?} is no fault")), "{error}");
        }
    }
}
