//! Table of a scan: one line per point, then a summary, which stays visible on the terminal.

use std::fmt::Write;

use tokio_scip::{Measurement, Point, Scan, Version};

use crate::plot::summary::ScanSummary;

/// Formats the table, with the sensor's name in the summary.
pub(crate) fn table(scan: &Scan, version: &Version) -> String {
    let intensities = scan.intensities();
    let heading = if intensities.is_some() { "  intensity" } else { "" };
    let mut text = format!("step  direction{heading}   distance\n");
    let mut intensities = intensities.unwrap_or_default().iter();
    for ray in scan.rays() {
        // Writing to a `String` is infallible.
        let _ = write!(text, "{:>4} {:>8.2}°  ", ray.step, ray.angle.to_degrees());
        if let Some(intensity) = intensities.next() {
            let _ = write!(text, "{intensity:>9}  ");
        }
        let _ = match ray.measurement {
            Measurement::Distance(mm) => writeln!(text, "{:>3}.{:03} m", mm / 1000, mm % 1000),
            other => writeln!(text, "        - {}", reason(other)),
        };
    }
    text.push('\n');
    text.push_str(&summary(scan, version));
    text
}

fn summary(scan: &Scan, version: &Version) -> String {
    let mut text = format!("{} {}: {}\n", version.product, version.serial_number, scan.window());
    let figures = ScanSummary::from_scan(scan);
    let _ = writeln!(text, "{} of {} points have a distance", figures.distances, figures.points);
    if let (Some(near), Some(far)) = (figures.nearest, figures.farthest) {
        let _ = writeln!(text, "  nearest  {}", place(near));
        let _ = writeln!(text, "  farthest {}", place(far));
    }
    if figures.distances < figures.points {
        let _ = writeln!(text, "the others, by the reason that the sensor reports");
    }
    for (measurement, points) in figures.missing() {
        let _ = writeln!(text, "  {points:>4} x {}", reason(measurement));
    }
    text
}

fn place(point: Point) -> String {
    format!("{:.3} m at {:.2}°", point.range, point.angle.to_degrees())
}

fn reason(measurement: Measurement) -> String {
    match measurement {
        Measurement::Error(code) => code.to_string(),
        other => format!("value {}: saturated", other.value()),
    }
}
