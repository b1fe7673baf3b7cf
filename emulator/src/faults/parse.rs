//! Faults as text in one line, as in `urg emulate --faults SPEC`.

use std::str::FromStr;
use std::time::Duration;

use super::{Fault, Faults};

/// Names of all faults that can be written down.
const NAMES: &str = "late, lost, command-lost, damaged, doubled, merged, noise, pause, reset, \
                     hang-up, ignored, wrong-sum, clock-jump (each =PROBABILITY) and seed=NUMBER";
const DEFAULT_LONGEST: Duration = Duration::from_secs(1);
const DEFAULT_NOISE_BYTES: usize = 64;
/// More bytes than any burst of noise on a line.
const MAX_NOISE_BYTES: usize = 65_536;

/// Parse error of [`Faults`]: which part is wrong, what was expected there and what was
/// found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("invalid fault `{part}`: {reason}")]
pub struct FaultsError {
    part: String,
    reason: String,
}

impl FromStr for Faults {
    type Err = FaultsError;

    /// Parses faults such as `late=0.01:3s,lost=0.005,seed=7`.
    ///
    /// Each name is followed by the probability, 0 to 1, that a reply has the fault:
    /// `late` (by up to 1 s, or by the time after the colon, `250ms` or `3s`), `lost`,
    /// `command-lost`, `damaged`, `doubled`, `merged`, `noise` (up to 64 bytes, or the
    /// number after the colon), `pause` (up to 1 s, or the time after the colon),
    /// `reset`, `hang-up`; and of SCIP 2 `ignored`, `wrong-sum` and `clock-jump` (by up to 1 s, or
    /// the time after the colon). An empty text means no faults.
    fn from_str(text: &str) -> Result<Self, FaultsError> {
        let mut parts = text.split(',').map(str::trim).filter(|part| !part.is_empty());
        parts.try_fold(Self::none(), |faults, part| {
            add(faults, part).map_err(|reason| FaultsError { part: part.to_owned(), reason })
        })
    }
}

/// Adds the fault that `part` describes, or explains why it is invalid.
fn add(faults: Faults, part: &str) -> Result<Faults, String> {
    let (name, value) = part.split_once('=').unwrap_or((part, ""));
    if name == "seed" {
        let seed = value.parse().map_err(|_| format!("expected seed=NUMBER, found `{value}`"))?;
        return Ok(faults.seed(seed));
    }
    let (probability, detail) = match value.split_once(':') {
        Some((probability, detail)) => (probability, Some(detail)),
        None => (value, None),
    };
    match name {
        "late" => Ok(faults.late(chance(probability)?, longest(detail)?)),
        "pause" => Ok(faults.paused(chance(probability)?, longest(detail)?)),
        "clock-jump" => Ok(faults.clock_jump(chance(probability)?, longest(detail)?)),
        "noise" => Ok(faults.noise(chance(probability)?, length(detail)?)),
        "reset" => Ok(faults.reset(chance_alone(name, probability, detail)?)),
        "hang-up" => Ok(faults.hung_up(chance_alone(name, probability, detail)?)),
        _ => {
            let fault = match name {
                "lost" => Fault::Lost,
                "command-lost" => Fault::CommandLost,
                "damaged" => Fault::Damaged,
                "doubled" => Fault::Doubled,
                "merged" => Fault::Merged,
                "ignored" => Fault::Ignored,
                "wrong-sum" => Fault::WrongSum,
                _ => return Err(format!("unknown name `{name}`, expected {NAMES}")),
            };
            Ok(faults.rate(chance_alone(name, probability, detail)?, fault))
        }
    }
}

/// Parses a probability.
fn chance(text: &str) -> Result<f64, String> {
    let probability = text.parse().ok().filter(|probability| (0.0..=1.0).contains(probability));
    probability.ok_or_else(|| match text {
        "" => "expected a probability from 0 to 1 after `=`".to_owned(),
        _ => format!("expected a probability from 0 to 1, found {text}"),
    })
}

/// Parses the probability of a fault that takes no limit after a colon.
fn chance_alone(name: &str, probability: &str, detail: Option<&str>) -> Result<f64, String> {
    match detail {
        Some(detail) => Err(format!("{name} takes no limit, found `:{detail}`")),
        None => chance(probability),
    }
}

fn longest(detail: Option<&str>) -> Result<Duration, String> {
    let Some(text) = detail else { return Ok(DEFAULT_LONGEST) };
    duration(text)
        .ok_or_else(|| format!("expected a time such as 250ms or 3s after `:`, found `{text}`"))
}

fn length(detail: Option<&str>) -> Result<usize, String> {
    let Some(text) = detail else { return Ok(DEFAULT_NOISE_BYTES) };
    let length = text.parse().ok().filter(|length| *length <= MAX_NOISE_BYTES);
    length.ok_or_else(|| {
        format!("expected a number of bytes up to {MAX_NOISE_BYTES} after `:`, found `{text}`")
    })
}

fn duration(text: &str) -> Option<Duration> {
    let (number, unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 0.001),
        None => (text.strip_suffix('s')?, 1.0),
    };
    Duration::try_from_secs_f64(number.parse::<f64>().ok()? * unit).ok()
}
