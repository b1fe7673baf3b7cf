//! Faults as text in one line, as in `urg emulate --faults SPEC`.

use std::str::FromStr;
use std::time::Duration;

use super::{Fault, Faults};

/// Names of all faults that can be written down.
const NAMES: &str = "late, lost, command-lost, damaged, doubled, merged, noise, pause, reset, \
                     hang-up, ignored, wrong-sum, clock-jump (each =PROBABILITY) and seed=NUMBER";
const DEFAULT_LONGEST: Duration = Duration::from_secs(1);
const DEFAULT_NOISE_BYTES: usize = 64;
/// A full scan has 1,576 bytes. In a shorter reply, a position past the end means the end.
const LAST_POSITION: usize = 1599;
/// More bytes than any burst of noise on a line.
const MAX_NOISE_BYTES: usize = 65_536;

/// Parse error of [`Faults`]: which part is wrong, what was expected there and what was found.
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
    let mut parts = value.splitn(2, ':');
    let (probability, detail) = (parts.next().unwrap_or_default(), parts.next());
    let fault = match name {
        "late" => Fault::Late(longest(detail)?),
        "pause" => Fault::Pause(63, longest(detail)?),
        "clock-jump" => {
            let milliseconds = longest(detail)?.as_millis();
            Fault::ClockJump(milliseconds.try_into().unwrap_or(i64::MAX))
        }
        "noise" => Fault::Noise(length(detail)?),
        _ => {
            let fault = match name {
                "lost" => Fault::Lost,
                "command-lost" => Fault::CommandLost,
                "damaged" => Fault::Damaged,
                "doubled" => Fault::Doubled,
                "merged" => Fault::Merged,
                "reset" => Fault::Reset(LAST_POSITION),
                "hang-up" => Fault::HangUp(LAST_POSITION),
                "ignored" => Fault::Ignored,
                "wrong-sum" => Fault::WrongSum,
                _ => return Err(format!("unknown name `{name}`, expected {NAMES}")),
            };
            if let Some(detail) = detail {
                return Err(format!("{name} takes no limit, found `:{detail}`"));
            }
            fault
        }
    };
    let chance = probability.parse().ok().filter(|chance| (0.0..=1.0).contains(chance));
    let chance = chance.ok_or_else(|| match probability {
        "" => "expected a probability from 0 to 1 after `=`".to_owned(),
        _ => format!("expected a probability from 0 to 1, found {probability}"),
    })?;
    Ok(faults.up_to(chance, fault))
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
