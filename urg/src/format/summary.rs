//! A scan as one short line, for a terminal.

use std::fmt::Write;

use tokio_scip::{Point, Scan};

use crate::plot::missing::MissingKind;
use crate::plot::summary::ScanSummary;

/// Formats the line. `rate` is in scans a second, or `None` if it is not known yet.
pub(crate) fn line(scan: &Scan, rate: Option<f64>) -> String {
    let summary = ScanSummary::from_scan(scan);
    let mut line = format!("{:>5}", scan.sequence());
    // Writing to a `String` is infallible.
    let _ = match rate {
        None => write!(line, "     - Hz"),
        Some(rate) => write!(line, "  {rate:>4.1} Hz"),
    };
    let _ = write!(line, "  {:>3}/{} points", summary.distances, summary.points);
    let _ = match summary.nearest {
        Some(Point { range, angle, .. }) => {
            write!(line, "  nearest {range:.3} m {:>4.0}°", angle.to_degrees())
        }
        None => write!(line, "  nearest -            "),
    };
    let [far, weak, none] = MissingKind::ALL;
    for (kind, before) in [(far, "  "), (weak, " "), (none, " ")] {
        let _ = write!(line, "{before}{} {:>3}", kind.name(), summary.count(kind));
    }
    line.push('\n');
    line
}

#[cfg(test)]
mod tests {
    use tokio_scip::Window;

    use super::*;

    fn summary(value: u32) -> String {
        let mut values = vec![value; Window::DETECTION.steps()];
        if value != 7 {
            values[340] = 412;
        }
        let scan = Scan::builder(Window::DETECTION, values).build().unwrap();
        line(&scan, (value != 7).then_some(10.0))
    }

    #[test]
    fn a_scan_is_one_line_of_80_columns() {
        assert_eq!(
            summary(0),
            "    0  10.0 Hz    1/682 points  nearest 0.412 m    0°  far 681 weak   0 none   0\n"
        );
        assert_eq!(
            summary(7),
            "    0     - Hz    0/682 points  nearest -              far   0 weak   0 none 682\n"
        );
        assert!(summary(4000).trim_end().chars().count() <= 80);
    }
}
