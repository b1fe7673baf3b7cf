//! [`Scan`]: one answer to `G`, with its geometry.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use crate::protocol::{Measurement, Window};

/// One scan: what the sensor measured in each direction of a [`Window`].
///
/// Cheap to clone: copies share the values. The fields of ROS's
/// `sensor_msgs/LaserScan` are methods of the same names, in the same units
/// (radians, metres, seconds), in the sensor's frame: x forward, y to the left,
/// angles counter-clockwise from the front (REP 103).
#[derive(Debug, Clone)]
pub struct Scan {
    window: Window,
    values: Arc<[u16]>,
    /// Where this scan begins in `values`; a cropped one shares them.
    first: usize,
    meta: ScanMeta,
}

/// What is known of a scan besides its values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScanMeta {
    pub(crate) sequence: u64,
    pub(crate) requested_at: Instant,
    pub(crate) received_at: Instant,
    pub(crate) stamp: SystemTime,
    pub(crate) repeat: bool,
    pub(crate) scan_time: Duration,
}

/// A point in the sensor's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Point {
    /// Metres ahead of the sensor.
    pub x: f32,
    /// Metres to the left of the sensor.
    pub y: f32,
    /// Metres from the sensor, 0.020..=4.094.
    pub range: f32,
    /// Radians counter-clockwise from the front.
    pub angle: f32,
}

impl Scan {
    /// `values` has one value for each point of `window`, after `first` others.
    pub(crate) fn new(window: Window, values: Arc<[u16]>, first: usize, meta: ScanMeta) -> Self {
        Self { window, values, first, meta }
    }

    /// What was asked for.
    pub fn window(&self) -> Window {
        self.window
    }

    /// How many points it has, at least 1; the same as
    /// [`Window::points`].
    #[expect(clippy::len_without_is_empty, reason = "a scan is never empty")]
    pub fn len(&self) -> usize {
        self.values().len()
    }

    /// The 12-bit codes as the sensor sent them, 0..=4095, in the order of
    /// their steps: below 20 an [`ErrorCode`](crate::ErrorCode), 20..=4094
    /// millimetres (C-42-3320-A p. 5 and 7).
    pub fn values(&self) -> &[u16] {
        let end = self.first + self.window.points();
        self.values.get(self.first..end).unwrap_or_default()
    }

    /// What each value means.
    pub fn measurements(&self) -> impl ExactSizeIterator<Item = Measurement> + Clone + '_ {
        self.values().iter().map(|&value| Measurement::from_value(value))
    }

    /// The ranges in metres after ROS REP 117: a distance as it is, `+Inf` for
    /// codes 0, 6, 16 and 4095 (possibly beyond range, no proof of free
    /// space), `NaN` for all other codes. `-Inf` never comes.
    pub fn ranges(&self) -> impl ExactSizeIterator<Item = f32> + Clone + '_ {
        self.measurements().map(Measurement::range)
    }

    /// The direction of each point in radians: point `n` lies at
    /// `angle_min + n * angle_increment`, the middle of the steps of its
    /// cluster. The last cluster may be a partial one; it is treated as whole.
    pub fn angles(&self) -> impl ExactSizeIterator<Item = f32> + Clone + use<> {
        let (from, increment) = (self.window.angle_min(), self.window.angle_increment());
        // Computed in double precision: a sum of rounded steps would drift.
        (0..self.len()).map(move |n| (from + n as f64 * increment) as f32)
    }

    /// The points that have a distance, in the order of their steps. Those that
    /// have none are left out: where the place of a point matters, as in a
    /// comparison with another scan, use [`measurements`](Self::measurements) or
    /// [`ranges`](Self::ranges), which have one item for each point.
    pub fn points(&self) -> impl Iterator<Item = Point> + Clone + '_ {
        self.ranges().zip(self.angles()).filter(|(range, _)| range.is_finite()).map(
            |(range, angle)| {
                let (sin, cos) = angle.sin_cos();
                Point { x: range * cos, y: range * sin, range, angle }
            },
        )
    }

    /// The part of the scan inside of `window`: the points of which all steps
    /// lie in it, or `None` if there is none. The cluster count of the result
    /// is this scan's; that of `window` plays no part. Shares the values.
    pub fn crop(&self, window: Window) -> Option<Self> {
        let cluster = self.window.cluster_count();
        let (start, end) = (self.window.start().number(), self.window.end().number());
        let skip = window.start().number().saturating_sub(start).div_ceil(u16::from(cluster));
        let from = start + skip * u16::from(cluster);
        // A point ends where its cluster does, the last one where the scan does.
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
            meta: self.meta,
        })
    }

    /// The direction of the first point in radians.
    pub fn angle_min(&self) -> f32 {
        self.window.angle_min() as f32
    }

    /// The direction of the last point in radians:
    /// `angle_min + (len - 1) * angle_increment`.
    pub fn angle_max(&self) -> f32 {
        let steps = (self.len() - 1) as f64;
        (self.window.angle_min() + steps * self.window.angle_increment()) as f32
    }

    /// From one point to the next in radians.
    pub fn angle_increment(&self) -> f32 {
        self.window.angle_increment() as f32
    }

    /// From one point to the next in seconds: the part of the motor's turn
    /// between them, 97.66 us a step at 600 rpm.
    pub fn time_increment(&self) -> f32 {
        let turn = self.meta.scan_time.as_secs_f64();
        (turn * f64::from(self.window.cluster_count()) / 1024.0) as f32
    }

    /// A turn of the motor in seconds: what the sensor's firmware line says,
    /// else 0.1 (600 rpm).
    pub fn scan_time(&self) -> f32 {
        self.meta.scan_time.as_secs_f32()
    }

    /// The shortest range that is measured: 0.020 m (C-42-3320-A p. 7).
    pub fn range_min(&self) -> f32 {
        0.020
    }

    /// The longest range that is measured: 4.094 m (C-42-3320-A p. 7).
    pub fn range_max(&self) -> f32 {
        4.094
    }

    /// Numbers the scans of its schedule from 0: a gap means that the consumer
    /// was too slow to see the scans between. 0 for a single
    /// [`Sensor::scan`](crate::Sensor::scan).
    pub fn sequence(&self) -> u64 {
        self.meta.sequence
    }

    /// When its `G` was sent. Never runs back from one scan to the next.
    pub fn requested_at(&self) -> Instant {
        self.meta.requested_at
    }

    /// When its last byte was read. Never runs back from one scan to the next.
    pub fn received_at(&self) -> Instant {
        self.meta.received_at
    }

    /// The wall clock when the reply's first byte arrived: the sensor sends
    /// what it has in memory, so the motor's turn was over by then. It may run
    /// back when the system's clock is set.
    pub fn stamp(&self) -> SystemTime {
        self.meta.stamp
    }

    /// True if all values are the same as those of the scan before: the sensor
    /// was most likely asked twice in one turn of its motor. SCIP 1.1 has no
    /// time stamp to tell for sure.
    pub fn is_repeat(&self) -> bool {
        self.meta.repeat
    }
}

