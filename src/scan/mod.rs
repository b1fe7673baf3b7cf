//! [`Scan`]: the values of one reply to `G`, with their geometry and times.

mod builder;
#[cfg(feature = "serde")]
mod data;
mod geometry;

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

pub use self::builder::{InvalidScan, ScanBuilder};
pub use self::geometry::Point;
use crate::protocol::{Measurement, Window};

/// One scan: the values of all directions of a [`Window`].
///
/// Cheap to clone: copies share the values. The fields of ROS's
/// `sensor_msgs/LaserScan` are methods of the same names, in the same units
/// (radians, metres, seconds), in the sensor's frame: x forward, y to the left,
/// angles counter-clockwise from the front (REP 103).
///
/// Scans are equal if their windows, values, numbers and stamps are, whenever this
/// process got them: [`requested_at`](Self::requested_at) and
/// [`received_at`](Self::received_at) are not compared.
///
/// The driver makes scans; [`Scan::builder`] makes one from any values, to test a
/// function that takes a `&Scan`.
///
/// # As data
///
/// With the feature `serde` a scan is written as `sequence`, `stamp` (seconds since
/// 1970 with microseconds), `start`, `end`, `cluster`, `angle_min`, `angle_increment`
/// (radians), `scan_time` (seconds), `repeat`, `reconnects`, the raw `values`, and
/// `ranges` in metres, null where there is no distance. A scan is read back from
/// `start`, `end` and `values`; the rest may be missing, `ranges` and the increment
/// are ignored, and both instants are the time of reading.
#[derive(Debug, Clone)]
pub struct Scan {
    window: Window,
    values: Arc<[u16]>,
    /// The index of its first value in `values`, which a cropped scan shares.
    first: usize,
    /// Steps of the first cluster, in whose middle its point lies. A crop keeps it,
    /// so that a point keeps its direction.
    first_cluster: u8,
    meta: ScanMeta,
}

/// The properties of a scan besides its values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScanMeta {
    pub(crate) sequence: u64,
    pub(crate) requested_at: Instant,
    pub(crate) received_at: Instant,
    pub(crate) stamp: SystemTime,
    pub(crate) repeat: bool,
    pub(crate) scan_time: Duration,
    pub(crate) reconnects: u64,
}

impl Scan {
    /// Creates a scan. `values` has one value for each point of `window`, from `first` on.
    pub(crate) fn new(window: Window, values: Arc<[u16]>, first: usize, meta: ScanMeta) -> Self {
        Self { window, values, first, first_cluster: window.first_cluster(), meta }
    }

    /// Returns the block that its values are in.
    pub(crate) fn into_block(self) -> Arc<[u16]> {
        self.values
    }

