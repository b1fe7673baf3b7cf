//! A scan for eyes: a line a point, and a summary below, where the terminal
//! ends up.

use std::collections::BTreeMap;
use std::fmt::Write;

use tokio_scip::{Measurement, Point, Scan, Version};

/// The whole text, with who measured.
pub(crate) fn table(scan: &Scan, version: &Version) -> String {
    let mut text = String::from("step  direction   distance\n");
    let cluster = scan.window().cluster_count();
    let steps = (scan.window().start().number()..).step_by(usize::from(cluster));
    for ((step, angle), measurement) in steps.zip(scan.angles()).zip(scan.measurements()) {
        // Writing to a string does not fail.
        let _ = write!(text, "{step:>4} {:>8.2}°  ", angle.to_degrees());
        let _ = match measurement {
            Measurement::Distance(mm) => {
                writeln!(text, "{:>3}.{:03} m", mm / 1000, mm % 1000)
            }
            other => writeln!(text, "        - {}", reason(other)),
        };
    }
    text.push('\n');
    text.push_str(&summary(scan, version));
    text
}

/// Who measured, what, and how it looks on the whole.
fn summary(scan: &Scan, version: &Version) -> String {
    let mut text = format!("{} {}: {}\n", version.product, version.serial_number, scan.window());
    let found = scan.points().count();
    let _ = writeln!(text, "{found} of {} points have a distance", scan.len());
    let by_range = |a: &Point, b: &Point| a.range.total_cmp(&b.range);
    if let (Some(near), Some(far)) =
        (scan.points().min_by(by_range), scan.points().max_by(by_range))
    {
        let _ = writeln!(text, "  nearest  {}", place(near));
        let _ = writeln!(text, "  farthest {}", place(far));
    }
    let mut codes = BTreeMap::<_, usize>::new();
    for measurement in scan.measurements() {
        if measurement.distance().is_none() {
            *codes.entry(measurement.value()).or_default() += 1;
        }
    }
    if !codes.is_empty() {
        let _ = writeln!(text, "the others, by what the sensor says");
    }
    for (value, count) in codes {
        let _ = writeln!(text, "  {count:>4} x {}", reason(Measurement::from_value(value)));
    }
    text
}

fn place(point: Point) -> String {
    format!("{:.3} m at {:.2}°", point.range, point.angle.to_degrees())
}

/// Why there is no distance.
fn reason(measurement: Measurement) -> String {
    match measurement {
        Measurement::Error(code) => code.to_string(),
        _ => "value 4095: saturated".to_owned(),
    }
}
