//! The recordings of a build without the feature `mcap`: there are none. Its
//! `Recorded` has the methods of the real one, and no value.

use std::fmt;

use serde_json::Value;
use tokio_scip::{Rate, Sensor, SensorBuilder, Window};

use crate::delivery::Delivery;
use crate::failure::Failure;

/// A recording, of which none can exist.
#[derive(Debug, Clone)]
pub(crate) enum Recorded {}

impl Recorded {
    pub(crate) fn named(text: &str) -> Result<Option<Self>, String> {
        match text.to_ascii_lowercase().ends_with(".mcap") {
            true => Err("recordings need an urg that was built with the feature `mcap`".to_owned()),
            false => Ok(None),
        }
    }

    pub(crate) fn read_settings(&mut self) -> Result<(), Failure> {
        match *self {}
    }

    pub(crate) fn window(&self) -> Option<Window> {
        match *self {}
    }

    pub(crate) async fn contents(&self) -> Result<Vec<(&'static str, Value, String)>, Failure> {
        match *self {}
    }

    pub(crate) fn set_pace(&mut self, _: Option<Rate>) -> Option<Rate> {
        match *self {}
    }

    pub(crate) fn start(&self, _: SensorBuilder, _: Delivery) -> Result<Sensor, Failure> {
        match *self {}
    }

    pub(crate) fn record_taken(&self) {
        match *self {}
    }
}

impl fmt::Display for Recorded {
    fn fmt(&self, _: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {}
    }
}