    /// Makes a scan of `window` from its values, one for each point, as if it had
    /// just arrived. [`ScanBuilder`] sets the rest.
    ///
    /// ```
    /// use tokio_scip::{Scan, Window};
    ///
    /// /// Returns the distance to the nearest object in metres.
    /// fn nearest(scan: &Scan) -> Option<f32> {
    ///     scan.points().map(|point| point.range).reduce(f32::min)
    /// }
    ///
    /// // Millimetres; values below 20 are error codes.
    /// let scan = Scan::builder(Window::new(383..=385)?, [900, 0, 1250]).build()?;
    /// assert_eq!(nearest(&scan), Some(0.9));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn builder(window: Window, values: impl Into<Arc<[u16]>>) -> ScanBuilder {
        ScanBuilder::new(window, values.into())
    }

    /// Returns the window that was asked for.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Returns the number of points, at least 1; the same as [`Window::points`].
    #[expect(clippy::len_without_is_empty, reason = "a scan is never empty")]
    pub fn len(&self) -> usize {
        self.values().len()
    }

    /// Returns the 12-bit values as the sensor sent them, 0..=4095, in the order of
    /// their steps: below 20 an [`ErrorCode`](crate::ErrorCode), 20..=4094
    /// millimetres (C-42-3320-A p. 5 and 7).
    pub fn values(&self) -> &[u16] {
        let end = self.first + self.window.points();
        self.values.get(self.first..end).unwrap_or_default()
    }

    /// Iterates over the meanings of the values.
    pub fn measurements(&self) -> impl ExactSizeIterator<Item = Measurement> + Clone + '_ {
        self.values().iter().map(|&value| Measurement::from_value(value))
    }

    /// Iterates over the ranges in metres after ROS REP 117: a distance as it is,
    /// `+Inf` for the values 0, 6, 16 and 4095 (possibly beyond range, no proof of free
    /// space), `NaN` for all other error codes. `-Inf` never comes.
    pub fn ranges(&self) -> impl ExactSizeIterator<Item = f32> + Clone + '_ {
        self.measurements().map(Measurement::range)
    }

    /// Returns the time from one point to the next in seconds: the part of the
    /// motor's revolution between them, 97.66 us a step at 600 rpm.
    pub fn time_increment(&self) -> f32 {
        let revolution = self.meta.scan_time.as_secs_f64();
        (revolution * f64::from(self.window.cluster_count()) / 1024.0) as f32
    }

    /// Returns the time of a revolution of the motor in seconds: from the sensor's
    /// firmware line, else 0.1 (600 rpm).
    pub fn scan_time(&self) -> f32 {
        self.meta.scan_time.as_secs_f32()
    }

    /// Returns the shortest range that is measured: 0.020 m (C-42-3320-A p. 7).
    pub fn range_min(&self) -> f32 {
        0.020
    }

    /// Returns the longest range that is measured: 4.094 m (C-42-3320-A p. 7).
    pub fn range_max(&self) -> f32 {
        4.094
    }

    /// Returns the number of this scan in its schedule, from 0. A gap means that the
    /// consumer was too slow and missed the scans between. 0 for a single
    /// [`Sensor::scan`](crate::Sensor::scan).
    pub fn sequence(&self) -> u64 {
        self.meta.sequence
    }

    /// Returns the number of times that the sensor had been found again before this
    /// scan, as [`Stats::reconnects`](crate::Stats::reconnects). A scan whose number
    /// differs from the one before is the first after a reconnect, also if the
    /// consumer missed scans between.
    pub fn reconnects(&self) -> u64 {
        self.meta.reconnects
    }

    /// Returns the time when its `G` was sent, on tokio's clock, which a test may
    /// pause. Never runs back from one scan to the next.
    pub fn requested_at(&self) -> Instant {
        self.meta.requested_at
    }

    /// Returns the time when its last byte was read, on tokio's clock, which a test
    /// may pause. Never runs back from one scan to the next.
    pub fn received_at(&self) -> Instant {
        self.meta.received_at
    }

    /// Returns the time since [`received_at`](Self::received_at). The measurement is
    /// older: by the time of the reply, and by up to a revolution.
    pub fn age(&self) -> Duration {
        self.meta.received_at.elapsed()
    }

    /// Returns the wall clock when the reply's first byte arrived: the sensor sends
    /// what it has in memory, so the motor's revolution was over by then. It may run
    /// back when the system's clock is set.
    ///
    /// It is the system's clock also where tokio's is paused: in such a test only
    /// `requested_at` and `received_at` follow the test's time. A replay has the
    /// stamps of its recording.
    pub fn stamp(&self) -> SystemTime {
        self.meta.stamp
    }

    /// Returns the wall clock when the first point was measured, the time that ROS
    /// wants in the header of a `sensor_msgs/LaserScan`: point `n` was measured
    /// `n * time_increment` later.
    ///
    /// SCIP 1.1 has no time stamps, so it is computed. The motor turns
    /// counter-clockwise, and a revolution begins and ends at the rear (-180
    /// degrees). The reply is assumed to begin when a revolution ends, so its first
    /// point lies `(angle_min + pi) / (2 pi)` of a [`scan_time`](Self::scan_time)
    /// behind the revolution's beginning: for
    /// [`Window::DETECTION`](crate::Window::DETECTION) 83 ms before
    /// [`stamp`](Self::stamp). A [crop](Self::crop) has the time of its own first
    /// point.
    ///
    /// # Error
    ///
    /// The true time is at or before this one, as far as the speed of the motor
    /// is known:
    ///
    /// - by the time that the first byte takes, if the sensor answers at the end of
    ///   each revolution, as it does on USB: one or two milliseconds;
    /// - by up to one `scan_time` more, on average half of one, if it answers at
    ///   once from its memory, as it may on RS-232: the revolution there ended
    ///   some time before. How long the reply then takes does not matter;
    /// - by the time between both replies for a [repeat](Self::is_repeat), which most
    ///   likely shows the revolution of the scan before it.
    ///
    /// The sensor's angles and the phase of its replies are from the protocol's text
    /// and from captures of replies, not from a measurement of moving objects.
    pub fn first_ray_stamp(&self) -> SystemTime {
        let from_rear = (f64::from(self.angle_min()) / std::f64::consts::TAU + 0.5).clamp(0.0, 1.0);
        let before = self.meta.scan_time.mul_f64(1.0 - from_rear);
        self.stamp().checked_sub(before).unwrap_or(self.stamp())
    }

    /// Returns true if all values are the same as those of the scan before: most
    /// likely two polls in one revolution of the motor. SCIP 1.1 has no time stamps
    /// that would prove it.
    pub fn is_repeat(&self) -> bool {
        self.meta.repeat
    }
}

