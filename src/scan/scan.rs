//! [`Scan`]: the values of one reply to `G`, with their geometry and times.

use std::fmt;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::values::{Part, Values};
use crate::protocol::{Geometry, Measurement, Window};

/// Values of all directions of a [`Window`], measured in one revolution.
///
/// Cheap to clone: copies share the values. The fields of ROS's `sensor_msgs/LaserScan` are methods
/// of the same names, in the same units: radians, metres, and a `Duration` for times. The frame is
/// the sensor's: x forward, y to the left, angles counter-clockwise from the front (REP 103).
///
/// `==` compares geometries, windows, values, numbers and stamps, but no [`Instant`].
///
/// The driver makes scans. To test a function that takes a `&Scan`, make one by [`Scan::builder`].
///
/// # As data
///
/// With the feature `serde` a scan is written as `sequence`, `stamp` and `first_ray` (seconds since 1970),
/// `stamp_quality`, `lateness` (seconds, or null), `start`, `end`, `cluster`, `angle_min`,
/// `angle_increment` (radians), `scan_time` (seconds), `range_min`, `range_max`, `repeat`, `reconnects`,
/// `beyond` (values that are `+Inf` in ROS), `values`, `ranges` (metres, or null), and any `intensities`.
#[derive(Clone)]
pub struct Scan {
    pub(super) window: Window,
    values: Values,
    /// Index of the first value in `values`: the driver may have asked for more.
    first: usize,
    pub(crate) meta: ScanMeta,
}

/// Properties of a scan besides its values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScanMeta {
    pub(crate) sequence: u64,
    pub(crate) requested_at: Instant,
    pub(crate) first_byte_at: Instant,
    pub(crate) received_at: Instant,
    /// Wall clock at `first_byte_at`.
    pub(crate) stamp: SystemTime,
    /// Time from the end of the revolution to `first_byte_at`, if the motor is known.
    pub(crate) lateness: Option<Duration>,
    /// How much later the first ray is than that, so that it follows the scan before.
    pub(crate) postponed: Duration,
    pub(crate) repeat: bool,
    pub(crate) scan_time: Duration,
    pub(crate) geometry: Geometry,
    /// Time of the sensor's clock in milliseconds, if it tells.
    pub(crate) sensor_clock: Option<u32>,
    pub(crate) reconnects: u64,
}

impl Scan {
    /// Creates a scan. `values` has one value for each point of `window`, starting at
    /// `first`. Others may follow.
    pub(crate) fn new(window: Window, values: Values, first: usize, meta: ScanMeta) -> Self {
        Self { window, values, first, meta }
    }

    /// Requested window, with the steps of the sensor.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Geometry of the sensor.
    pub fn geometry(&self) -> &Geometry {
        &self.meta.geometry
    }

    /// Number of points, at least 1; the same as [`Window::points`].
    #[expect(clippy::len_without_is_empty, reason = "a scan is never empty")]
    pub fn len(&self) -> usize {
        self.window.points()
    }

    /// Distances in millimetres, in the order of their steps, or `None` where the sensor measured none.
    ///
    /// ```
    /// # use tokio_scip::{Scan, Window};
    /// let scan = Scan::builder(Window::new(383..=385)?, [900, 0, 1250]).build()?;
    /// assert_eq!(scan.distances().collect::<Vec<_>>(), [Some(900), None, Some(1250)]);
    /// assert_eq!(scan.distances().flatten().min(), Some(900));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn distances(&self) -> impl ExactSizeIterator<Item = Option<u32>> + Clone + '_ {
        self.measurements().map(Measurement::distance)
    }

    /// Values as the sensor sent them, in the order of their steps: millimetres, and among them numbers
    /// that are no distance, such as an [`ErrorCode`](crate::ErrorCode). So their least is no distance
    /// either: take [`distances`](Self::distances), or [`rays`](Self::rays), which tell them apart.
    pub fn raw_values(&self) -> impl ExactSizeIterator<Item = u32> + Clone + '_ {
        self.values().iter()
    }

    /// Strengths of the reflections, in the order of their steps, in the sensor's own unit: 18 bits. Real
    /// UST-10LX sent 370 to 1,913, and 0 for each step without a distance. `None` unless you
    /// [asked for them](crate::SensorBuilder::intensities) and the sensor has them.
    ///
    /// Zip them with [`rays`](Self::rays), because [`points`](Self::points) leaves out rays:
    ///
    /// ```
    /// # use tokio_scip::{Scan, Window};
    /// # let scan = Scan::builder(Window::new(383..=385)?, [900, 0, 1250]).intensities([370, 0, 1913]);
    /// # let scan = scan.build()?;
    /// # let mut found = Vec::new();
    /// if let Some(intensities) = scan.intensities() {
    ///     for (ray, intensity) in scan.rays().zip(intensities) {
    ///         if let Some(point) = ray.point() {
    ///             println!("{:.3} {:.3} {intensity}", point.x, point.y);
    /// #           found.push((point.range, *intensity));
    ///         }
    ///     }
    /// }
    /// # assert_eq!(found, [(0.9, 370), (1.25, 1913)]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn intensities(&self) -> Option<&[u32]> {
        self.values.intensities(self.first, self.window.points())
    }

    /// Values of the window, in the block that scans of other windows share.
    pub(crate) fn values(&self) -> Part<'_> {
        self.values.part(self.first, self.window.points())
    }

    /// Returns true if both seem to show the same revolution: all values are equal, and the time of
    /// the sensor's clock, if it tells.
    #[inline(always)]
    pub(crate) fn is_same_as(&self, other: &Self) -> bool {
        self.meta.sensor_clock == other.meta.sensor_clock && self.values() == other.values()
    }

    /// Iterates over the meanings of the values.
    pub(super) fn measurements(&self) -> impl ExactSizeIterator<Item = Measurement> + Clone + '_ {
        self.raw_values().map(move |value| self.meta.geometry.measurement(value))
    }

    /// Iterates over the ranges in metres, as REP 117 of ROS defines them: distances
    /// unchanged, `+Inf` where the object may be beyond the range (in SCIP 1.1 the values 0, 6, 16 and
    /// 4095: do not take it as free space), `NaN` for all other error codes. Never yields `-Inf`.
    pub fn ranges(&self) -> impl ExactSizeIterator<Item = f32> + Clone + '_ {
        self.measurements().map(Measurement::range)
    }

    /// Metres, a millimetre below the shortest distance: AMCL takes exactly `range_min` for none.
    pub fn range_min(&self) -> f32 {
        metres(self.meta.geometry.distances().start().saturating_sub(1))
    }

    /// Metres, a millimetre above the longest distance: `laser_geometry` drops a range that equals it.
    pub fn range_max(&self) -> f32 {
        metres(self.meta.geometry.distances().end().saturating_add(1))
    }

    /// Number of this scan in its schedule, from 0. A gap means that your consumer was too slow and
    /// missed the scans in between. 0 for a single [`Sensor::scan`](crate::Sensor::scan).
    pub fn sequence(&self) -> u64 {
        self.meta.sequence
    }

    /// How often the sensor had been found again before this scan, as in
    /// [`Stats::reconnects`](crate::Stats::reconnects). Compare it with the previous scan: a different
    /// number marks the first scan after a reconnect, even if your consumer missed scans in between.
    pub fn reconnects(&self) -> u64 {
        self.meta.reconnects
    }

    /// Returns true if all values equal the values of the previous scan. Most likely both
    /// polls fell in one revolution of the motor. SCIP 1.1 has no time stamps to prove it.
    pub fn is_repeat(&self) -> bool {
        self.meta.repeat
    }
}

