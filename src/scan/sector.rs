//! [`Sector`]: an interval of directions.

use std::f64::consts::TAU;

/// Tolerance at the edges in radians: angles of scans are rounded to `f32`.
const TOLERANCE: f64 = 1e-6;

/// Directions counter-clockwise from one angle to another, edges included.
///
/// Angles that differ by whole turns are the same direction, and a sector may pass the rear:
/// 150 to -150 degrees are the 60 degrees behind the sensor, -150 to 150 degrees the 300 degrees
/// in front. Two equal angles are one direction; a whole turn or more is all of them. A
/// direction within 1 µrad of an edge is inside.
///
/// ```
/// use tokio_scip::scan::Sector;
///
/// let behind = Sector::degrees(150.0, -150.0)?;
/// assert!(behind.contains(std::f64::consts::PI) && !behind.contains(0.0));
/// # Ok::<(), tokio_scip::scan::SectorError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sector {
    /// Radians.
    from: f64,
    /// Radians from `from` to the other edge, 0..=2 pi.
    width: f64,
}

impl Sector {
    /// Creates the sector counter-clockwise from one angle to another, in radians from the
    /// front.
    ///
    /// # Errors
    ///
    /// [`SectorError`] unless both angles are finite.
    fn new(from: f64, to: f64) -> Result<Self, SectorError> {
        if !from.is_finite() || !to.is_finite() {
            return Err(SectorError { from, to });
        }
        let is_whole = to - from >= TAU;
        // Wrapped first, because the difference of two finite numbers may be infinite.
        let (from, to) = (from.rem_euclid(TAU), to.rem_euclid(TAU));
        let width = if is_whole { TAU } else { (to - from).rem_euclid(TAU) };
        Ok(Self { from, width })
    }

    /// Creates the sector counter-clockwise from one angle to another, in degrees from the
    /// front.
    ///
    /// # Errors
    ///
    /// [`SectorError`] unless both angles are finite.
    pub fn degrees(from: f64, to: f64) -> Result<Self, SectorError> {
        Self::new(from.to_radians(), to.to_radians())
    }

    /// Returns true if the direction of `angle` radians is inside. No sector contains NaN.
    pub fn contains(&self, angle: impl Into<f64>) -> bool {
        let after = (angle.into() - self.from).rem_euclid(TAU);
        after <= self.width + TOLERANCE || after >= TAU - TOLERANCE
    }
}

/// Error for angles that make no [`Sector`].
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("invalid sector from {from} to {to}: expected two finite angles")]
pub struct SectorError {
    from: f64,
    to: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks which whole degrees of a turn the sector contains.
    fn inside(from: f64, to: f64) -> Vec<i32> {
        let sector = Sector::degrees(from, to).unwrap();
        (-180..180).filter(|degrees| sector.contains(f64::from(*degrees).to_radians())).collect()
    }

    #[test]
    fn a_sector_runs_counter_clockwise_from_its_first_angle() {
        assert_eq!(inside(-2.0, 2.0), [-2, -1, 0, 1, 2]);
        assert_eq!(inside(178.0, -178.0), [-180, -179, -178, 178, 179]);
        assert_eq!(inside(358.0, 362.0), [-2, -1, 0, 1, 2]);
        assert_eq!(inside(5.0, 5.0), [5]);
        assert_eq!(inside(2.0, -2.0).len(), 357);
        assert_eq!(inside(-180.0, 180.0).len(), 360);
        assert_eq!(inside(10.0, 1000.0).len(), 360);
        assert!(Sector::new(f64::MAX, -f64::MAX).unwrap().width <= TAU);
    }

    #[test]
    fn a_rounded_angle_is_inside_at_both_edges() {
        for degrees in -135..135 {
            let angle = f64::from(degrees).to_radians();
            let sectors = [Sector::new(angle, angle + 0.1), Sector::new(angle - 0.1, angle)];
            for sector in sectors {
                assert!(sector.unwrap().contains(angle as f32), "{degrees}");
                assert!(sector.unwrap().contains((angle as f32).next_up()), "{degrees}");
                assert!(sector.unwrap().contains((angle as f32).next_down()), "{degrees}");
            }
        }
    }

    #[test]
    fn angles_that_are_no_numbers_are_refused() {
        for (from, to) in [(f64::NAN, 0.0), (0.0, f64::NAN), (f64::NEG_INFINITY, 0.0)] {
            let text = format!("invalid sector from {from} to {to}: expected two finite angles");
            assert_eq!(Sector::new(from, to).unwrap_err().to_string(), text);
        }
        for angle in [f64::NAN, f64::INFINITY] {
            assert!(!Sector::degrees(-180.0, 180.0).unwrap().contains(angle), "{angle}");
        }
    }
}
