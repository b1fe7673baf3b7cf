//! The recordings of a build without the feature `mcap`: there are none. Its
//! `Recorded` and `Reel` have the methods of the real ones, and no value.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use tokio_scip::{Rate, Scan, Sensor, SensorBuilder, Version, Window};

use super::span::TimeSpan;
use crate::delivery::Delivery;
use crate::failure::Failure;

/// A recording, of which none can exist.
#[derive(Debug, Clone)]
pub(crate) struct Recorded(Never);

/// Private, so that no other module counts as code that cannot be reached.
#[derive(Debug, Clone, Copy)]
enum Never {}

impl Recorded {
    pub(crate) fn named(text: &str) -> Result<Option<Self>, String> {
        match text.to_ascii_lowercase().ends_with(".mcap") {
            true => Err("recordings need an urg that was built with the feature `mcap`".to_owned()),
            false => Ok(None),
        }
    }

    pub(crate) fn read_settings(&mut self) -> Result<(), Failure> {
        match self.0 {}
    }

    pub(crate) fn restrict(&mut self, _: TimeSpan) {
        match self.0 {}
    }

    pub(crate) fn window(&self) -> Option<Window> {
        match self.0 {}
    }

    pub(crate) async fn contents(&self) -> Result<Vec<(&'static str, Value, String)>, Failure> {
        match self.0 {}
    }

    pub(crate) fn set_pace(&mut self, _: Option<Rate>) -> Option<Rate> {
        match self.0 {}
    }

    pub(crate) fn start(&self, _: SensorBuilder, _: Delivery) -> Result<Sensor, Failure> {
        match self.0 {}
    }

    pub(crate) async fn version(&self) -> Result<Version, Failure> {
        match self.0 {}
    }

    pub(crate) fn record_taken(&self) {
        match self.0 {}
    }
}

/// The scans of a recording, of which none can exist.
#[derive(Debug)]
pub(crate) struct Reel(Never);

impl Reel {
    pub(crate) fn open(recorded: Recorded) -> Result<Self, Failure> {
        match recorded.0 {}
    }

    pub(crate) fn times(&self) -> Arc<[Duration]> {
        match self.0 {}
    }

    pub(crate) fn scan(&mut self, _: usize) -> Result<Scan, Failure> {
        match self.0 {}
    }
}

impl fmt::Display for Recorded {
    fn fmt(&self, _: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {}
    }
}
