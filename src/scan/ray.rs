//! [`Ray`] and [`Point`]: a scan, one direction at a time.

use super::Scan;
use crate::protocol::Measurement;

/// One direction of a scan and what was measured in it, distance or error code.
///
/// In a scan with a cluster count above 1 a ray stands for several steps: `step` is the first
/// of them, `angle` lies in their middle, and the measurement is their smallest value.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Ray {
    /// Step, or the first step of a cluster.
    pub step: u16,
    /// Radians counter-clockwise from the front.
    pub angle: f32,
    /// What was measured.
    pub measurement: Measurement,
    /// Seconds from the scan's first ray ([`Scan::first_ray_stamp`]) to this one.
    pub offset: f32,
}

impl Ray {
    /// Returns the point that was measured, or `None` without a distance.
    pub fn point(&self) -> Option<Point> {
        let Self { step, angle, measurement, offset } = *self;
        measurement.distance()?;
        let (range, (sin, cos)) = (measurement.range(), angle.sin_cos());
        Some(Point { x: range * cos, y: range * sin, range, angle, step, offset })
    }
}

/// Point in the sensor's frame, or after [`Pose::transform_scan`](super::Pose::transform_scan)
/// in another one.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Point {
    /// Metres ahead of the frame's origin, which is the sensor.
    pub x: f32,
    /// Metres to the left of the origin.
    pub y: f32,
    /// Metres from the sensor, in any frame.
    pub range: f32,
    /// Radians counter-clockwise from the sensor's front, seen from its top, in any frame.
    pub angle: f32,
    /// Step of its ray, or the first step of a cluster.
    pub step: u16,
    /// Seconds from the scan's first ray ([`Scan::first_ray_stamp`]) to this point. A robot
    /// at 1 m/s moves 7 cm from the first point to the last: without it your map bends.
    pub offset: f32,
}

impl Scan {
    /// Iterates over all rays, in the order of their steps.
    ///
    /// ```
    /// use tokio_scip::{Scan, Window};
    ///
    /// let scan = Scan::builder(Window::new(383..=385)?, [900, 7, 1250]).build()?;
    /// for ray in scan.rays() {
    ///     match ray.point() {
    ///         Some(point) => println!("step {}: {:.3} {:.3}", ray.step, point.x, point.y),
    ///         None => println!("step {}: {:?}", ray.step, ray.measurement),
    ///     }
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn rays(&self) -> impl ExactSizeIterator<Item = Ray> + Clone + '_ {
        let increment = self.increment();
        let (first, cluster) = (self.window.start(), self.window.cluster_count());
        let rays = self.measurements().zip(self.angles()).enumerate();
        rays.map(move |(n, (measurement, angle))| {
            // A step of the window, so the cast is exact and the sum fits.
            let step = first + n as u16 * u16::from(cluster);
            Ray { step, angle, measurement, offset: (n as f64 * increment) as f32 }
        })
    }

    /// Iterates over the points that have a distance, in the order of their steps. To
    /// compare scans point by point, use [`rays`](Self::rays) instead: each step has a ray.
    pub fn points(&self) -> impl Iterator<Item = Point> + Clone + '_ {
        self.rays().filter_map(|ray| ray.point())
    }

    /// Returns the nearest point, or `None` if no ray has a distance. That is no proof of
    /// free space.
    pub fn nearest(&self) -> Option<Point> {
        self.points().min_by(|a, b| a.range.total_cmp(&b.range))
    }
}

#[cfg(test)]
mod tests {
    use super::super::scan::tests::{scan_of, window};
    use super::*;
    use crate::Window;

    #[test]
    fn points_are_ahead_of_the_sensor_and_to_its_left() {
        let scan = |value| scan_of(window(384, 640, 1), std::iter::repeat_n(value, 257));
        let ahead = scan(1000);
        let points: Vec<Point> = ahead.points().collect();
        let (front, left) = (points[0], points[256]);
        assert_eq!((front.x, front.y), (1.0, 0.0));
        assert!(left.x.abs() < 1e-6 && (left.y - 1.0).abs() < 1e-6);
        assert_eq!(scan(7).points().count(), 0);
    }

    #[test]
    fn each_value_has_its_ray_and_point() {
        let value = |n: u32| if n.is_multiple_of(3) { n % 20 } else { 1000 + n };
        let scan = scan_of(Window::DETECTION, (0..682).map(value));
        let rays: Vec<Ray> = scan.rays().collect();
        assert_eq!(scan.rays().len(), 682);
        for (n, ((ray, angle), value)) in
            rays.iter().zip(scan.angles()).zip(scan.raw_values()).enumerate()
        {
            assert_eq!((ray.step, ray.angle), (44 + n as u16, angle));
            assert_eq!(ray.measurement.value(), value);
            assert!((ray.angle - scan.geometry().degrees(ray.step).to_radians()).abs() < 1e-6);
        }
        let with_point: Vec<&Ray> = rays.iter().filter(|ray| ray.point().is_some()).collect();
        assert_eq!(with_point.len(), scan.points().count());
        for (ray, point) in with_point.into_iter().zip(scan.points()) {
            assert_eq!((ray.step, ray.angle, ray.offset), (point.step, point.angle, point.offset));
            assert_eq!(Some(point), ray.point());
            assert!((point.y.atan2(point.x) - ray.angle).abs() < 1e-5);
        }
    }

    #[test]
    fn the_nearest_point_is_no_error_code() {
        let scan = |values: [u32; 513]| scan_of(window(128, 640, 1), values.into_iter());
        let mut values = [3000; 513];
        (values[0], values[100], values[256], values[400]) = (7, 1000, 1200, 1000);
        // The first of two.
        assert_eq!(scan(values).nearest().unwrap().step, 228);
        assert_eq!(scan([0; 513]).nearest(), None);
    }
}
