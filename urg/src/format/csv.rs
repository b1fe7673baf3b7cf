//! CSV in long form: one row per point, for spreadsheets and data frames.

use std::fmt::Write;
use std::time::SystemTime;

use tokio_scip::scan::Ray;
use tokio_scip::{Measurement, Point, Scan};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Columns {
    pub(crate) intensity: bool,
    /// True if there are x and y.
    pub(crate) cartesian: bool,
}

impl Columns {
    pub(crate) fn header(self) -> String {
        let intensity = if self.intensity { "intensity," } else { "" };
        let cartesian = if self.cartesian { ",x,y" } else { "" };
        format!("sequence,stamp,time,step,angle,range,{intensity}code{cartesian}\n")
    }
}

/// Description of the columns, for help texts.
pub(crate) const COLUMNS: &str = "\
CSV has one row a point, with the columns
  sequence  number of the scan; a gap means that scans were missed
  stamp     seconds since 1970, when the reply began to arrive
  time      seconds since 1970, when the point was measured
  step      the first step of the point, as the model counts
  angle     its direction in radians, counter-clockwise from the front
  range     metres; empty where there is no distance
  intensity with --intensity: strength of the reflection, in the sensor's own
            unit; empty if the sensor has none
  code      empty where there is a distance; else the value that the sensor
            sent: an error code of its model, or one above all distances
csv-xy adds
  x, y      metres from the sensor, x to the front, y to the left; empty where
            there is no distance";

pub(crate) fn rows(scan: &Scan, columns: Columns) -> String {
    let since_1970 = |time: SystemTime| time.duration_since(SystemTime::UNIX_EPOCH);
    let stamp = since_1970(scan.times().stamp).unwrap_or_default();
    let stamp = format!("{}.{:06}", stamp.as_secs(), stamp.subsec_micros());
    let mut time = since_1970(scan.first_ray_stamp()).unwrap_or_default();
    let mut rows = String::with_capacity(scan.len() * 64);
    let mut intensities = scan.intensities().unwrap_or_default().iter();
    for ray in scan.rays() {
        let Ray { step, angle, measurement, .. } = ray;
        // Writing to a `String` is infallible.
        let _ = write!(rows, "{},{stamp},", scan.sequence());
        let _ = write!(rows, "{}.{:06},", time.as_secs(), time.subsec_micros());
        time = time.saturating_add(scan.time_increment());
        let _ = write!(rows, "{step},{angle:.6},");
        if let Measurement::Distance(mm) = measurement {
            let _ = write!(rows, "{}.{:03}", mm / 1000, mm % 1000);
        }
        rows.push(',');
        if columns.intensity {
            if let Some(intensity) = intensities.next() {
                let _ = write!(rows, "{intensity}");
            }
            rows.push(',');
        }
        if measurement.distance().is_none() {
            let _ = write!(rows, "{}", measurement.value());
        }
        if columns.cartesian {
            let _ = match ray.point() {
                Some(Point { x, y, .. }) => write!(rows, ",{x:.3},{y:.3}"),
                None => write!(rows, ",,"),
            };
        }
        rows.push('\n');
    }
    rows
}
