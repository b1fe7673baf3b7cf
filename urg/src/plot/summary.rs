//! Summary of a scan: number of distances, nearest and farthest point, and values without a
//! distance. The table, the pictures and the terminal show it.

use std::collections::BTreeMap;

use tokio_scip::{Measurement, Point, Scan};

use super::missing::MissingKind;

#[derive(Debug, Clone, Default)]
pub(crate) struct ScanSummary {
    pub(crate) points: usize,
    /// Number of points with a distance.
    pub(crate) distances: usize,
    pub(crate) nearest: Option<Point>,
    pub(crate) farthest: Option<Point>,
    /// Values without a distance, each with its number of points.
    missing: BTreeMap<u32, (Measurement, usize)>,
}

impl ScanSummary {
    pub(crate) fn from_scan(scan: &Scan) -> Self {
        let mut missing = BTreeMap::new();
        let measurements = scan.rays().map(|ray| ray.measurement);
        for measurement in measurements.filter(|one| one.distance().is_none()) {
            missing.entry(measurement.value()).or_insert((measurement, 0)).1 += 1;
        }
        Self {
            points: scan.len(),
            distances: scan.len() - missing.values().map(|(_, points)| points).sum::<usize>(),
            nearest: scan.nearest(),
            farthest: scan.points().max_by(|a, b| a.range.total_cmp(&b.range)),
            missing,
        }
    }

    /// Iterates over the measurements without a distance, each with its number of points.
    pub(crate) fn missing(&self) -> impl Iterator<Item = (Measurement, usize)> {
        self.missing.values().copied()
    }

    pub(crate) fn missing_of(
        &self,
        kind: MissingKind,
    ) -> impl Iterator<Item = (Measurement, usize)> {
        self.missing().filter(move |(measurement, _)| {
            MissingKind::from_measurement(*measurement) == Some(kind)
        })
    }

    pub(crate) fn count(&self, kind: MissingKind) -> usize {
        self.missing_of(kind).map(|(_, points)| points).sum()
    }
}
