//! Times of a [`Scan`]: on the monotonic clock, on the wall clock, and of each ray.

use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::{Scan, ScanMeta};

/// Basis of the time of a scan's rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum StampQuality {
    /// Arrival of this scan alone. A busy host and the frames of USB make it late.
    #[default]
    Arrival,
    /// Motor of the sensor, as the arrivals so far show it. Only on the sensor's own USB port.
    Motor,
    /// Clock of the sensor, as the driver knows it from the arrivals so far. Only the scans of a
    /// [stream](crate::guide::polling) of SCIP 2.
    SensorClock,
}

/// All times of a [`Scan`] beside its first ray and its arrival: [`Scan::times`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct ScanTimes {
    /// When the `G` was sent, on tokio's clock, which a test may pause. For a scan that a sensor of
    /// SCIP 2 sends on its own, when the driver began to wait for it. Never decreases within a stream.
    pub requested_at: Instant,
    /// The same moment as [`Scan::first_ray_stamp`], on tokio's clock. Use it to compare the scan
    /// with other events in your service, whatever happens to the wall clock. A replay has its own.
    pub first_ray_at: Instant,
    /// Wall clock when the reply's first byte arrived. The sensor sends what it has in memory, so
    /// the motor's revolution was over by then. It can jump back if the clock is set.
    ///
    /// Uses the system's clock even where you pause tokio's: only the fields of type `Instant` and
    /// [`Scan::received_at`] follow a test's time. A replay has the stamps of its recording.
    pub stamp: SystemTime,
    /// What `first_ray_at` and [`Scan::first_ray_stamp`] are based on.
    pub quality: StampQuality,
    /// How long after the end of the revolution the first byte arrived, or `None` if that is unknown
    /// ([`StampQuality::Arrival`]). Excludes the delay common to all scans.
    pub lateness: Option<Duration>,
}

impl Scan {
    /// Wall clock when the first point was measured. Use it as the time in the header of a
    /// `sensor_msgs/LaserScan`. Point `n` was measured `n * time_increment` later, see
    /// [`Point::offset`](super::Point::offset).
    ///
    /// SCIP 1.1 has no time stamps, so this one is computed. The motor turns counter-clockwise. The
    /// reply begins when a revolution ends: at the rear (-180 degrees) of a URG, where the first point
    /// was measured `1 - (angle_min + pi) / (2 pi)` of a [`scan_time`](Self::scan_time) before; at the
    /// last step of other models. For [`Window::DETECTION`](crate::Window::DETECTION) of a URG-04LX
    /// that is 83 ms, of a UST-10LX 19 ms.
    ///
    /// The revolution ended its [`lateness`](ScanTimes::lateness) before the reply arrived. Check
    /// the [`quality`](ScanTimes::quality) to see whether the lateness is known.
    ///
    /// A scan never begins before the last point of the previous scan on the same link: after a late
    /// scan, the next stamp is late, too. There are two exceptions. Scans overlap if they come faster
    /// than the motor turns. In a recording they may overlap, because each stamp is computed from that
    /// scan's arrival alone.
    ///
    /// # Accuracy
    ///
    /// If the speed of the motor is right, the true time is this one or earlier:
    ///
    /// - by a delay common to all scans, between the end of the revolution and the
    ///   arrival of the first byte: on USB one or two milliseconds. You can only find it by
    ///   a measurement with the sensor ([`guide::time`](crate::guide::time));
    /// - with [`StampQuality::Motor`], which only a sensor's own USB port has, by 0.5 ms more;
    /// - with [`StampQuality::SensorClock`] by 0.5 ms more, or later by as much, and by 2 ms if
    ///   the host's clock is being steered;
    /// - with [`StampQuality::Arrival`] by a USB frame (1 ms), and by the time that a
    ///   busy host does not run the driver. A sensor that answers at once from its memory,
    ///   as it may on RS-232, ended the revolution up to one `scan_time` earlier, on
    ///   average half of one;
    /// - for a [repeat](Self::is_repeat), by the time between the two replies: it most
    ///   likely shows the revolution of the previous scan.
    ///
    /// The sensor's angles and the phase of its replies come from the protocol's text and
    /// from captures of replies. Moving objects were not measured.
    pub fn first_ray_stamp(&self) -> SystemTime {
        let stamp = self.meta.stamp;
        let first = stamp.checked_sub(self.since_first_ray()).unwrap_or(stamp);
        first.checked_add(self.meta.postponed).unwrap_or(first)
    }

    /// When the last byte was read, on tokio's clock, which a test may pause. Never decreases from one
    /// scan to the next. The measurement is older, by the time of the reply and by up to a revolution.
    pub fn received_at(&self) -> Instant {
        self.meta.received_at
    }

    /// All other times, for a recorder or a diagnosis.
    pub fn times(&self) -> ScanTimes {
        let ScanMeta { requested_at, stamp, lateness, .. } = self.meta;
        let quality = match lateness {
            Some(_) if self.meta.sensor_clock.is_some() => StampQuality::SensorClock,
            Some(_) => StampQuality::Motor,
            None => StampQuality::Arrival,
        };
        ScanTimes { requested_at, first_ray_at: self.first_ray_at(), stamp, quality, lateness }
    }

    pub(crate) fn first_ray_at(&self) -> Instant {
        let arrived = self.meta.first_byte_at;
        let first = arrived.checked_sub(self.since_first_ray()).unwrap_or(arrived);
        first.checked_add(self.meta.postponed).unwrap_or(first)
    }

    /// Time from one point to the next: the part of the motor's revolution between them,
    /// 97.66 us per step of a URG-04LX at 600 rpm.
    pub fn time_increment(&self) -> Duration {
        Duration::from_secs_f64(self.increment())
    }

    /// Time of one revolution of the motor: measured to 0.1 % while stamps rest on the motor or the
    /// sensor's clock, otherwise the nominal time that the sensor tells, or 100 ms.
    pub fn scan_time(&self) -> Duration {
        self.meta.scan_time
    }

    /// Postpones the first ray until `earliest` or later, and returns its time, which rests on no motor.
    #[cold]
    pub(crate) fn postpone(&mut self, earliest: Instant) -> Instant {
        self.meta.lateness = None;
        self.meta.postponed = earliest.saturating_duration_since(self.first_ray_at());
        self.first_ray_at()
    }

    /// Exact time from one point to the next in seconds.
    pub(super) fn increment(&self) -> f64 {
        let steps = f64::from(self.meta.geometry.steps_per_revolution());
        self.meta.scan_time.as_secs_f64() * f64::from(self.window.cluster_count()) / steps
    }

    /// Time from the first ray to the arrival of the first byte.
    fn since_first_ray(&self) -> Duration {
        let middle =
            2 * u32::from(self.window.start()) + u32::from(self.window.first_cluster()) - 1;
        let turned = self.turn_time(self.meta.geometry.end().saturating_sub(middle));
        turned.saturating_add(self.meta.lateness.unwrap_or_default())
    }

    /// Returns how long the motor takes to turn by `half_steps`. More than a revolution count as one.
    pub(crate) fn turn_time(&self, half_steps: u32) -> Duration {
        let revolution = 2 * u64::from(self.meta.geometry.steps_per_revolution());
        let half_steps = u64::from(half_steps).min(revolution);
        // Exact: u64 nanoseconds overflow after 584 years.
        let nanos = self.meta.scan_time.as_nanos() as u64;
        Duration::from_nanos(nanos.saturating_mul(half_steps) / revolution)
    }
}
