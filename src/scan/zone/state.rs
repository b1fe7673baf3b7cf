//! [`ZoneState`]: whether a zone is clear, and why not.

use std::fmt;

use super::super::Ray;
use crate::protocol::{Measurement, Window};

/// Whether a scan shows a [`Zone`](super::Zone) clear, and why not.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ZoneState {
    /// The zone is clear.
    Clear,
    /// There is an obstacle: its nearest ray.
    Obstacle(Ray),
    /// The scan's window leaves out a part of the zone.
    #[non_exhaustive]
    Uncovered {
        /// Direction of this part in radians, counter-clockwise from the front.
        angle: f32,
        /// Window that covers the zone: [`Zone::window`](super::Zone::window).
        window: Window,
    },
    /// Too many consecutive rays are unknown.
    #[non_exhaustive]
    Blind {
        /// First ray of the longest gap.
        first: Ray,
        /// Last ray of this gap.
        last: Ray,
        /// Number of unknown rays in this gap.
        rays: usize,
    },
}

impl ZoneState {
    /// Returns true for [`ZoneState::Clear`].
    pub fn is_clear(&self) -> bool {
        matches!(self, Self::Clear)
    }
}

impl fmt::Display for ZoneState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Clear => f.write_str("clear"),
            Self::Obstacle(ray) => {
                let degrees = ray.angle.to_degrees();
                match ray.measurement {
                    Measurement::Error(code) => write!(f, "obstacle at {degrees:.1}°: {code}"),
                    _ => write!(f, "obstacle at {degrees:.1}°, {:.3} m", ray.range()),
                }
            }
            Self::Uncovered { angle, window } => {
                let (angle, from, to) = (angle.to_degrees(), window.start(), window.end());
                write!(f, "no ray at {angle:.1}°: the zone needs steps {from}..={to}")
            }
            Self::Blind { first, last, rays } => {
                let (from, to) = (first.angle.to_degrees(), last.angle.to_degrees());
                write!(f, "blind from {from:.1}° to {to:.1}°, {rays} rays")
            }
        }
    }
}
