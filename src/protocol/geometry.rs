//! [`Geometry`]: the directions and distances that a sensor measures, and what its values mean.

use std::ops::RangeInclusive;

use super::{ErrorCode, Measurement};

/// Directions and distances that a sensor measures, and the meaning of its values.
///
/// Each [`Scan`](crate::Scan) carries the geometry of its sensor. Ask it in place of a constant:
/// code that does so works with any model.
///
/// As data (feature `serde`) it has its fields by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Geometry {
    steps_per_revolution: u16,
    first_step: u16,
    last_step: u16,
    front_step: u16,
    min_distance: u32,
    max_distance: u32,
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
    };

    /// Number of steps in a full revolution of the motor.
    pub const fn steps_per_revolution(&self) -> u16 {
        self.steps_per_revolution
    }

    /// Steps that the sensor measures. A sensor may answer for steps outside of them, but never
    /// with a distance.
    pub const fn steps(&self) -> RangeInclusive<u16> {
        self.first_step..=self.last_step
    }

    /// Measurable distances in millimetres.
    pub const fn distances(&self) -> RangeInclusive<u32> {
        self.min_distance..=self.max_distance
    }

    /// Direction of a step in degrees, counter-clockwise from the front.
    pub fn degrees(&self, step: u16) -> f32 {
        self.angle(step.into()).to_degrees() as f32
    }

    /// Interprets a value that the sensor sent.
    pub const fn measurement(&self, value: u32) -> Measurement {
        match ErrorCode::from_value(value) {
            Some(code) => Measurement::Error(code),
            None if value > self.max_distance => Measurement::Saturated,
            None => Measurement::Distance(value),
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

    /// Number of a (possibly half) step in a direction in degrees.
    pub(crate) fn step_at(&self, degrees: f64) -> f64 {
        degrees / 360.0 * f64::from(self.steps_per_revolution) + f64::from(self.front_step)
    }
}
