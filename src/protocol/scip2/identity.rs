//! What a sensor says about itself: its replies to `VV`, `PP` and `II`.

use std::fmt::Debug;
use std::ops::RangeInclusive;
use std::str::FromStr;

use super::lines::{number, pair, quoted};
use crate::protocol::{Codes, Geometry, MalformedError, Text, Version};

/// Parses the data of a reply to `VV`.
pub(super) fn version<'a>(data: &'a [u8]) -> Result<Version, MalformedError> {
    let lines: Vec<&[u8]> = data.split(|&byte| byte == b'\n').collect();
    // Some URG-04LX send one character more, on its own line, and a wrong sum of the serial number.
    let (lines, serial) = match &lines[..] {
        [lines @ .., serial, [_]] if serial.starts_with(b"SERI:") => (lines, Some(serial)),
        lines => (lines, None),
    };
    for (line, bytes) in lines.iter().enumerate() {
        pair((line, bytes), false)?;
    }
    // Without semicolon and sum, which may be a semicolon too: it is of a UST's vendor.
    let without_sum = |line: &&'a [u8]| match *line {
        [pair @ .., b';', _] | [pair @ .., b';'] => pair,
        line => line,
    };
    let version = Version::from_lines(lines.iter().chain(serial).map(without_sum));
    for (key, value) in [
        ("VEND", &version.vendor),
        ("PROD", &version.product),
        ("FIRM", &version.firmware),
        ("PROT", &version.protocol),
        ("SERI", &version.serial_number),
    ] {
        if value.is_empty() || !value.is_printable() {
            return Err(MalformedError::in_scip2(
                None,
                format!("{key}:text"),
                quoted(value.as_bytes()),
            ));
        }
    }
    Ok(version)
}

/// What a sensor measures: its reply to `PP` (p. 21).
///
/// A step is `360 / steps_per_revolution` degrees; count it from `front`.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Parameters {
    /// `MODL`, such as `URG-04LX(Hokuyo Automatic Co.,Ltd.)`.
    pub model: Text,
    /// `DMIN` and `DMAX`: measurable distances in millimetres.
    pub distances: RangeInclusive<u32>,
    /// `ARES`: steps in a revolution.
    pub steps_per_revolution: u16,
    /// `AMIN` and `AMAX`: steps that the sensor measures.
    pub steps: RangeInclusive<u16>,
    /// `AFRT`: step straight ahead.
    pub front: u16,
    /// `SCAN`: speed of the motor in revolutions per minute.
    pub motor_speed: u16,
    /// Keys and values that are none of these.
    pub other: Vec<(Text, Text)>,
}

impl Parameters {
    /// Geometry of the sensor.
    pub fn geometry(&self) -> Geometry {
        // A user can change the fields: without the limits, times would be infinite, and windows
        // would end before their start.
        Geometry {
            steps_per_revolution: self.steps_per_revolution.max(1),
            first_step: *self.steps.start(),
            last_step: *self.steps.start().max(self.steps.end()),
            front_step: self.front,
            min_distance: *self.distances.start(),
            max_distance: *self.distances.end(),
            motor_speed: self.motor_speed,
            codes: Codes::of(self.model.as_bytes()),
        }
    }

    /// Returns true for a model that knows `GE` and `ME`: a UTM or UST. No command tells it, and a
    /// URG-04LX that is asked for intensities can lock up until it is switched off.
    pub fn has_intensities(&self) -> bool {
        matches!(Codes::of(self.model.as_bytes()), Codes::Utm | Codes::Ethernet)
    }

