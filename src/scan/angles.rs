//! Directions of a [`Scan`].

use super::Scan;

impl Scan {
    /// Iterates over the directions of the points in radians. Point `n` lies at
    /// `angle_min + n * angle_increment`, the middle of its cluster's steps. A last
    /// cluster with fewer steps counts as a whole one.
    pub(super) fn angles(&self) -> impl ExactSizeIterator<Item = f32> + Clone + use<> {
        let (from, increment) = (self.first_angle(), self.point_angle());
        // In double precision, because a sum of rounded steps would drift.
        (0..self.len()).map(move |n| (from + n as f64 * increment) as f32)
    }

    /// Direction of the first point in radians.
    pub fn angle_min(&self) -> f32 {
        self.first_angle() as f32
    }

    /// Direction of the last point in radians: `angle_min + (len - 1) * angle_increment`,
    /// rounded once.
    pub fn angle_max(&self) -> f32 {
        let steps = (self.len() - 1) as f64;
        (self.first_angle() + steps * self.point_angle()) as f32
    }

    /// Angle from one point to the next in radians.
    pub fn angle_increment(&self) -> f32 {
        self.point_angle() as f32
    }

    /// Angle from one point to the next in radians.
    fn point_angle(&self) -> f64 {
        f64::from(self.window.cluster_count()) * self.meta.geometry.step_angle()
    }

    fn first_angle(&self) -> f64 {
        let middle = (f64::from(self.window.first_cluster()) - 1.0) / 2.0;
        self.meta.geometry.angle(f64::from(self.window.start()) + middle)
    }
}

#[cfg(test)]
mod tests {
    use super::super::scan::tests::{scan, window};
    use std::time::Duration;

    use crate::Window;

    #[test]
    fn the_geometry_is_that_of_the_text() {
        let scan = scan(Window::FULL);
        let angles: Vec<f32> = scan.angles().collect();
        let degrees = |n: usize| angles.get(n).map(|angle| angle.to_degrees().round());
        assert_eq!(
            (degrees(0), degrees(384), degrees(768)),
            (Some(-135.0), Some(0.0), Some(135.0))
        );
        assert_eq!((scan.angle_min(), scan.angle_max()), (angles[0], angles[768]));
        assert_eq!(scan.angle_increment(), (360.0f64 / 1024.0).to_radians() as f32);
        assert_eq!(scan.time_increment(), Duration::from_nanos(97_656));
        assert_eq!((scan.range_min(), scan.range_max()), (0.019, 4.095));
        assert_eq!(scan.scan_time(), Duration::from_millis(100));
    }

    #[test]
    fn a_partial_last_cluster_counts_as_whole() {
        for (window, first) in [(window(44, 725, 4), 45.5), (window(0, 768, 99), 49.0)] {
            let scan = scan(window);
            let step = |angle: f32| angle / (std::f32::consts::TAU / 1024.0) + 384.0;
            assert!((step(scan.angle_min()) - first).abs() < 1e-3);
            let last = first + (scan.len() - 1) as f32 * f32::from(window.cluster_count());
            assert!((step(scan.angle_max()) - last).abs() < 1e-3);
            assert_eq!(scan.angles().last(), Some(scan.angle_max()));
            assert_eq!(scan.angles().len(), scan.len());
        }
        // Fewer steps than in a whole cluster: the middle of the existing steps.
        assert_eq!(scan(window(384, 386, 99)).angle_min(), scan(window(385, 385, 1)).angle_min());
    }
}
