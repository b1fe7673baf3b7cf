//! Scans as data (feature `serde`), in the form that [`Scan`] documents.

use std::time::SystemTime;

use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};

use super::Scan;

impl Serialize for Scan {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // JSON has no infinity and no NaN.
        let finite = |range: f32| Some(range).filter(|range| range.is_finite());
        let ranges: Vec<_> = self.ranges().map(finite).collect();
        let since_1970 = |stamp: SystemTime| {
            let since = stamp.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
            since.as_micros() as f64 / 1e6
        };
        let times = self.times();
        let lateness = times.lateness.map(|lateness| lateness.as_secs_f64());
        let mut scan =
            serializer.serialize_struct("Scan", 15 + usize::from(self.intensities().is_some()))?;
        scan.serialize_field("sequence", &self.sequence())?;
        scan.serialize_field("stamp", &since_1970(times.stamp))?;
        scan.serialize_field("first_ray", &since_1970(self.first_ray_stamp()))?;
        scan.serialize_field("stamp_quality", &times.quality)?;
        scan.serialize_field("lateness", &lateness)?;
        scan.serialize_field("start", &self.window.start())?;
        scan.serialize_field("end", &self.window.end())?;
        scan.serialize_field("cluster", &self.window.cluster_count())?;
        scan.serialize_field("angle_min", &self.angle_min())?;
        scan.serialize_field("angle_increment", &self.angle_increment())?;
        scan.serialize_field("scan_time", &self.meta.scan_time.as_secs_f64())?;
        scan.serialize_field("repeat", &self.is_repeat())?;
        scan.serialize_field("reconnects", &self.reconnects())?;
        scan.serialize_field("values", &self.values())?;
        scan.serialize_field("ranges", &ranges)?;
        match self.intensities() {
            Some(intensities) => scan.serialize_field("intensities", intensities)?,
            None => scan.skip_field("intensities")?,
        }
        scan.end()
    }
}
