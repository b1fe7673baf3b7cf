//! [`Layer`]: one sensor in the picture, with its scans, state and statistics.

use std::collections::VecDeque;

use tokio_scip::scan::Pose;
use tokio_scip::stats::ScheduleStats;
use tokio_scip::{Rate, Scan, State, Stats, Version, Window};

use crate::picture::PictureSource;
use crate::plot::Place;
use crate::stream::rate_watch::schedule;

/// Maximum length of the trail, in scans.
const MAX_TRAIL_SCANS: usize = 10;

/// Sensor, or playback of a recording, as shown in the picture.
#[derive(Debug)]
pub(crate) struct Layer {
    /// Set if the user named the sensor.
    pub(crate) name: Option<String>,
    pub(crate) pose: Pose,
    /// Port, as the user wrote it.
    pub(crate) port: String,
    /// `None` until the sensor is open.
    pub(crate) version: Option<Version>,
    pub(crate) rate: Rate,
    /// Requested window. `scan` may still have the previous window.
    pub(crate) window: Window,
    pub(crate) scan: Option<Scan>,
    /// Older scans, oldest first.
    pub(crate) trail: VecDeque<Scan>,
    /// False after this program has switched the laser off. The sensor does not report it.
    pub(crate) laser: bool,
    pub(crate) state: State,
    pub(crate) stats: Stats,
}

impl Layer {
    pub(crate) fn new(source: PictureSource) -> Self {
        let PictureSource { name, port, pose, window, rate } = source;
        Self {
            name,
            pose,
            port: port.to_string(),
            version: None,
            rate,
            window,
            scan: None,
            trail: VecDeque::new(),
            laser: true,
            state: State::Closed { error: None },
            stats: Stats::default(),
        }
    }

    /// Converts a measured point to the common frame. `range` is in metres, `angle` in
    /// radians counter-clockwise from the sensor's front.
    pub(crate) fn place(&self, range: f64, angle: f64) -> Place {
        let (x, y) = self.pose.transform(range * angle.cos(), range * angle.sin());
        Place::from_point(x, y)
    }

    /// Shows a new scan and moves the previous scan to the trail.
    pub(crate) fn scanned(&mut self, scan: Scan) {
        // Scans of another window would not fit the picture.
        self.trail.retain(|older| older.window() == scan.window());
        if let Some(older) = self.scan.replace(scan) {
            self.trail.push_back(older);
        }
        while self.trail.len() > MAX_TRAIL_SCANS {
            self.trail.pop_front();
        }
    }

    /// Statistics of the schedule for the requested window.
    pub(crate) fn pace(&self) -> Option<&ScheduleStats> {
        schedule(&self.stats, self.window)
    }

    /// Measured rate in scans a second; `None` before there are enough scans to average.
    pub(crate) fn reached(&self) -> Option<f64> {
        self.pace().and_then(|pace| pace.reached)
    }

    pub(crate) fn is_connected(&self) -> bool {
        matches!(self.state, State::Connected { .. })
    }

    /// Checks whether new scans can arrive: the sensor is connected and its laser is on.
    pub(crate) fn is_measuring(&self) -> bool {
        self.is_connected() && self.laser
    }

    /// Name of the sensor, or else its port.
    pub(crate) fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.port)
    }
}
