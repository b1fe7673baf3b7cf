//! A scan in figures: its distances, the nearest and the farthest point, and the
//! values that are no distance. Table, pictures and terminal all show these.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use tokio_scip::{Measurement, Point, Scan};

use super::missing::MissingKind;

/// The figures of one scan.
#[derive(Debug, Clone, Default)]
pub(crate) struct ScanSummary {
    pub(crate) points: usize,
    /// The number of points that have a distance.
    pub(crate) distances: usize,
    pub(crate) nearest: Option<Point>,
    pub(crate) farthest: Option<Point>,
    /// The values that are no distance, each with its number of points.
    missing: BTreeMap<u16, usize>,
}

impl ScanSummary {
    pub(crate) fn of(scan: &Scan) -> Self {
        let mut missing = BTreeMap::new();
        for measurement in scan.measurements().filter(|one| one.distance().is_none()) {
            *missing.entry(measurement.value()).or_default() += 1;
        }
        Self {
            points: scan.len(),
            distances: scan.len() - missing.values().sum::<usize>(),
            nearest: nearest(scan),
            farthest: scan.points().max_by(by_range),
            missing,
        }
    }

    /// Returns the measurements without a distance, each with its number of
    /// points.
    pub(crate) fn missing(&self) -> impl Iterator<Item = (Measurement, usize)> {
        self.missing.iter().map(|(value, points)| (Measurement::from_value(*value), *points))
    }

    /// Returns those of one kind.
    pub(crate) fn missing_of(
        &self,
        kind: MissingKind,
    ) -> impl Iterator<Item = (Measurement, usize)> {
        self.missing().filter(move |(measurement, _)| MissingKind::of(*measurement) == Some(kind))
    }

    /// Returns the number of points without a distance for this reason.
    pub(crate) fn count(&self, kind: MissingKind) -> usize {
        self.missing_of(kind).map(|(_, points)| points).sum()
    }
}

/// Returns the nearest point of a scan, if it has any.
pub(crate) fn nearest(scan: &Scan) -> Option<Point> {
    scan.points().min_by(by_range)
}

fn by_range(a: &Point, b: &Point) -> Ordering {
    a.range.total_cmp(&b.range)
}