fn metres(millimetres: u32) -> f32 {
    (f64::from(millimetres) / 1000.0) as f32
}

impl fmt::Debug for Scan {
    /// Writes only the values of the window: other scans may share the block.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut scan = f.debug_struct("Scan");
        scan.field("window", &self.window).field("values", &self.values());
        scan.field("meta", &self.meta).finish_non_exhaustive()
    }
}

impl PartialEq for Scan {
    fn eq(&self, other: &Self) -> bool {
        let meta = |scan: &Self| {
            let ScanMeta { sequence, stamp, lateness, postponed, repeat, .. } = scan.meta;
            let ScanMeta { scan_time, geometry, reconnects, .. } = scan.meta;
            (sequence, stamp, lateness, postponed, repeat, scan_time, geometry, reconnects)
        };
        self.window == other.window
            && meta(self) == meta(other)
            && self.values() == other.values()
            && self.intensities() == other.intensities()
    }
}

impl Eq for Scan {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Specification;

    /// Each value equals its index, plus 20.
    fn scan(window: Window) -> Scan {
        scan_of(window, (0..window.points() as u32).map(|n| 20 + n))
    }

    fn scan_of(window: Window, values: impl Iterator<Item = u32>) -> Scan {
        Scan::builder(window, values.collect::<Vec<_>>()).build().unwrap()
    }

    #[test]
    fn scans_are_equal_if_what_they_hold_is() {
        let a = scan(Window::DETECTION);
        let with = |meta: ScanMeta| Scan { meta, ..a.clone() };
        let later = a.received_at() + Duration::from_secs(1);
        let instants =
            ScanMeta { requested_at: later, first_byte_at: later, received_at: later, ..a.meta };
        assert_eq!(a, with(instants));
        assert_ne!(a, with(ScanMeta { lateness: Some(Duration::ZERO), ..a.meta }));
        assert_ne!(a, with(ScanMeta { postponed: Duration::from_secs(1), ..a.meta }));
        assert_ne!(a, with(ScanMeta { sequence: 1, ..a.meta }));
        assert_ne!(a, with(ScanMeta { reconnects: 1, ..a.meta }));
        assert_ne!(a, with(ScanMeta { repeat: true, ..a.meta }));
        assert_ne!(a, with(ScanMeta { stamp: SystemTime::UNIX_EPOCH, ..a.meta }));
        assert_ne!(a, with(ScanMeta { scan_time: Duration::ZERO, ..a.meta }));
        let wider = Specification { steps: Some(0..=768), ..Specification::default() };
        let geometry = Geometry::in_scip1(&wider);
        assert_ne!(a, with(ScanMeta { geometry, ..a.meta }));
        let other = |value| scan_of(a.window, a.raw_values().map(|one| one + value));
        assert_eq!(a, Scan { meta: a.meta, ..other(0) });
        assert_ne!(a, Scan { meta: a.meta, ..other(1) });
    }

    #[test]
    fn values_are_equal_however_they_are_stored() {
        let short = scan(Window::DETECTION);
        // Intensities may follow.
        let with = |more: &[u32]| short.raw_values().chain(more.iter().copied()).collect();
        let long = |values: Vec<u32>, first| {
            Scan::new(short.window, Values::Long(values.into()), first, short.meta)
        };
        assert_eq!(short, long(with(&[]), 0));
        assert_eq!(long(with(&[]), 0), long(with(&[7, 8]), 0));
        assert_ne!(short, long(with(&[7, 8]), 1));
        assert_eq!(format!("{short:?}"), format!("{:?}", long(with(&[7]), 0)));
        let far = long(short.raw_values().map(|value| value | 1 << 16).collect(), 0);
        assert!(short != far && long(with(&[]), 0) != far && !far.is_same_as(&short));
        assert_eq!(far.raw_values().next(), Some(65_556));
    }
}
