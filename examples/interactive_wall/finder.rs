//! [`Finder`]: the hands in a scan, which are nearer than the background.

use std::time::Duration;

use tokio::time::{Instant, timeout};
use tokio_scip::{Point, ScanStream};

use super::Result;
use super::picture::{Spot, distance};

/// Scans of the background.
const LEARNED: usize = 10;
/// A hand is this much nearer than the background, in metres.
const IN_FRONT: f32 = 0.1;
/// Neighbouring points of a hand are at most this far apart, in metres.
const GAP: f32 = 0.06;
/// Fewer points are noise. A hand 8 cm wide has six at 2 m.
const POINTS: usize = 3;
/// Without a scan for this time there are no hands.
const LIMIT: Duration = Duration::from_millis(200);
/// Number of scans for which a corner is touched.
const HELD: usize = 10;

pub(super) struct Finder {
    scans: ScanStream,
    /// Shortest range in each direction without hands.
    background: Vec<f32>,
}

impl Finder {
    pub(super) async fn learn(mut scans: ScanStream) -> Result<Self> {
        let mut background = vec![f32::INFINITY; scans.window().points()];
        let mut learned = 0;
        while learned < LEARNED {
            // The driver logs errors, and the stream continues.
            let Ok(scan) = scans.next().await.ok_or("the sensor was closed")? else { continue };
            for (known, range) in background.iter_mut().zip(scan.ranges()) {
                *known = known.min(range); // of a number and NaN, the number
            }
            learned += 1;
        }
        Ok(Self { scans, background })
    }

    /// Returns the hands of the next scan, and its time.
    pub(super) async fn next(&mut self) -> Result<(Vec<Spot>, Instant)> {
        let scan = match timeout(LIMIT, self.scans.next()).await {
            Ok(item) => item.ok_or("the sensor was closed")?.ok(),
            Err(_) => None,
        };
        let Some(scan) = scan else { return Ok((Vec::new(), Instant::now())) };
        let rays = scan.rays().zip(&self.background);
        let near = rays.filter(|(ray, known)| ray.measurement.range() < **known - IN_FRONT);
        let points: Vec<Point> = near.filter_map(|(ray, _)| ray.point()).collect();
        let groups = points.chunk_by(|a, b| (a.x - b.x).hypot(a.y - b.y) < GAP);
        let spot = |point: &Point| (point.x.into(), point.y.into());
        let hands = groups.filter(|group| group.len() >= POINTS);
        Ok((hands.map(|hand| middle(hand.iter().map(spot))).collect(), scan.received_at()))
    }

    /// Waits until a hand has been held at each corner of the picture.
    pub(super) async fn corners(&mut self) -> Result<[Spot; 4]> {
        let mut corners = [(f64::NAN, f64::NAN); 4];
        let names = ["top left", "top right", "bottom right", "bottom left"];
        for (number, name) in names.into_iter().enumerate() {
            println!("touch the {name} corner for a second");
            let mut held: Vec<Spot> = Vec::new();
            while held.len() < HELD {
                let (hands, _) = self.next().await?;
                let is_still = |at| held.first().is_none_or(|&first| distance(first, at) < 0.03);
                // The hand may still be at the corner before.
                let is_new = |at| !corners.iter().any(|&corner| distance(corner, at) < 0.2);
                match hands.as_slice() {
                    &[at] if is_still(at) && is_new(at) => held.push(at),
                    _ => held.clear(),
                }
            }
            if let Some(corner) = corners.get_mut(number) {
                *corner = middle(held.into_iter());
            }
        }
        Ok(corners)
    }
}

fn middle(spots: impl ExactSizeIterator<Item = Spot>) -> Spot {
    let count = spots.len() as f64;
    spots.fold((0.0, 0.0), |sum, spot| (sum.0 + spot.0 / count, sum.1 + spot.1 / count))
}