impl PartialEq for Scan {
    fn eq(&self, other: &Self) -> bool {
        let meta = |scan: &Self| {
            let ScanMeta { sequence, stamp, repeat, scan_time, reconnects, .. } = scan.meta;
            (sequence, stamp, repeat, scan_time, reconnects)
        };
        self.window == other.window
            && self.first_cluster == other.first_cluster
            && meta(self) == meta(other)
            && self.values() == other.values()
    }
}

impl Eq for Scan {}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn scan(window: Window) -> Scan {
        let now = Instant::now();
        let meta = ScanMeta {
            sequence: 0,
            requested_at: now,
            received_at: now,
            stamp: SystemTime::now(),
            repeat: false,
            scan_time: Duration::from_millis(100),
            reconnects: 0,
        };
        // Each value is its place.
        let values = (0..window.points() as u16).map(|n| 20 + n).collect();
        Scan::new(window, values, 0, meta)
    }

    pub(super) fn window(from: u16, to: u16, cluster_count: u8) -> Window {
        Window::new(from..=to).and_then(|window| window.with_cluster_count(cluster_count)).unwrap()
    }

    #[test]
    fn the_first_ray_is_as_long_before_the_reply_as_the_motor_turned_on() {
        let before = |scan: &Scan| {
            let before = scan.stamp().duration_since(scan.first_ray_stamp()).unwrap();
            (before.as_secs_f64() * 1e5).round() / 100.0
        };
        // Steps from the rear to the first one, of 1,024: 128 to step 0.
        let ms = |steps: f64| ((1.0 - steps / 1024.0) * 1e4).round() / 100.0;
        assert_eq!(before(&scan(Window::FULL)), 87.5);
        assert_eq!(before(&scan(Window::DETECTION)), ms(128.0 + 44.0));
        assert_eq!(before(&scan(window(640, 700, 1))), ms(128.0 + 640.0));
        // The middle of the first cluster.
        assert_eq!(before(&scan(window(640, 700, 3))), ms(128.0 + 641.0));
        let part = scan(Window::FULL).crop(window(384, 768, 1)).unwrap();
        assert_eq!(before(&part), 50.0);
        let mut slow = scan(Window::FULL);
        slow.meta.scan_time = Duration::from_millis(200);
        assert_eq!(before(&slow), 175.0);
    }

    #[test]
    fn scans_are_equal_if_what_they_hold_is() {
        let (a, b) = (scan(Window::DETECTION), scan(Window::DETECTION));
        let with = |meta: ScanMeta| Scan { meta, ..a.clone() };
        let later = a.received_at() + Duration::from_secs(1);
        assert_eq!(a, with(ScanMeta { requested_at: later, received_at: later, ..a.meta }));
        assert_ne!(a, with(ScanMeta { sequence: 1, ..a.meta }));
        assert_ne!(a, with(ScanMeta { reconnects: 1, ..a.meta }));
        assert_ne!(a, with(ScanMeta { repeat: true, ..a.meta }));
        assert_ne!(a, with(ScanMeta { stamp: SystemTime::UNIX_EPOCH, ..a.meta }));
        assert_ne!(a, with(ScanMeta { scan_time: Duration::ZERO, ..a.meta }));
        let mut other = Scan { meta: a.meta, ..b };
        assert_eq!(a, other);
        other.values = std::iter::repeat_n(0, 682).collect();
        assert_ne!(a, other);
        // The same values at another place of a shared block.
        let part = a.crop(window(50, 60, 1)).unwrap();
        assert_eq!(part, a.crop(window(45, 60, 1)).unwrap().crop(window(50, 60, 1)).unwrap());
    }

    #[tokio::test(start_paused = true)]
    async fn the_age_of_a_scan_is_on_the_clock_that_a_test_pauses() {
        let scan = scan(Window::DETECTION);
        tokio::time::advance(Duration::from_secs(3)).await;
        assert_eq!(scan.age(), Duration::from_secs(3));
    }
}
