//! [`seen_through`]: shows a recorded scan in another window.

use tokio_scip::protocol::Protocol;
use tokio_scip::{Scan, Window};

/// Converts a scan to `window`, as the sensor itself would have sent it. Each cluster has
/// its smallest value, in SCIP 2 its smallest distance. Steps that were not recorded have no value. A
/// window that the sensor does not measure changes nothing.
pub(crate) fn seen_through(scan: &Scan, window: Window) -> Scan {
    let (recorded, geometry) = (scan.window(), scan.geometry());
    let Ok(window) = window.resolve(geometry) else { return scan.clone() };
    if recorded == window {
        return scan.clone();
    }
    let last = usize::from(recorded.end().max(window.end()));
    // Each value with its intensity.
    let mut steps = vec![(geometry.unknown_value(), 0); last + 1];
    let first = usize::from(recorded.start());
    let seen = steps.get_mut(first..first + recorded.steps()).unwrap_or_default();
    let clusters = seen.chunks_mut(recorded.cluster_count().into());
    let intensities = scan.intensities().unwrap_or_default().iter().copied();
    let points = scan.raw_values().zip(intensities.chain(std::iter::repeat(0)));
    clusters.zip(points).for_each(|(cluster, point)| cluster.fill(point));
    let first = usize::from(window.start());
    let seen = steps.get(first..first + window.steps()).unwrap_or_default();
    let clusters = seen.chunks(window.cluster_count().into());
    let rank = |(value, _): &(u32, u32)| {
        let is_distance = geometry.measurement(*value).distance().is_some();
        (geometry.protocol() == Protocol::Scip2 && !is_distance, *value)
    };
    let (values, mut intensities): (Vec<u32>, Vec<u32>) =
        clusters.filter_map(|cluster| cluster.iter().copied().min_by_key(rank)).unzip();
    if scan.intensities().is_none() {
        intensities.clear();
    }
    let built = Scan::builder(window, values).intensities(intensities).like(scan).build();
    // There is one value per point of the window, so building the scan succeeds.
    built.unwrap_or_else(|_| scan.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorded_scan_can_be_seen_through_any_window() {
        let window =
            |from, to, count| Window::new(from..=to).unwrap().with_cluster_count(count).unwrap();
        let scan = Scan::builder(window(100, 105, 2), vec![30, 40, 50]).sequence(7);
        let scan = scan.build().unwrap();
        let seen = |window| seen_through(&scan, window).raw_values().collect::<Vec<_>>();
        assert_eq!(seen(window(100, 105, 2)), [30, 40, 50]);
        assert_eq!(seen(window(101, 104, 1)), [30, 40, 40, 50]);
        assert_eq!(seen(window(98, 101, 1)), [19, 19, 30, 30]);
        assert_eq!(seen(window(101, 106, 3)), [30, 19]);
        assert_eq!(seen_through(&scan, Window::FULL).sequence(), 7);
        assert_eq!(seen_through(&scan, Window::FULL).intensities(), None);
        let scan = Scan::builder(window(100, 105, 2), vec![30, 40, 50]).intensities([3, 4, 5]);
        let scan = scan.build().unwrap();
        let seen = |window| seen_through(&scan, window).intensities().map(<[u32]>::to_vec);
        assert_eq!(seen(window(99, 104, 1)), Some(vec![0, 3, 3, 4, 4, 5]));
        assert_eq!(seen(window(101, 104, 2)), Some(vec![3, 4]));
    }
}
