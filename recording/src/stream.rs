//! [`Stream`]: the sensor of recorded scans, and their window.

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio_scip::protocol::scip2::Parameters;
use tokio_scip::{Geometry, Window};

/// What a recording tells about a sensor: its reply to `PP`, or `None` for a URG-04LX in SCIP 1.1.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Model(pub(super) Option<Arc<Parameters>>);

impl Model {
    pub(super) fn geometry(&self) -> Geometry {
        self.0.as_deref().map_or(Geometry::URG_04LX, Parameters::geometry)
    }

    /// Returns true if both speak one protocol and have the same directions. A message tells no more of its sensor.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let key = |model: &Self| {
            let geometry = model.geometry();
            (model.0.is_some(), geometry.steps_per_revolution(), geometry.degrees(0).to_bits())
        };
        key(self) == key(other)
    }

    /// Creates the window of these steps, if the sensor measures them.
    pub(super) fn window(&self, start: u16, end: u16, cluster_count: u8) -> Option<Window> {
        let window = Window::new(start..=end).ok()?.with_cluster_count(cluster_count).ok()?;
        window.resolve(&self.geometry()).ok()
    }
}

impl From<Parameters> for Model {
    fn from(parameters: Parameters) -> Self {
        Self(Some(Arc::new(parameters)))
    }
}

/// Scans of one window of a sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Stream {
    pub(super) model: Model,
    pub(super) window: Window,
}

impl Stream {
    pub(super) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<Self> {
        // The keys of `PP`, and no others, are in capitals.
        let told = metadata.iter().filter(|(key, _)| key.starts_with(char::is_uppercase));
        let model = Parameters::from_pairs(told.map(|(key, value)| (&**key, &**value)));
        let model = model.map(Model::from).unwrap_or_default();
        let number = |key| metadata.get(key)?.parse::<u16>().ok();
        let cluster_count = number("cluster")?.try_into().ok()?;
        let window = model.window(number("start")?, number("end")?, cluster_count)?;
        Some(Self { model, window })
    }
}