/// As data: `sequence`, `stamp` (seconds since 1970 with microseconds),
/// `start`, `end`, `cluster`, `angle_min`, `angle_increment` (radians), the raw
/// codes in `values`, and metres in `ranges`, with none where a range is not
/// finite.
#[cfg(feature = "serde")]
impl serde::Serialize for Scan {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;

        // JSON has no infinity and no NaN.
        let finite = |range: f32| Some(range).filter(|range| range.is_finite());
        let ranges: Vec<_> = self.ranges().map(finite).collect();
        let since_1970 = self.stamp().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let mut scan = serializer.serialize_struct("Scan", 9)?;
        scan.serialize_field("sequence", &self.sequence())?;
        scan.serialize_field("stamp", &(since_1970.as_micros() as f64 / 1e6))?;
        scan.serialize_field("start", &self.window.start())?;
        scan.serialize_field("end", &self.window.end())?;
        scan.serialize_field("cluster", &self.window.cluster_count())?;
        scan.serialize_field("angle_min", &self.angle_min())?;
        scan.serialize_field("angle_increment", &self.angle_increment())?;
        scan.serialize_field("values", self.values())?;
        scan.serialize_field("ranges", &ranges)?;
        scan.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(window: Window) -> Scan {
        let now = Instant::now();
        let meta = ScanMeta {
            sequence: 0,
            requested_at: now,
            received_at: now,
            stamp: SystemTime::now(),
            repeat: false,
            scan_time: Duration::from_millis(100),
        };
        // Each value tells its place.
        let values = (0..window.points() as u16).map(|n| 20 + n).collect();
        Scan::new(window, values, 0, meta)
    }

    fn window(from: u16, to: u16, cluster_count: u8) -> Window {
        Window::new(from..=to).and_then(|window| window.with_cluster_count(cluster_count)).unwrap()
    }

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
        assert!((scan.time_increment() - 97.66e-6).abs() < 1e-8);
        assert_eq!((scan.range_min(), scan.range_max(), scan.scan_time()), (0.020, 4.094, 0.1));
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
        // Fewer steps than a cluster has: the middle of those that there are.
        assert_eq!(scan(window(384, 386, 99)).angle_min(), scan(window(385, 385, 1)).angle_min());
    }

    #[test]
    fn points_are_ahead_of_the_sensor_and_to_its_left() {
        let mut scan = scan(window(384, 640, 1));
        scan.values = std::iter::repeat_n(1000, 257).collect();
        let points: Vec<Point> = scan.points().collect();
        let (front, left) = (points[0], points[256]);
        assert_eq!((front.x, front.y), (1.0, 0.0));
        assert!(left.x.abs() < 1e-6 && (left.y - 1.0).abs() < 1e-6);
        scan.values = std::iter::repeat_n(7, 257).collect();
        assert_eq!(scan.points().count(), 0);
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
        // A crop of a crop still finds its values.
        let twice = all.crop(window(100, 199, 1)).and_then(|part| part.crop(window(150, 150, 1)));
        assert_eq!(twice.map(|part| part.values().to_vec()), Some(vec![126]));
    }
}
