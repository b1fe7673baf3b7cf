//! [`Geometry`]: the directions and distances that a sensor measures, and what its values mean.

use std::ops::RangeInclusive;
use std::time::Duration;

use super::{Codes, ErrorCode, Measurement, Protocol, Specification};

/// Half micro-degrees in a revolution.
const HALVES: i64 = 720_000_000;

/// Directions and distances that a sensor measures, and the meaning of its values.
///
/// Each [`Scan`](crate::Scan) carries the geometry of its sensor. Ask it in place of a constant:
/// code that does so works with any model.
///
/// As data (feature `serde`) it has its fields by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Geometry {
    pub(super) steps_per_revolution: u16,
    pub(super) first_step: u16,
    pub(super) last_step: u16,
    pub(super) front_step: u16,
    pub(super) min_distance: u32,
    pub(super) max_distance: u32,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(super) motor_speed: u16,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(super) codes: Codes,
}

impl Geometry {
    /// A URG-04LX in SCIP 1.1: 1,024 steps a revolution. It measures steps 44..=725 and
    /// distances of 20..=4094 mm (C-42-3320-A p. 7).
    pub const URG_04LX: Self = Self {
        steps_per_revolution: 1024,
        first_step: 44,
        last_step: 725,
        front_step: 384,
        min_distance: 20,
        max_distance: 4094,
        motor_speed: 600,
        codes: Codes::Scip1,
    };

    /// Geometry of a sensor of SCIP 1.1: what its firmware line tells, and a URG-04LX's for the rest.
    pub(crate) fn in_scip1(told: &Specification) -> Self {
        let usual = Self::URG_04LX;
        let (least, most) = usual.distances().into_inner();
        let steps = told.steps.clone().filter(|steps| steps.end() <= usual.answered_steps().end());
        let (first_step, last_step) = steps.unwrap_or(usual.steps()).into_inner();
        // Less than 20 mm is an error code. Firmware lines have 4,095 mm, which no sensor has sent.
        let range =
            told.range.clone().map(|range| (u32::from(*range.start()), u32::from(*range.end())));
        let range = range.filter(|(from, to)| *from <= most && *to >= least);
        let (from, to) = range.unwrap_or((least, most));
        let (min_distance, max_distance) = (from.max(least), to.min(most));
        let motor_speed = told.motor_speed.unwrap_or(usual.motor_speed);
        Self { first_step, last_step, min_distance, max_distance, motor_speed, ..usual }
    }

    /// Protocol that the sensor speaks.
    pub const fn protocol(&self) -> Protocol {
        match self.codes {
            Codes::Scip1 => Protocol::Scip1,
            _ => Protocol::Scip2,
        }
    }

    /// Number of steps in a full revolution of the motor.
    pub const fn steps_per_revolution(&self) -> u16 {
        self.steps_per_revolution
    }

    /// Steps that the sensor measures. For others it may send values, but never a distance.
    pub const fn steps(&self) -> RangeInclusive<u16> {
        self.first_step..=self.last_step
    }

    /// Measurable distances in millimetres.
    pub const fn distances(&self) -> RangeInclusive<u32> {
        self.min_distance..=self.max_distance
    }

    /// Nominal time of a revolution of the motor: 100 ms for a URG-04LX.
    pub fn revolution(&self) -> Duration {
        Duration::from_secs(60) / u32::from(self.motor_speed.max(1))
    }

    /// Direction of a step in degrees, counter-clockwise from the front.
    pub fn degrees(&self, step: u16) -> f32 {
        self.angle(step.into()).to_degrees() as f32
    }

    /// Interprets a value that the sensor sent. Only a value in [`distances`](Self::distances) is a
    /// distance, and not if it is an error code of the model. In SCIP 2 the longest distance is one of a
    /// UTM, UST or UAM only: a UHG-08LX and a UXM-30LAH-EWA sent it for all that is farther.
    pub const fn measurement(&self, value: u32) -> Measurement {
        let (is_code, most) = (self.codes.meaning(value).is_some(), self.max_distance);
        let is_longest = value == most && matches!(self.codes, Codes::Urg | Codes::Unknown);
        if !is_code && (is_longest || value > most) {
            Measurement::Saturated(value)
        } else if is_code || value < self.min_distance {
            Measurement::Error(ErrorCode { value, codes: self.codes })
        } else {
            Measurement::Distance(value)
        }
    }

    /// Value of a step that was not measured: its range is `NaN`.
    pub const fn unknown_value(&self) -> u32 {
        match self.codes {
            Codes::Scip1 | Codes::Urg => 19,
            _ => 0,
        }
    }

    /// Value of a step whose object may be beyond the range: its range is `+Inf`.
    pub const fn far_value(&self) -> u32 {
        match self.codes {
            Codes::Scip1 => 16,
            Codes::Urg => 0,
            Codes::Utm => 1,
            Codes::Ethernet => 65_533,
            Codes::Uam => 65_534,
            Codes::Unknown => self.max_distance.saturating_add(1),
        }
    }

    /// Angle between two neighbouring steps in radians.
    pub(crate) fn step_angle(&self) -> f64 {
        std::f64::consts::TAU / f64::from(self.steps_per_revolution)
    }

    /// Direction of a (possibly half) step in radians.
    pub(crate) fn angle(&self, step: f64) -> f64 {
        (step - f64::from(self.front_step)) * self.step_angle()
    }

    /// Half steps from step 0 to where a revolution ends, and the sensor can send its scan: a URG at
    /// its rear, newer sensors at the end of their last step.
    pub(crate) fn end(&self) -> u32 {
        match self.codes {
            Codes::Scip1 | Codes::Urg => {
                2 * u32::from(self.front_step) + u32::from(self.steps_per_revolution)
            }
            _ => 2 * (u32::from(self.last_step) + 1),
        }
    }

    /// Steps that the sensor answers for. In SCIP 1.1 there are more than it measures.
    pub const fn answered_steps(&self) -> RangeInclusive<u16> {
        match self.codes {
            Codes::Scip1 => 0..=768,
            _ => self.steps(),
        }
    }

    /// First and last step inside an interval of micro-degrees. A step within half a micro-degree of
    /// a bound is inside, because bounds are rounded. The numbers may be steps that no sensor has,
    /// and the last one is before the first if no step is inside.
    pub(super) const fn steps_inside(&self, (from, to): (i32, i32)) -> (i64, i64) {
        let (from, to) = (2 * from as i64 - 1, 2 * to as i64 + 1);
        let (resolution, front) = (self.steps_per_revolution as i64, self.front_step as i64);
        // Rounds down: the negative of a number rounded down is its negative rounded up.
        let first = front - (-from * resolution).div_euclid(HALVES);
        (first, front + (to * resolution).div_euclid(HALVES))
    }
}
