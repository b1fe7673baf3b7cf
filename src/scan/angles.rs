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

    /// Direction of the last point in radians: `angle_min + (len - 1) * angle_increment`, rounded once.
    pub fn angle_max(&self) -> f32 {
        let steps = (self.len() - 1) as f64;
        (self.first_angle() + steps * self.point_angle()) as f32
    }

    /// Angle from one point to the next in radians.
    pub fn angle_increment(&self) -> f32 {
        self.point_angle() as f32
    }

    fn point_angle(&self) -> f64 {
        f64::from(self.window.cluster_count()) * self.meta.geometry.step_angle()
    }

    fn first_angle(&self) -> f64 {
        let middle = (f64::from(self.window.first_cluster()) - 1.0) / 2.0;
        self.meta.geometry.angle(f64::from(self.window.start()) + middle)
    }
}
