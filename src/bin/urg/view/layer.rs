//! [`Layer`]: one sensor of the picture, with its scans, its state and its figures.

use std::collections::VecDeque;

use tokio_scip::{Rate, Scan, ScheduleStats, State, Stats, Version, Window};

use crate::plot::pose::Pose;

/// The trail has no more scans than this.
const MAX_TRAIL_SCANS: usize = 10;

/// A sensor, or the playback of a recording, as it is shown.
#[derive(Debug)]
pub(crate) struct Layer {
    /// Its name, if the user gave it one.
    pub(crate) name: Option<String>,
    pub(crate) pose: Pose,
    /// The port as the user named it.
    pub(crate) port: String,
    /// `None` until the sensor is open.
    pub(crate) version: Option<Version>,
    pub(crate) rate: Rate,
    /// The requested window. The scan shown may be of the previous one.
    pub(crate) window: Window,
    pub(crate) scan: Option<Scan>,
    /// Older scans, the oldest one first.
    pub(crate) trail: VecDeque<Scan>,
    /// Set unless the laser was switched off here: the sensor does not report it.
    pub(crate) laser: bool,
    pub(crate) state: State,
    pub(crate) stats: Stats,
}

impl Layer {
    /// Creates a layer without a scan.
    pub(crate) fn new(name: Option<String>, pose: Pose, port: String, window: Window) -> Self {
        Self {
            name,
            pose,
            port,
            version: None,
            rate: Rate::MAX,
            window,
            scan: None,
            trail: VecDeque::new(),
            laser: true,
            state: State::Closed { error: None },
            stats: Stats::default(),
        }
    }

    /// Takes a new scan; the one before it becomes a part of the trail.
    pub(crate) fn scanned(&mut self, scan: Scan) {
        // Those of another window would not fit the picture.
        self.trail.retain(|older| older.window() == scan.window());
        if let Some(older) = self.scan.replace(scan) {
            self.trail.push_back(older);
        }
        while self.trail.len() > MAX_TRAIL_SCANS {
            self.trail.pop_front();
        }
    }

    /// Returns the figures of the schedule that is shown.
    pub(crate) fn pace(&self) -> Option<&ScheduleStats> {
        self.stats.schedules.iter().find(|schedule| schedule.window == self.window)
    }

    /// Returns the rate that is reached, in scans a second; `None` until there is
    /// something to average.
    pub(crate) fn reached(&self) -> Option<f64> {
        self.pace().map(|pace| pace.reached).filter(|rate| *rate > 0.0)
    }

    /// Returns whether the link to the sensor works.
    pub(crate) fn is_connected(&self) -> bool {
        matches!(self.state, State::Connected { .. })
    }

    /// Returns whether scans of now are shown: the sensor is connected, and its laser was
    /// not switched off here.
    pub(crate) fn is_measuring(&self) -> bool {
        self.is_connected() && self.laser
    }

    /// Returns its name, or else its port.
    pub(crate) fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.port)
    }
}
