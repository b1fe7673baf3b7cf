//! [`Pose`]: place and heading of a sensor, upside down or not, and points moved by it.

use std::f64::consts::{PI, TAU};
use std::ops::Mul;

use super::{Point, Scan};

/// Position and heading of a sensor (or vehicle) in another frame, after REP 103 of ROS.
///
/// It maps coordinates of the sensor's frame to the other frame. `a * b` applies `b` first, so
/// poses chain as transforms of tf2 and `nalgebra` do:
///
/// ```
/// use tokio_scip::scan::Pose;
///
/// // On the map, and on the vehicle.
/// let vehicle = Pose { x: 10.0, y: 5.0, heading: 90f64.to_radians(), ..Pose::default() };
/// let sensor = Pose { x: 0.2, upside_down: true, ..Pose::default() };
/// let (x, y) = (vehicle * sensor).transform(1.0, -0.5); // 1 m ahead of it, 0.5 m to its right
/// assert!((x - 9.5).abs() < 1e-9 && (y - 6.2).abs() < 1e-9); // to the left of the vehicle
/// ```
///
/// In the coordinates of a screen (x to the right, y down) directions count clockwise. So set
/// `upside_down` for a sensor on a wall that turns its top to you, and clear it for one that does not:
///
/// ```
/// use tokio_scip::scan::Pose;
///
/// // In the middle of the upper edge of a picture 3 m wide. It looks down: along y.
/// let heading = 90f64.to_radians();
/// let sensor = Pose { x: 1.5, y: 0.0, heading, upside_down: true };
/// let (x, y) = sensor.transform(1.0, 0.2); // 1 m ahead of it, 0.2 m to its left
/// assert!((x - 1.7).abs() < 1e-9 && (y - 1.0).abs() < 1e-9); // the right half of the picture
/// ```
///
/// Numbers that are not finite make results that are not finite. As data (feature `serde`) it
/// is `x`, `y`, `heading`, and `upside_down`, which may be left out.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pose {
    /// Metres ahead of the other frame's origin.
    pub x: f64,
    /// Metres to its left.
    pub y: f64,
    /// Direction of the sensor's front: radians counter-clockwise from the other frame's x axis.
    pub heading: f64,
    /// True if the sensor is turned over about its x axis (a roll of 180 degrees): left is right then.
    #[cfg_attr(feature = "serde", serde(default))]
    pub upside_down: bool,
}

impl Pose {
    /// Transforms coordinates in metres to the other frame.
    pub fn transform(&self, x: impl Into<f64>, y: impl Into<f64>) -> (f64, f64) {
        self.transformer()(x.into(), y.into())
    }

    /// Iterates over the [points](Scan::points) of a scan in the other frame. Their range, angle
    /// and offset stay as the sensor measured them.
    pub fn transform_scan<'a>(
        &self,
        scan: &'a Scan,
    ) -> impl Iterator<Item = Point> + Clone + use<'a> {
        let transform = self.transformer();
        scan.points().map(move |point| {
            let (x, y) = transform(point.x.into(), point.y.into());
            Point { x: x as f32, y: y as f32, ..point }
        })
    }

    /// Returns the pose that maps back: the pose of the other frame in this one.
    pub fn inverse(&self) -> Self {
        let heading = -self.turned(self.heading);
        let back = Self { x: 0.0, y: 0.0, heading, upside_down: self.upside_down };
        let (x, y) = back.transform(-self.x, -self.y);
        Self { x, y, heading: wrapped(heading), ..back }
    }

    /// Returns an angle of the sensor's frame counter-clockwise in the other one.
    fn turned(&self, angle: f64) -> f64 {
        if self.upside_down { -angle } else { angle }
    }

    /// Computes the sine once for all points.
    fn transformer(&self) -> impl Fn(f64, f64) -> (f64, f64) + Copy + use<> {
        let (Self { x: ahead, y: left, .. }, (sin, cos)) = (*self, self.heading.sin_cos());
        let side = self.turned(1.0);
        move |x, y| (ahead + x * cos - side * y * sin, left + x * sin + side * y * cos)
    }
}

impl Mul for Pose {
    type Output = Self;

    /// Chains two poses: `inner` is in the frame whose pose is `self`. The heading is in -pi to pi.
    fn mul(self, inner: Self) -> Self {
        let (x, y) = self.transform(inner.x, inner.y);
        let heading = wrapped(self.heading + self.turned(inner.heading));
        Self { x, y, heading, upside_down: self.upside_down != inner.upside_down }
    }
}

/// Wraps an angle into -pi..=pi.
fn wrapped(angle: f64) -> f64 {
    if angle.abs() <= PI { angle } else { angle - TAU * (angle / TAU).round() }
}
