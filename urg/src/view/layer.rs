//! [`Layer`]: one sensor in the picture, with its scans, state and statistics.

use tokio::time::Instant;
use tokio_scip::scan::Pose;
use tokio_scip::stats::ScheduleStats;
use tokio_scip::{Geometry, Rate, Scan, State, Stats, Version, Window};

use crate::picture::PictureSource;
use crate::plot::{Place, Reach};
use crate::stream::jitter::RecentTimes;
use crate::stream::rate_watch::schedule;

/// Sensor, or playback of a recording, as shown in the picture.
#[derive(Debug)]
pub(crate) struct Layer {
    /// Set if the user named the sensor.
    pub(crate) name: Option<String>,
    pub(crate) pose: Pose,
    /// Port, as the user wrote it.
    pub(crate) port: String,
    /// Name of the line if it has no baud rate.
    pub(crate) line: &'static str,
    /// `None` until the sensor is open.
    pub(crate) version: Option<Version>,
    pub(crate) rate: Rate,
    /// Requested window. `scan` may still have the previous window.
    pub(crate) window: Window,
    pub(crate) scan: Option<Scan>,
    pub(crate) reach: Reach,
    pub(crate) state: State,
    pub(crate) stats: Stats,
    pub(crate) times: RecentTimes,
}

impl Layer {
    pub(crate) fn new(source: PictureSource) -> Self {
        let PictureSource { name, port, pose, window, rate } = source;
        Self {
            name,
            pose,
            port: port.to_string(),
            line: port.line(),
            version: None,
            rate,
            window,
            scan: None,
            reach: Reach::new(),
            state: State::Closed { error: None },
            stats: Stats::default(),
            times: RecentTimes::default(),
        }
    }

    /// Converts a measured point to the common frame. `range` is in metres, `angle` in
    /// radians counter-clockwise from the sensor's front.
    pub(crate) fn place(&self, range: f64, angle: f64) -> Place {
        let (x, y) = self.pose.transform(range * angle.cos(), range * angle.sin());
        Place::from_point(x, y)
    }

    /// Geometry of the sensor, until the first scan that of a URG-04LX.
    pub(crate) fn geometry(&self) -> &Geometry {
        self.scan.as_ref().map_or(&Geometry::URG_04LX, Scan::geometry)
    }

    /// Checks whether the shown scan has intensities, which its points then show as shades.
    pub(crate) fn has_intensities(&self) -> bool {
        self.scan.as_ref().is_some_and(|scan| scan.intensities().is_some())
    }

    /// Window of the shown scan, else the requested window.
    pub(crate) fn shown_window(&self) -> Window {
        self.scan.as_ref().map_or(self.window, Scan::window)
    }

    pub(crate) fn scanned(&mut self, scan: Scan) {
        self.times.push(scan.received_at());
        self.show(scan.received_at(), scan);
    }

    pub(crate) fn show(&mut self, now: Instant, scan: Scan) {
        self.reach.follow(&scan, now);
        self.scan = Some(scan);
    }

    /// Statistics of the schedule for the requested window.
    pub(crate) fn pace(&self) -> Option<&ScheduleStats> {
        schedule(&self.stats, self.window)
    }

    /// Measured rate in scans a second, from the second scan on.
    pub(crate) fn reached(&self) -> Option<f64> {
        self.pace().and_then(|pace| pace.reached).or_else(|| self.times.rate())
    }

    pub(crate) fn is_connected(&self) -> bool {
        matches!(self.state, State::Connected { .. })
    }

    /// Name of the sensor, or else its port.
    pub(crate) fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.port)
    }
}
