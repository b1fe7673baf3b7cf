//! Meanings of the values that are no distance, for the page: they depend on the model.

use parking_lot::Mutex;
use serde_json::{Map, Value, json};
use tokio_scip::{Geometry, Measurement};

use crate::plot::missing::MissingKind;

/// Largest value of a sensor, plus 1: SCIP 2 has 18 bits.
const VALUES: u32 = 1 << 18;

/// Error codes of a source's sensor, each with its kind and meaning. Kept, because finding them takes
/// as long as a scan does.
#[derive(Debug, Default)]
pub(super) struct ErrorCodes(Mutex<Option<(Geometry, Value)>>);

impl ErrorCodes {
    pub(super) fn of(&self, geometry: &Geometry) -> Value {
        let mut found = self.0.lock();
        if found.as_ref().is_none_or(|(other, _)| other != geometry) {
            *found = Some((*geometry, codes(geometry)));
        }
        found.as_ref().map(|(_, codes)| codes.clone()).unwrap_or_default()
    }
}

fn codes(geometry: &Geometry) -> Value {
    let code = |value| match geometry.measurement(value) {
        measurement @ Measurement::Error(code) => {
            let kind = MissingKind::from_measurement(measurement).map(MissingKind::name);
            Some((value.to_string(), json!({ "kind": kind, "meaning": code.meaning() })))
        }
        _ => None,
    };
    (0..VALUES).filter_map(code).collect::<Map<_, _>>().into()
}

#[cfg(test)]
mod tests {
    use tokio_scip::{Sensor, Window};
    use urg_emulator::{Emulator, Model};

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn each_model_has_its_codes() {
        let known = ErrorCodes::default();
        for (model, code, kind, count) in [
            (Model::Urg04lx, "3", "weak", 20),
            (Model::Urg04lxUg01, "3", "none", 20),
            (Model::Ust10lx, "65533", "far", 21),
            (Model::Utm30lx, "1", "far", 23),
        ] {
            let emulator = Emulator::builder().model(model).build();
            let sensor = Sensor::builder().connect(emulator).await.unwrap();
            let scan = sensor.scan(Window::DETECTION).await.unwrap();
            let codes = known.of(scan.geometry());
            assert_eq!(codes[code]["kind"], kind, "{model:?} {codes}");
            assert_eq!(codes.as_object().unwrap().len(), count, "{model:?} {codes}");
        }
    }
}
