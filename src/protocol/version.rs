//! Identity of a sensor: its reply to `V`.

use std::ops::RangeInclusive;

use super::Text;

/// Reply to `V` (C-42-3320-A p. 4) or to `VV` of SCIP 2, parsed tolerantly. Fields may come in any
/// order, with or without a blank after the colon. Missing ones are empty, unknown lines kept.
///
/// As data (feature `serde`) it has its fields by name, and a
/// [range](std::ops::RangeInclusive) as `start` and `end`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Version {
    /// `VEND:`, such as `Hokuyo Automatic Co.,Ltd.`.
    pub vendor: Text,
    /// `PROD:`, such as `SOKUIKI Sensor URG-04LX`.
    pub product: Text,
    /// `FIRM:`, such as `3.3.00,08/04/16(20-4095[mm],240[deg],44-725[step],600[rpm])`.
    pub firmware: Text,
    /// `PROT:`. Sensors that speak SCIP 1.1 have `SCIP 1.0` here.
    pub protocol: Text,
    /// `SERI:`, such as `H0713090`. No other field differs between sensors of one model and firmware.
    pub serial_number: Text,
    /// `STAT:`, which firmware 3 and later adds to the five lines of the protocol text.
    pub status: Option<Text>,
    /// Lines with an unknown name or without a name, unchanged.
    pub other: Vec<Text>,
    /// Contents of the bracket in the firmware line, if it has one.
    pub specification: Option<Specification>,
}

impl Version {
    /// Parses lines of a name, a colon and a value. Never fails: see [`Version`].
    pub(super) fn from_lines<'a>(lines: impl IntoIterator<Item = &'a [u8]>) -> Self {
        let mut version = Self::default();
        for line in lines {
            let (name, value) = match line.iter().position(|&byte| byte == b':') {
                Some(colon) => (
                    line.get(..colon).unwrap_or_default(),
                    line.get(colon + 1..).unwrap_or_default(),
                ),
                None => (&b""[..], line),
            };
            let text = Text::from(value.trim_ascii());
            match name {
                b"VEND" => version.vendor = text,
                b"PROD" => version.product = text,
                b"FIRM" => {
                    version.specification = Specification::find(value);
                    version.firmware = text;
                }
                b"PROT" => version.protocol = text,
                b"SERI" => version.serial_number = text,
                b"STAT" => version.status = Some(text),
                _ => version.other.push(line.into()),
            }
        }
        version
    }
}

/// Abilities of a sensor, from the bracket of its firmware line. Each part may be missing.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Specification {
    /// `20-4095[mm]`: measurable distances in millimetres.
    pub range: Option<RangeInclusive<u16>>,
    /// `240[deg]`: aperture in degrees.
    pub aperture: Option<u16>,
    /// `44-725[step]`: steps that the sensor measures.
    pub steps: Option<RangeInclusive<u16>>,
    /// `600[rpm]`: speed of the motor in revolutions per minute.
    pub motor_speed: Option<u16>,
}

impl Specification {
    /// Parses the parts of a firmware line, such as `240[deg]`, if there are any.
    fn find(firmware: &[u8]) -> Option<Self> {
        let mut found = Self::default();
        for part in firmware.split(|byte| matches!(byte, b'(' | b',' | b')')) {
            let Some((value, unit)) = std::str::from_utf8(part)
                .ok()
                .and_then(|part| part.trim().strip_suffix(']'))
                .and_then(|part| part.split_once('['))
            else {
                continue;
            };
            match unit {
                "mm" => found.range = range(value),
                "deg" => found.aperture = value.parse().ok(),
                "step" => found.steps = range(value),
                "rpm" => found.motor_speed = value.parse().ok().filter(|&speed| speed > 0),
                _ => {}
            }
        }
        (found != Self::default()).then_some(found)
    }
}

fn range(text: &str) -> Option<RangeInclusive<u16>> {
    let (from, to) = text.split_once('-')?;
    let (from, to) = (from.parse().ok()?, to.parse().ok()?);
    (from <= to).then_some(from..=to)
}
