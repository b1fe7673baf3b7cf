//! [`Mount`]: where the sensor is in its world, and which way its beams go.

use tokio_scip::scan::Pose;

use super::surface::Vector;

/// Place of the sensor, and the directions that it calls front and left.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mount {
    /// In millimetres.
    pub(super) place: Vector,
    front: Vector,
    left: Vector,
}

impl Mount {
    pub(super) fn at(pose: Pose) -> Self {
        let (sine, cosine) = pose.heading.sin_cos();
        let left = if pose.upside_down { (sine, -cosine) } else { (-sine, cosine) };
        Self { place: (pose.x * 1000.0, pose.y * 1000.0), front: (cosine, sine), left }
    }

    /// Returns the direction in the world of a beam, whose direction is in the sensor's frame.
    pub(super) fn direction(&self, (ahead, beside): Vector) -> Vector {
        let Self { front, left, .. } = self;
        (ahead * front.0 + beside * left.0, ahead * front.1 + beside * left.1)
    }
}
