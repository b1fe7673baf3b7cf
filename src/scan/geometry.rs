//! Directions of a [`Scan`], and its parts.

use std::sync::Arc;

use super::Scan;
use crate::protocol::{Window, angle};

impl Scan {
    /// Iterates over the directions of the points in radians. Point `n` lies at
    /// `angle_min + n * angle_increment`, the middle of its cluster's steps. A last
    /// cluster with fewer steps counts as a whole one.
    pub fn angles(&self) -> impl ExactSizeIterator<Item = f32> + Clone + use<> {
        let (from, increment) = (self.first_angle(), self.window.angle_increment());
        // In double precision, because a sum of rounded steps would drift.
        (0..self.len()).map(move |n| (from + n as f64 * increment) as f32)
    }

    /// Crops the scan to the points whose steps all lie inside `window`. Returns `None`
    /// if there are no such points. Keeps the scan's cluster count and ignores the
    /// cluster count of `window`. Each point keeps its direction. Shares the values.
    pub fn crop(&self, window: Window) -> Option<Self> {
        let cluster = self.window.cluster_count();
        let (start, end) = (self.window.start().number(), self.window.end().number());
        let skip = window.start().number().saturating_sub(start).div_ceil(u16::from(cluster));
        let from = start + skip * u16::from(cluster);
        // A point ends with its cluster, and the last point ends with the scan.
        let until = if window.end().number() >= end {
            end
        } else {
            let whole = (window.end().number() + 1).checked_sub(from)? / u16::from(cluster);
            (from + whole * u16::from(cluster)).checked_sub(1)?
        };
        let window = Window::new(from..=until).ok()?.with_cluster_count(cluster).ok()?;
        Some(Self {
            window,
            values: Arc::clone(&self.values),
            first: self.first + usize::from(skip),
            first_cluster: self.first_cluster,
            meta: self.meta,
        })
    }

    /// Direction of the first point in radians.
    pub fn angle_min(&self) -> f32 {
        self.first_angle() as f32
    }

    /// Direction of the last point in radians: `angle_min + (len - 1) * angle_increment`,
    /// rounded once.
    pub fn angle_max(&self) -> f32 {
        let steps = (self.len() - 1) as f64;
        (self.first_angle() + steps * self.window.angle_increment()) as f32
    }

    /// Angle from one point to the next in radians.
    pub fn angle_increment(&self) -> f32 {
        self.window.angle_increment() as f32
    }

    fn first_angle(&self) -> f64 {
        let middle = (f64::from(self.first_cluster) - 1.0) / 2.0;
        angle(f64::from(self.window.start().number()) + middle)
    }
}

#[cfg(test)]
mod tests {
    use super::super::scan::tests::{scan, window};
    use std::time::Duration;

    use super::*;

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
        assert_eq!((scan.range_min(), scan.range_max()), (0.020, 4.094));
        assert_eq!(scan.scan_time(), Duration::from_millis(100));
    }

    #[test]
    fn a_cluster_lies_in_the_middle_of_its_steps_and_a_partial_last_one_is_taken_as_whole() {
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

    #[test]
    fn a_crop_keeps_the_points_of_which_all_steps_are_inside() {
        let all = scan(window(44, 725, 1));
        let part =
            all.crop(window(100, 199, 1)).map(|part| (part.window(), part.values().to_vec()));
        assert_eq!(part, Some((window(100, 199, 1), (76..176).collect())));
        assert_eq!(all.crop(Window::FULL).map(|part| part.window()), Some(all.window()));
        assert!(all.crop(window(0, 43, 1)).is_none());
        assert!(all.crop(window(726, 768, 1)).is_none());

        // Groups 10..=13, 14..=17, 18..=20.
        let grouped = scan(window(10, 20, 4));
        let crop = |from, to| {
            let part = grouped.crop(window(from, to, 1))?;
            Some((
                part.window().start().number(),
                part.window().end().number(),
                part.values().to_vec(),
            ))
        };
        assert_eq!(crop(10, 20), Some((10, 20, vec![20, 21, 22])));
        assert_eq!(crop(11, 20), Some((14, 20, vec![21, 22])));
        assert_eq!(crop(10, 19), Some((10, 17, vec![20, 21])));
        assert_eq!(crop(0, 13), Some((10, 13, vec![20])));
        assert_eq!(crop(11, 16), None);
        assert_eq!(crop(18, 18), None);
        assert_eq!(crop(19, 20), None);
        assert_eq!(crop(18, 20), Some((18, 20, vec![22])));
        // A crop of a crop still finds its values.
        let twice = all.crop(window(100, 199, 1)).and_then(|part| part.crop(window(150, 150, 1)));
        assert_eq!(twice.map(|part| part.values().to_vec()), Some(vec![126]));
    }

    #[test]
    fn a_crop_moves_no_point() {
        // Groups 10..=13, 14..=17, and the rest 18..=20.
        let grouped = scan(window(10, 20, 4));
        let all: Vec<f32> = grouped.angles().collect();
        for (from, kept) in [(10, 0), (14, 1), (18, 2)] {
            let part = grouped.crop(window(from, 20, 1)).unwrap();
            assert_eq!(part.angles().collect::<Vec<_>>(), all[kept..], "from step {from}");
            assert_eq!(part.angle_max(), grouped.angle_max());
        }
        // A window with fewer steps than a cluster has no whole cluster before it.
        let alone = scan(window(18, 20, 4));
        assert_eq!(alone.crop(Window::FULL).map(|part| part.angle_min()), Some(alone.angle_min()));
        assert_ne!(Some(alone), grouped.crop(window(18, 20, 1)));
    }
}
