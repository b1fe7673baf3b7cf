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
    /// True if the sensor is turned over about its x axis (a roll of 180 degrees): its left is
    /// to the right of its heading.
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
        scan.points().map(move |point| moved(point, transform))
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

    /// Chains two poses: `inner` is in the frame whose pose is `self`. The heading is in -pi
    /// to pi.
    fn mul(self, inner: Self) -> Self {
        let (x, y) = self.transform(inner.x, inner.y);
        let heading = wrapped(self.heading + self.turned(inner.heading));
        Self { x, y, heading, upside_down: self.upside_down != inner.upside_down }
    }
}

fn moved(point: Point, transform: impl Fn(f64, f64) -> (f64, f64)) -> Point {
    let (x, y) = transform(point.x.into(), point.y.into());
    Point { x: x as f32, y: y as f32, ..point }
}

/// Wraps an angle into -pi..=pi.
fn wrapped(angle: f64) -> f64 {
    if angle.abs() <= PI { angle } else { angle - TAU * (angle / TAU).round() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::scan::tests::{scan, window};
    use super::*;

    fn near(a: (f64, f64), b: (f64, f64)) -> bool {
        (a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9
    }

    #[test]
    fn a_moved_scan_keeps_what_the_sensor_measured() {
        let scan = scan(window(384, 640, 1));
        let pose = Pose { x: 10.0, y: -4.0, heading: 1.0, upside_down: true };
        assert_eq!(pose.transform_scan(&scan).count(), 257);
        for (moved, point) in pose.transform_scan(&scan).zip(scan.points()) {
            assert_eq!(Point { x: point.x, y: point.y, ..moved }, point);
            let (x, y) = pose.transform(point.x, point.y);
            assert_eq!((moved.x, moved.y), (x as f32, y as f32));
        }
    }

    /// Rotates a point as tf2 does: roll about x, then yaw about z, in three dimensions.
    fn rotated(pose: Pose, (x, y, z): (f64, f64, f64)) -> (f64, f64, f64) {
        let (sin, cos) = if pose.upside_down { (0.0, -1.0) } else { (0.0, 1.0) };
        let (y, z) = (y * cos - z * sin, y * sin + z * cos);
        let (sin, cos) = pose.heading.sin_cos();
        (x * cos - y * sin, x * sin + y * cos, z)
    }

    fn poses() -> impl Strategy<Value = Pose> {
        (-100.0..100.0, -100.0..100.0, -10.0..10.0, any::<bool>())
            .prop_map(|(x, y, heading, upside_down)| Pose { x, y, heading, upside_down })
    }

    proptest! {
        #[test]
        fn a_point_moved_there_and_back_is_where_it_was(
            pose in poses(), point in (-100.0..100.0, -100.0..100.0),
        ) {
            let (there_x, there_y) = pose.transform(point.0, point.1);
            prop_assert!(near(pose.inverse().transform(there_x, there_y), point));
            let nowhere = pose * pose.inverse();
            prop_assert!(near((nowhere.x, nowhere.y), (0.0, 0.0)) && nowhere.heading.abs() < 1e-9);
            prop_assert!(pose.inverse().heading.abs() <= PI && !nowhere.upside_down);
        }

        #[test]
        fn a_pose_moves_points_as_tf2_does(
            pose in poses(), inner in poses(), point in (-100.0..100.0, -100.0..100.0),
        ) {
            let (x, y, z) = rotated(pose, (point.0, point.1, 0.0));
            prop_assert!(near(pose.transform(point.0, point.1), (pose.x + x, pose.y + y)));
            prop_assert!(z.abs() < 1e-9);
            let (x, y) = inner.transform(point.0, point.1);
            prop_assert!(near((pose * inner).transform(point.0, point.1), pose.transform(x, y)));
        }
    }
}