    /// Lines of the reply, each a key and a value.
    pub fn pairs(&self) -> impl Iterator<Item = (Text, Text)> + '_ {
        let number = |key: &str, number: u32| (key.into(), number.to_string().into());
        let own = [
            ("MODL".into(), self.model.clone()),
            number("DMIN", *self.distances.start()),
            number("DMAX", *self.distances.end()),
            number("ARES", self.steps_per_revolution.into()),
            number("AMIN", (*self.steps.start()).into()),
            number("AMAX", (*self.steps.end()).into()),
            number("AFRT", self.front.into()),
            number("SCAN", self.motor_speed.into()),
        ];
        own.into_iter().chain(self.other.iter().cloned())
    }

    /// Reads what [`pairs`](Self::pairs) returns, in any order.
    ///
    /// # Errors
    ///
    /// [`MalformedError`] if a number is missing, or is none that a sensor can have.
    ///
    /// ```
    /// use tokio_scip::protocol::scip2::Parameters;
    ///
    /// let text = "MODL:UST-10LX DMIN:20 DMAX:30000 ARES:1440 AMIN:0 AMAX:1080 AFRT:540 SCAN:2400";
    /// let pairs = text.split(' ').filter_map(|pair| pair.split_once(':'));
    /// let geometry = Parameters::from_pairs(pairs)?.geometry();
    /// assert_eq!(geometry.degrees(1080), 135.0);
    /// # Ok::<(), tokio_scip::protocol::MalformedError>(())
    /// ```
    pub fn from_pairs<'a, T: AsRef<[u8]> + ?Sized + 'a>(
        pairs: impl IntoIterator<Item = (&'a T, &'a T)>,
    ) -> Result<Self, MalformedError> {
        Self::from_results(pairs.into_iter().map(|(key, value)| Ok((key.as_ref(), value.as_ref()))))
    }

    pub(super) fn parse(data: &[u8]) -> Result<Self, MalformedError> {
        let lines = data.split(|&byte| byte == b'\n').enumerate();
        Self::from_results(lines.map(|line| pair(line, false)))
    }

    fn from_results<'a>(
        pairs: impl Iterator<Item = Result<(&'a [u8], &'a [u8]), MalformedError>>,
    ) -> Result<Self, MalformedError> {
        let (mut model, mut other) = (Text::default(), Vec::new());
        let mut numbers = [&b""[..]; 7];
        let [d_min, d_max, resolution, first, last, front, speed] = &mut numbers;
        for pair in pairs {
            let (key, value) = pair?;
            match key {
                b"MODL" => model = value.into(),
                b"DMIN" => *d_min = value,
                b"DMAX" => *d_max = value,
                b"ARES" => *resolution = value,
                b"AMIN" => *first = value,
                b"AMAX" => *last = value,
                b"AFRT" => *front = value,
                b"SCAN" => *speed = value,
                _ => other.push((key.into(), value.into())),
            }
        }
        let [d_min, d_max, resolution, first, last, front, speed] = numbers;
        let all = 0..=9999;
        let first = whole("AMIN", first, all.clone())?;
        let d_min = whole("DMIN", d_min, 0..=u32::MAX)?;
        Ok(Self {
            model,
            distances: d_min..=whole("DMAX", d_max, d_min..=u32::MAX)?,
            steps_per_revolution: whole("ARES", resolution, 1..=u16::MAX)?,
            steps: first..=whole("AMAX", last, first..=9999)?,
            front: whole("AFRT", front, all)?,
            motor_speed: whole("SCAN", speed, 1..=u16::MAX)?,
            other,
        })
    }
}

/// Parses a whole number in a range. Not found, it is empty.
fn whole<N: FromStr + PartialOrd + Debug>(
    key: &str,
    found: &[u8],
    valid: RangeInclusive<N>,
) -> Result<N, MalformedError> {
    let number = std::str::from_utf8(found).ok().and_then(|text| text.parse().ok());
    number
        .filter(|number| valid.contains(number))
        .ok_or_else(|| MalformedError::in_scip2(None, format!("{key}:{valid:?}"), quoted(found)))
}

/// State of a sensor: its reply to `II` (p. 22). Fields that a sensor leaves out are empty.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct State {
    /// `MODL`, as in [`Parameters`].
    pub model: Text,
    /// `LASR`: whether the laser is on.
    pub laser_on: Option<bool>,
    /// `SCSP`: speed of the motor, such as `Initial(600[rpm])<-Default setting by user`.
    pub motor_speed: Text,
    /// `MESM`: what it is doing, such as `IDLE`. A UST says `Measuring by Sensitive Mode` when idle.
    pub measuring: Text,
    /// `SBPS`: baud rate, such as `Ethernet 100 [Mbps]`.
    pub baud_rate: Text,
    /// `TIME`: its clock in ms. USB models send it in hexadecimal, others in four characters.
    pub clock: Option<u32>,
    /// `STAT`: whether it works, in words that differ by model, such as `Sensor works well.`.
    pub diagnosis: Text,
    /// Keys and values that are none of these.
    pub other: Vec<(Text, Text)>,
}

impl State {
    pub(super) fn parse(data: &[u8]) -> Result<Self, MalformedError> {
        let mut state = Self::default();
        for line in data.split(|&byte| byte == b'\n').enumerate() {
            let (key, value) = pair(line, true)?;
            match key {
                b"MODL" => state.model = value.into(),
                b"LASR" if value == b"ON" => state.laser_on = Some(true),
                b"LASR" if value == b"OFF" => state.laser_on = Some(false),
                b"SCSP" => state.motor_speed = value.into(),
                b"MESM" => state.measuring = value.into(),
                b"SBPS" => state.baud_rate = value.into(),
                b"TIME" if clock(value).is_some() => state.clock = clock(value),
                b"STAT" => state.diagnosis = value.into(),
                _ => state.other.push((key.into(), value.into())),
            }
        }
        Ok(state)
    }
}

fn clock(value: &[u8]) -> Option<u32> {
    match value {
        [_, _, _, _] => u32::try_from(number(value)).ok(),
        _ => u32::from_str_radix(std::str::from_utf8(value).ok()?, 16).ok(),
    }
}
