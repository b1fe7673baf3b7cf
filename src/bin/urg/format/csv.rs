//! CSV in long form: one row for each point, for spreadsheets and data frames.

use std::fmt::Write;
use std::time::SystemTime;

use tokio_scip::{Measurement, Scan};

/// The columns to write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Columns {
    /// Angle and range.
    Polar,
    /// These, and x and y.
    Cartesian,
}

impl Columns {
    /// Returns the first line, with the names of the columns.
    pub(crate) const fn header(self) -> &'static str {
        match self {
            Self::Polar => "sequence,stamp,step,angle,range,code\n",
            Self::Cartesian => "sequence,stamp,step,angle,range,code,x,y\n",
        }
    }
}

/// The contents of the columns, for help texts.
pub(crate) const COLUMNS: &str = "\
CSV has one row a point, with the columns
  sequence  number of the scan; a gap means that scans were missed
  stamp     seconds since 1970, when the reply began to arrive
  step      the first step of the point, 0 to 768
  angle     its direction in radians, counter-clockwise from the front
  range     metres; empty where there is no distance
  code      empty where there is a distance; else the error code, 0 to 19, or
            4095 for a saturated value
csv-xy adds
  x, y      metres from the sensor, x to the front, y to the left; empty where
            there is no distance";

/// Returns a row for each point of `scan`.
pub(crate) fn rows(scan: &Scan, columns: Columns) -> String {
    let stamp = scan.stamp().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let stamp = format!("{}.{:06}", stamp.as_secs(), stamp.subsec_micros());
    let steps =
        (scan.window().start().number()..).step_by(usize::from(scan.window().cluster_count()));
    let mut rows = String::with_capacity(scan.len() * 48);
    for ((step, angle), measurement) in steps.zip(scan.angles()).zip(scan.measurements()) {
        // Writing to a string does not fail.
        let _ = write!(rows, "{},{stamp},{step},{angle:.6},", scan.sequence());
        let _ = match measurement {
            Measurement::Distance(mm) => write!(rows, "{}.{:03},", mm / 1000, mm % 1000),
            other => write!(rows, ",{}", other.value()),
        };
        if columns == Columns::Cartesian {
            let _ = match measurement.distance() {
                Some(mm) => {
                    let range = f32::from(mm) / 1000.0;
                    write!(rows, ",{:.3},{:.3}", range * angle.cos(), range * angle.sin())
                }
                None => write!(rows, ",,"),
            };
        }
        rows.push('\n');
    }
    rows
}
