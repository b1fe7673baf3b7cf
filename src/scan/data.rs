//! Scans as data (feature `serde`), in the form that [`Scan`] documents.

use std::time::{Duration, SystemTime};

use serde::de::Error as _;
use serde::ser::SerializeStruct;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::builder::REVOLUTION;
use super::{Scan, ScanMeta};
use crate::protocol::Window;

/// Seconds since 1970 that every clock can count.
const MAX_STAMP: f64 = 1e11;

impl Serialize for Scan {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // JSON has no infinity and no NaN.
        let finite = |range: f32| Some(range).filter(|range| range.is_finite());
        let ranges: Vec<_> = self.ranges().map(finite).collect();
        let since_1970 = |stamp: SystemTime| {
            let since = stamp.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
            since.as_micros() as f64 / 1e6
        };
        let lateness = self.lateness().map(|lateness| lateness.as_secs_f64());
        let mut scan = serializer.serialize_struct("Scan", 15)?;
        scan.serialize_field("sequence", &self.sequence())?;
        scan.serialize_field("stamp", &since_1970(self.stamp()))?;
        scan.serialize_field("first_ray", &since_1970(self.first_ray_stamp()))?;
        scan.serialize_field("stamp_quality", &self.stamp_quality())?;
        scan.serialize_field("lateness", &lateness)?;
        scan.serialize_field("start", &self.window.start())?;
        scan.serialize_field("end", &self.window.end())?;
        scan.serialize_field("cluster", &self.window.cluster_count())?;
        scan.serialize_field("angle_min", &self.angle_min())?;
        scan.serialize_field("angle_increment", &self.angle_increment())?;
        scan.serialize_field("scan_time", &self.meta.scan_time.as_secs_f64())?;
        scan.serialize_field("repeat", &self.is_repeat())?;
        scan.serialize_field("reconnects", &self.reconnects())?;
        scan.serialize_field("values", self.values())?;
        scan.serialize_field("ranges", &ranges)?;
        scan.end()
    }
}

/// Scan as read from data.
#[derive(Deserialize)]
#[serde(rename = "Scan")]
struct ScanFields {
    #[serde(default)]
    sequence: u64,
    #[serde(default)]
    stamp: f64,
    lateness: Option<f64>,
    start: u16,
    end: u16,
    #[serde(default = "one")]
    cluster: u8,
    #[serde(default = "revolution")]
    scan_time: f64,
    #[serde(default)]
    repeat: bool,
    #[serde(default)]
    reconnects: u64,
    values: Vec<u16>,
}

fn one() -> u8 {
    1
}

fn revolution() -> f64 {
    REVOLUTION.as_secs_f64()
}

impl<'de> Deserialize<'de> for Scan {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let fields = ScanFields::deserialize(deserializer)?;
        let window = Window::new(fields.start..=fields.end)
            .and_then(|window| window.with_cluster_count(fields.cluster))
            .map_err(D::Error::custom)?;
        // Seconds as a number are exact only to the microsecond.
        let micros = Some(fields.stamp).filter(|stamp| (0.0..=MAX_STAMP).contains(stamp));
        let micros = micros.map(|stamp| Duration::from_micros((stamp * 1e6).round() as u64));
        let stamp = micros.and_then(|micros| SystemTime::UNIX_EPOCH.checked_add(micros));
        let invalid = || D::Error::custom("invalid stamp: expected seconds since 1970");
        let stamp = stamp.ok_or_else(invalid)?;
        let scan_time = Duration::try_from_secs_f64(fields.scan_time).map_err(D::Error::custom)?;
        let lateness = fields.lateness.map(Duration::try_from_secs_f64).transpose();
        let mut builder = Self::builder(window, fields.values);
        builder.meta = ScanMeta {
            sequence: fields.sequence,
            stamp,
            lateness: lateness.map_err(D::Error::custom)?,
            repeat: fields.repeat,
            scan_time,
            reconnects: fields.reconnects,
            ..builder.meta
        };
        builder.build().map_err(D::Error::custom)
    }
}
