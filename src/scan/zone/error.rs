//! [`ZoneError`]: why values make no zone.

use crate::Error;

/// Error for values that make no [`Zone`](super::Zone).
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ZoneError {
    /// A range is empty, negative or not finite.
    #[error("invalid range from {near} to {far} m: expected 0 or more, the smaller one first")]
    Range {
        /// Smaller distance in metres.
        near: f64,
        /// Larger distance in metres.
        far: f64,
    },
    /// A sector is reversed, has an angle that is not a number, or leaves the sensor's view.
    #[error(
        "invalid sector from {from} to {to} degrees: expected -135 to 135, the smaller one first"
    )]
    Sector {
        /// Smaller angle in degrees.
        from: f64,
        /// Larger angle in degrees.
        to: f64,
    },
    /// A coordinate is not a number, or beyond 1,000 m.
    #[error("invalid vertex {index} at {x}, {y}: expected -1000 to 1000 m")]
    Vertex {
        /// Index of the vertex, from 0.
        index: usize,
        /// Metres ahead.
        x: f64,
        /// Metres to the left.
        y: f64,
    },
    /// A polygon has fewer than 3 different vertices, or more than 1,000.
    #[error("invalid polygon: expected 3 to 1000 vertices, found {found}")]
    Vertices {
        /// Number of vertices, without repeated ones.
        found: usize,
    },
    /// Two edges of a polygon cross, touch or cover each other.
    #[error(
        "invalid polygon: the edge that starts at {x}, {y} touches another one: order the vertices along the outline"
    )]
    Crossing {
        /// Metres ahead.
        x: f64,
        /// Metres to the left.
        y: f64,
    },
    /// The zone lies on all sides of the sensor, which sees 270 degrees of them.
    #[error(
        "the zone surrounds the sensor, which sees -135 to 135 degrees: leave out what is behind it"
    )]
    SensorInside,
    /// The zone has directions that no step has.
    #[error("the zone reaches {:.1}°: the sensor sees -135 to 135 degrees", angle.to_degrees())]
    BeyondView {
        /// First of these directions, in radians.
        angle: f64,
    },
    /// The zone ends where no point can be measured behind it.
    #[error("the zone ends at {far:.3} m at {:.1}°: the sensor measures up to 4.094 m", angle.to_degrees())]
    BeyondRange {
        /// Direction of this end in radians.
        angle: f64,
        /// Distance to its end in metres.
        far: f64,
    },
    /// The zone is so narrow that it lies between two rays, or nearer than 20 mm.
    #[error("no ray crosses the zone: make it wider than 0.36 degrees and longer than 20 mm")]
    BetweenRays,
    /// An obstacle of this width can stand between two rays.
    #[error(
        "an obstacle of {width} m can stand between two rays at the far end of the zone: expected at least {least:.3} m"
    )]
    SmallestObstacle {
        /// Width in metres.
        width: f64,
        /// Smallest possible width in metres.
        least: f64,
    },
}

impl From<ZoneError> for Error {
    fn from(error: ZoneError) -> Self {
        Self::other(error)
    }
}
