//! [`Ray`] and [`Point`]: a scan, one direction at a time.

use super::Scan;
use crate::protocol::Measurement;

/// One direction of a scan and what was measured in it, distance or error code.
///
/// In a scan with a cluster count above 1 a ray stands for several steps: `step` is the first
/// of them, `angle` lies in their middle, and the measurement is their smallest value, in SCIP 2
/// their smallest distance if there is one.
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

/// Point in the sensor's frame; in another one after [a transform](super::Pose::transform_scan).
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

    /// Returns the nearest point, or `None` if no ray has a distance. That is no proof of free space.
    pub fn nearest(&self) -> Option<Point> {
        self.points().min_by(|a, b| a.range.total_cmp(&b.range))
    }
}
