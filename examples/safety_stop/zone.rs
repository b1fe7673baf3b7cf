//! [`Zone`]: an area before the sensor, and whether a scan shows it clear.

use std::f64::consts::TAU;

use tokio_scip::{Geometry, Measurement, Scan, Window};

/// Tolerance in metres, because scans round distances to `f32`.
const TOLERANCE: f64 = 1e-6;

/// Area inside an outline, and all that lies between it and the sensor.
///
/// Each ray that crosses the zone shows
///
/// - an obstacle, if it measures a distance inside the zone
/// - free space, if it measures a distance behind the zone, or an error code that means "beyond the
///   range": that trusts that an obstacle in the zone returns light
/// - nothing, if it has another error code. In clusters of several steps that applies to all
///   codes: a code is smaller than every distance, so it hides an obstacle.
///
/// A scan shows the zone clear if it has all rays of the zone, no obstacle, and no gap that could
/// hide the smallest obstacle: no run of rays that show nothing is as wide as that.
///
/// The sensor's error of some centimetres is not part of the rule: draw the outline larger by it.
pub(crate) struct Zone {
    geometry: Geometry,
    window: Window,
    /// How far the zone reaches at each step, in metres: 0 where the step does not cross it.
    far: Vec<f64>,
    /// Number of steps that the smallest obstacle covers, at least 1.
    obstacle_steps: usize,
}

impl Zone {
    /// Creates the zone of a sensor inside an outline of vertices, in metres ahead of and to the left
    /// of the sensor. `smallest_obstacle` is a width in metres, as seen from the sensor.
    ///
    /// Returns an error if no scan can show the zone clear, or if the smallest obstacle fits between
    /// two rays.
    pub(crate) fn new(
        geometry: Geometry,
        outline: &[(f64, f64)],
        smallest_obstacle: f64,
    ) -> Result<Self, String> {
        if let Some(vertex) = outline.iter().find(|(x, y)| !(x.is_finite() && y.is_finite())) {
            return Err(format!("expected finite vertices, found {vertex:?}"));
        }
        let metres = |millimetres: &u32| f64::from(*millimetres) / 1000.0;
        let (nearest, farthest) =
            (metres(geometry.distances().start()), metres(geometry.distances().end()));
        let half = i32::from(geometry.steps_per_revolution() / 2);
        let angle_of_step = TAU / f64::from(geometry.steps_per_revolution());
        let steps = geometry.answered_steps();
        let front = (f64::from(-geometry.degrees(0)).to_radians() / angle_of_step).round() as i32;
        let mut far = vec![0.0; usize::from(*steps.end()) + 1];
        // All directions from the rear on, also those that no step has.
        for turned in -half..half {
            let degrees = (f64::from(turned) * angle_of_step).to_degrees();
            let end = self::far(outline, degrees.to_radians());
            let Some(end) = end.filter(|end| *end > nearest) else {
                continue;
            };
            if end > farthest + TOLERANCE {
                let reach = format!("{end:.3} m at {degrees:.1}°");
                return Err(format!("the zone reaches {reach}, beyond {farthest} m"));
            }
            let step = u16::try_from(front + turned).ok().filter(|step| steps.contains(step));
            match step.and_then(|step| far.get_mut(usize::from(step))) {
                Some(far) => *far = end,
                None => {
                    let [first, last] =
                        [steps.start(), steps.end()].map(|step| geometry.degrees(*step));
                    return Err(format!(
                        "the zone reaches {degrees:.1}°, beyond {first} to {last}°"
                    ));
                }
            }
        }
        let crossing = |far: &f64| *far > 0.0;
        let (Some(first), Some(last)) =
            (far.iter().position(crossing), far.iter().rposition(crossing))
        else {
            return Err("no ray crosses the zone".into());
        };
        let reach = outline.iter().map(|(x, y)| x.hypot(*y)).fold(0.0, f64::max);
        let obstacle_steps = 2.0 * (smallest_obstacle / 2.0).atan2(reach) / angle_of_step;
        if !(1.0..f64::from(half)).contains(&obstacle_steps) {
            let least = 2.0 * reach * (angle_of_step / 2.0).tan();
            return Err(format!("expected an obstacle of {least:.3} m or more"));
        }
        let window = Window::new(first as u16..=last as u16).map_err(|error| error.to_string())?;
        Ok(Self { geometry, window, far, obstacle_steps: obstacle_steps as usize })
    }

    /// Smallest window whose scans have all rays that cross the zone.
    pub(crate) fn window(&self) -> Window {
        self.window
    }

    /// Checks that a scan shows the zone clear, or returns a reason why not.
    pub(crate) fn check(&self, scan: &Scan) -> Result<(), String> {
        if *scan.geometry() != self.geometry {
            return Err("the scan is of another model".to_owned());
        }
        let [needed, window] = [self.window, scan.window()];
        if window.start() > needed.start() || window.end() < needed.end() {
            return Err(format!("the zone needs {needed}, the scan has {window}"));
        }
        let cluster = usize::from(window.cluster_count());
        // However the steps of an obstacle lie, they touch this number of clusters.
        let obstacle_rays = self.obstacle_steps.div_ceil(cluster);
        let mut gap = 0;
        for ray in scan.rays() {
            let first = usize::from(ray.step);
            let last = usize::from(window.end()).min(first + cluster - 1);
            let far = self.far.get(first..=last).unwrap_or_default();
            let Some(far) = far.iter().copied().filter(|far| *far > 0.0).reduce(f64::max) else {
                continue;
            };
            let (range, degrees) = (ray.measurement.range(), ray.angle.to_degrees());
            if f64::from(range) <= far + TOLERANCE {
                return Err(format!("obstacle at {degrees:.1}°, {range:.3} m"));
            }
            let hides = first < last && matches!(ray.measurement, Measurement::Error(_));
            gap = if hides || range.is_nan() { gap + 1 } else { 0 };
            if gap == obstacle_rays {
                return Err(format!("{gap} rays without a distance up to {degrees:.1}°"));
            }
        }
        Ok(())
    }
}

/// Returns the distance to the farthest edge in a direction in radians, if an edge lies there.
fn far(outline: &[(f64, f64)], angle: f64) -> Option<f64> {
    let (sin, cos) = angle.sin_cos();
    let turned = |(x, y): &(f64, f64)| {
        let left = y * cos - x * sin;
        (x * cos + y * sin, if left.abs() <= TOLERANCE { 0.0 } else { left })
    };
    let next = outline.iter().cycle().skip(1);
    let hits = outline.iter().zip(next).filter_map(|(from, to)| {
        let ((a, left_a), (b, left_b)) = (turned(from), turned(to));
        match left_a * left_b {
            beside if beside > 0.0 => None,
            _ if left_a == left_b => Some(a.max(b)),
            _ => Some(a + (b - a) * left_a / (left_a - left_b)),
        }
    });
    hits.filter(|far| *far >= 0.0).reduce(f64::max)
}
