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
    use std::f64::consts::TAU;
    use std::time::Duration;

    use proptest::prelude::*;

    use super::super::scan::tests::{scan, window};
    use super::*;
    use crate::Window;

    fn near(one: f32, other: f64) -> bool {
        (f64::from(one) - other).abs() < 1e-5
    }

    proptest! {
        /// A last cluster with fewer steps counts as whole, unless it is the only one.
        #[test]
        fn each_value_is_shown_where_and_when_it_was_measured(
            bounds in prop::array::uniform2(0_u16..=768),
            cluster_count in prop_oneof![Just(1_u8), 1_u8..=99],
            revolution in 0.02..0.2_f64,
            values in prop::collection::vec(prop_oneof![0_u32..30, 0_u32..4096], 769),
        ) {
            let first = bounds[0].min(bounds[1]);
            let window = window(first, bounds[0].max(bounds[1]), cluster_count);
            let values = &values[..window.points()];
            let scan_time = Duration::from_secs_f64(revolution);
            let scan = Scan::builder(window, values).scan_time(scan_time).build().unwrap();
            let rays: Vec<Ray> = scan.rays().collect();
            prop_assert_eq!((rays.len(), scan.rays().len()), (values.len(), scan.len()));
            let cluster = f64::from(cluster_count);
            let middle = f64::from(first) + (cluster.min(window.steps() as f64) - 1.0) / 2.0;
            for (n, (ray, value)) in rays.iter().zip(values).enumerate() {
                let Ray { step, angle, measurement, offset } = *ray;
                let (steps, range) = (n as f64 * cluster, f64::from(*value) / 1000.0);
                let direction = (middle + steps - 384.0) / 1024.0 * TAU;
                prop_assert_eq!(f64::from(step), f64::from(first) + steps);
                prop_assert_eq!(measurement.value(), *value);
                prop_assert!(near(angle, direction) && near(offset, revolution * steps / 1024.0));
                let point = ray.point();
                prop_assert_eq!(point.is_some(), (20..=4094).contains(value));
                if let Some(point) = point {
                    let (x, y) = (range * direction.cos(), range * direction.sin());
                    prop_assert!(near(point.x, x) && near(point.y, y));
                    prop_assert_eq!(point, Point { range: range as f32, angle, step, offset, ..point });
                }
            }
            let points: Vec<Point> = rays.iter().filter_map(Ray::point).collect();
            prop_assert!(scan.points().eq(points.iter().copied()));
            // The first of several.
            let nearer = |one: Point, other: Point| if other.range < one.range { other } else { one };
            prop_assert_eq!(scan.nearest(), points.into_iter().reduce(nearer));
            prop_assert_eq!(Some(scan.angle_min()), rays.first().map(|ray| ray.angle));
            prop_assert_eq!(Some(scan.angle_max()), rays.last().map(|ray| ray.angle));
            prop_assert!(near(scan.angle_increment(), cluster / 1024.0 * TAU));
            let increment = scan.time_increment().as_secs_f64();
            prop_assert!((increment - revolution * cluster / 1024.0).abs() < 1e-8);
        }
    }

    #[test]
    fn the_geometry_is_that_of_the_text() {
        let scan = scan(Window::FULL);
        let degrees: Vec<f32> = scan.rays().map(|ray| ray.angle.to_degrees()).collect();
        assert_eq!((degrees[0], degrees[384], degrees[768]), (-135.0, 0.0, 135.0));
        assert_eq!(scan.time_increment(), Duration::from_nanos(97_656));
        assert_eq!((scan.range_min(), scan.range_max()), (0.019, 4.095));
        assert_eq!(scan.scan_time(), Duration::from_millis(100));
    }
}
