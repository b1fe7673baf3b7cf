//! Scans as data (feature `serde`), in the form that [`Scan`] documents.

use std::collections::BTreeSet;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::ser::{Serialize, SerializeStruct, Serializer};

use crate::{Measurement, Scan};

impl Serialize for Scan {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // JSON has no infinity and no NaN.
        let ranges: Vec<_> = self.ranges().map(|r| r.is_finite().then_some(r)).collect();
        let beyond = self.measurements().filter(|measurement| measurement.range().is_infinite());
        let beyond: BTreeSet<u32> = beyond.map(Measurement::value).collect();
        let since_1970 = |stamp: SystemTime| {
            stamp.duration_since(UNIX_EPOCH).unwrap_or_default().as_micros() as f64 / 1e6
        };
        let times = self.times();
        let mut scan =
            serializer.serialize_struct("Scan", 18 + usize::from(self.intensities().is_some()))?;
        scan.serialize_field("sequence", &self.sequence())?;
        scan.serialize_field("stamp", &since_1970(times.stamp))?;
        scan.serialize_field("first_ray", &since_1970(self.first_ray_stamp()))?;
        scan.serialize_field("stamp_quality", &times.quality)?;
        scan.serialize_field("lateness", &times.lateness.map(|time| time.as_secs_f64()))?;
        scan.serialize_field("start", &self.window.start())?;
        scan.serialize_field("end", &self.window.end())?;
        scan.serialize_field("cluster", &self.window.cluster_count())?;
        scan.serialize_field("angle_min", &self.angle_min())?;
        scan.serialize_field("angle_increment", &self.angle_increment())?;
        scan.serialize_field("scan_time", &self.meta.scan_time.as_secs_f64())?;
        scan.serialize_field("range_min", &self.range_min())?;
        scan.serialize_field("range_max", &self.range_max())?;
        scan.serialize_field("repeat", &self.is_repeat())?;
        scan.serialize_field("reconnects", &self.reconnects())?;
        scan.serialize_field("beyond", &beyond)?;
        scan.serialize_field("values", &self.values())?;
        scan.serialize_field("ranges", &ranges)?;
        if let Some(intensities) = self.intensities() {
            scan.serialize_field("intensities", intensities)?;
        }
        scan.end()
    }
}
