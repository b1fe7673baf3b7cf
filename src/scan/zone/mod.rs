//! [`Zone`]: an area before the sensor, and whether a scan shows it clear.

mod error;
mod polygon;
mod state;

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

pub use self::error::ZoneError;
use self::polygon::Polygon;
pub use self::state::ZoneState;
use super::{Ray, Scan};
use crate::protocol::{Measurement, Window, angle};

/// Tolerance at the edges in metres and radians: points and angles of scans are rounded to `f32`.
const TOLERANCE: f64 = 1e-6;
/// The sensor measures nothing nearer (C-42-3320-A p. 7).
const RANGE_MIN: f64 = 0.020;
/// The sensor measures nothing farther (p. 7).
const RANGE_MAX: f64 = 4.094;
/// Step number of the rear, -180 degrees.
const REAR: i32 = -128;
/// Steps in a full revolution of the motor (p. 7).
const STEPS: i32 = 1024;
/// Angle of the first and last step from the front in degrees (p. 7).
const VIEW_DEGREES: f64 = 135.0;
/// Steps that the sensor measures (p. 6).
const VIEW: RangeInclusive<i32> = 0..=768;

/// Sector or polygon in the sensor's frame, and the rule that decides whether a scan shows it
/// to be clear.
///
/// ```
/// use tokio_scip::scan::{CountsAs, Zone, ZoneState};
/// use tokio_scip::Scan;
///
/// // 60 degrees ahead, up to 0.6 m. An obstacle 0.1 m wide must be seen.
/// let zone = Zone::sector(-30.0..=30.0, 0.0..=0.6)?
///     .smallest_obstacle(0.1)?
///     .beyond_range(CountsAs::Free);
///
/// let window = zone.window();
/// let mut values = vec![2000; 171];
/// assert_eq!(zone.check(&Scan::builder(window, values.clone()).build()?), ZoneState::Clear);
/// values[85] = 570;
/// match zone.check(&Scan::builder(window, values).build()?) {
///     ZoneState::Obstacle(ray) => assert_eq!((ray.step.number(), ray.range()), (384, 0.57)),
///     state => println!("{state}"),
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Rule
///
/// [`check`](Self::check) looks at every ray that crosses the zone farther than 20 mm from
/// the sensor. Along each ray the zone is
///
/// - an **obstacle** if the measured point is in the zone
/// - **free** if the measured point is behind the zone
/// - **unknown** if the measured point is in front of a part of the zone and hides it
/// - unknown if there is no distance, unless you choose something else for codes that an object
///   [beyond the range](Self::beyond_range) causes
///
/// The zone is clear if no ray is an obstacle, if the scan has all rays that cross the zone, and
/// if no more than a tolerated number of consecutive rays are unknown. By default none is
/// tolerated. A ray that does not cross the zone does not end a gap.
///
/// A ray of a cluster is judged at each of its steps, and the worst result counts: the smallest
/// value of a cluster may come from any of them. An error code is smaller than every distance, so
/// in a cluster of several steps it hides an obstacle: it never counts as free there.
///
/// # What this means
///
/// - A zone that no scan can show clear is refused when you create it: one that surrounds the
///   sensor, reaches beyond its view of 270 degrees or its range of 4.094 m, or lies between two
///   rays. An edge or a vertex may lie on the sensor.
/// - With [`smallest_obstacle`](Self::smallest_obstacle), a clear zone contains no obstacle of
///   that size, if each ray that meets the obstacle returns its distance or a code that does not
///   count as free. `tests/zones.rs` checks this on random worlds.
/// - `CountsAs::Free` trusts that an obstacle in the zone returns light. Black, slanted and
///   transparent ones may not.
/// - The sensor's error of some centimetres is not part of the rule: make the zone larger by it.
///
/// This is no safety device: nothing in it is certified.
#[derive(Debug, Clone, PartialEq)]
pub struct Zone {
    shape: ZoneShape,
    /// Steps that cross the zone, and those between them.
    window: Window,
    /// Number of steps that the smallest obstacle covers, at least 1.
    smallest_obstacle: usize,
    beyond_range: CountsAs,
}

#[derive(Debug, Clone, PartialEq)]
enum ZoneShape {
    /// Directions in radians, and ranges in metres.
    Sector {
        from: f64,
        to: f64,
        near: f64,
        far: f64,
    },
    Polygon(Polygon),
}

/// What a ray without a distance says about a [`Zone`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum CountsAs {
    /// The zone is free along this ray.
    Free,
    /// The ray says nothing.
    #[default]
    Unknown,
    /// There is an obstacle in the zone.
    Obstacle,
}

impl Zone {
    /// Creates the zone of all points in an interval of degrees, counter-clockwise from the front,
    /// that are `range` metres from the sensor. Both edges are inside.
    ///
    /// # Errors
    ///
    /// [`ZoneError`] unless the degrees are in -135..=135, the range is 0 or more, and both have
    /// the smaller number first; and for a zone that no scan can show clear.
    pub fn sector(
        degrees: RangeInclusive<f64>,
        range: RangeInclusive<f64>,
    ) -> Result<Self, ZoneError> {
        let ((from, to), (near, far)) = (degrees.into_inner(), range.into_inner());
        if !(-VIEW_DEGREES <= from && from <= to && to <= VIEW_DEGREES) {
            return Err(ZoneError::Sector { from, to });
        }
        if !(0.0 <= near && near < far && far.is_finite()) {
            return Err(ZoneError::Range { near, far });
        }
        let (from, to) = (from.to_radians(), to.to_radians());
        Self::new(ZoneShape::Sector { from, to, near, far })
    }

    /// Creates the zone inside a polygon. `vertices` are x and y in metres, clockwise or
    /// counter-clockwise, 3 to 1,000 of them. The last vertex may repeat the first one.
    ///
    /// To use vertices of another frame, such as the vehicle's, move them into the sensor's:
    ///
    /// ```
    /// use tokio_scip::scan::{Pose, Zone};
    ///
    /// let sensor = Pose { x: 0.2, y: 0.0, heading: 0.0 }; // on the vehicle
    /// let path = [(0.25, -0.3), (1.0, -0.3), (1.0, 0.3), (0.25, 0.3)];
    /// let zone = Zone::polygon(path.map(|(x, y)| sensor.inverse().transform(x, y)))?;
    /// assert_eq!(zone.window().to_string(), "steps 155..=613"); // enough to see it
    /// # Ok::<(), tokio_scip::scan::ZoneError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`ZoneError`] for too few or too many vertices, for coordinates that are no numbers or
    /// beyond 1,000 m, for edges that cross, touch or cover each other, and for a zone that no
    /// scan can show clear.
    pub fn polygon(vertices: impl IntoIterator<Item = (f64, f64)>) -> Result<Self, ZoneError> {
        Self::new(ZoneShape::Polygon(Polygon::new(vertices)?))
    }

    fn new(shape: ZoneShape) -> Result<Self, ZoneError> {
        let window = shape.window()?;
        Ok(Self { shape, window, smallest_obstacle: 1, beyond_range: CountsAs::Unknown })
    }

    /// Smallest window whose scans have all rays that cross the zone.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Tolerates consecutive unknown rays as long as no obstacle of `width` metres fits behind
    /// them. `width` is the width as seen from the sensor. By default no unknown ray is tolerated.
    ///
    /// At the zone's farthest point such an obstacle covers the fewest steps: for 0.1 m at 0.6 m
    /// 27 of them, so 26 unknown rays are tolerated, and 6 in clusters of 4.
    ///
    /// # Errors
    ///
    /// [`ZoneError::SmallestObstacle`] for a width that fits between two rays there, such as
    /// 3 mm at 0.6 m or 25 mm at 4 m, and for one that is not a finite number.
    pub fn smallest_obstacle(self, width: f64) -> Result<Self, ZoneError> {
        let reach = match &self.shape {
            ZoneShape::Sector { far, .. } => *far,
            ZoneShape::Polygon(polygon) => polygon.reach(),
        };
        let step = TAU / f64::from(STEPS);
        let steps = 2.0 * (width / 2.0).atan2(reach) / step;
        if !width.is_finite() || steps < 1.0 {
            let least = 2.0 * reach * (step / 2.0).tan();
            return Err(ZoneError::SmallestObstacle { width, least });
        }
        Ok(Self { smallest_obstacle: steps as usize, ..self })
    }

    /// Sets what the error codes 0, 6 and 16 and the value 4095 count as: an object may be
    /// beyond the sensor's range. Default: [`CountsAs::Unknown`].
    pub fn beyond_range(self, counts_as: CountsAs) -> Self {
        Self { beyond_range: counts_as, ..self }
    }

    /// Judges whether a scan shows the zone clear, by the rule [above](#rule). Obstacles come
    /// first, then directions without a ray, then gaps.
    pub fn check(&self, scan: &Scan) -> ZoneState {
        let (mut nearest, mut gap, mut longest) = (None::<Ray>, None, None::<Gap>);
        for ray in scan.rays() {
            let Some(found) = self.along(ray, scan.window()) else { continue };
            match found {
                CountsAs::Free => gap = None,
                CountsAs::Unknown => {
                    let now = Gap::with(gap, ray);
                    gap = Some(now);
                    longest = longest.filter(|longest| longest.rays >= now.rays).or(gap);
                }
                CountsAs::Obstacle => {
                    let nearer = |other: &Ray| other.range().total_cmp(&ray.range()).is_le();
                    nearest = nearest.filter(nearer).or(Some(ray));
                }
            }
        }
        if let Some(ray) = nearest {
            return ZoneState::Obstacle(ray);
        }
        if let Some(step) = self.uncovered(scan.window()) {
            return ZoneState::Uncovered { angle: angle(step.into()) as f32, window: self.window };
        }
        match longest {
            Some(Gap { first, last, rays }) if rays > self.tolerated(scan.window()) => {
                ZoneState::Blind { first, last, rays }
            }
            _ => ZoneState::Clear,
        }
    }

    /// Returns the worst that a ray says about the zone at any of its steps, or `None` if it
    /// does not cross the zone.
    fn along(&self, ray: Ray, window: Window) -> Option<CountsAs> {
        let first = ray.step.number();
        let last = window.end().number().min(first + u16::from(window.cluster_count()) - 1);
        // One code hides the distances of all other steps.
        let hides = first < last && matches!(ray.measurement, Measurement::Error(_));
        let best = if hides { CountsAs::Unknown } else { CountsAs::Free };
        let each = (first..=last).filter_map(|step| {
            let angle = angle(step.into());
            Some(self.at(ray.measurement, angle, self.shape.far(angle)?))
        });
        each.max().map(|worst| worst.max(best))
    }

    /// Returns what a measurement in one direction says about a zone that ends `far` metres
    /// away.
    fn at(&self, measurement: Measurement, angle: f64, far: f64) -> CountsAs {
        match measurement {
            Measurement::Distance(millimetres) => {
                let range = f64::from(millimetres) / 1000.0;
                let (sin, cos) = angle.sin_cos();
                match range {
                    _ if self.shape.contains(range * cos, range * sin) => CountsAs::Obstacle,
                    _ if range > far => CountsAs::Free,
                    _ => CountsAs::Unknown,
                }
            }
            Measurement::Error(code) if !code.is_beyond_range() => CountsAs::Unknown,
            Measurement::Error(_) | Measurement::Saturated => self.beyond_range,
        }
    }

    /// Returns a step that crosses the zone, or lies between such steps, outside of the window.
    fn uncovered(&self, window: Window) -> Option<u16> {
        let (first, last) = (self.window.start().number(), self.window.end().number());
        let outside = |step| !(window.start().number()..=window.end().number()).contains(&step);
        [first, last].into_iter().find(|step| outside(*step))
    }

    /// Returns how many consecutive rays of a scan may be unknown.
    fn tolerated(&self, window: Window) -> usize {
        // However the steps of an obstacle lie, they touch this number of clusters.
        let clusters = self.smallest_obstacle.div_ceil(usize::from(window.cluster_count()));
        clusters.saturating_sub(1)
    }
}

impl ZoneShape {
    fn contains(&self, x: f64, y: f64) -> bool {
        match self {
            Self::Sector { from, to, near, far } => {
                is_between(*near, x.hypot(y), *far) && is_between(*from, y.atan2(x), *to)
            }
            Self::Polygon(polygon) => polygon.contains((x, y), TOLERANCE),
        }
    }

    /// Returns the distance to the far end in a direction, or `None` if the shape does not lie
    /// there.
    fn far(&self, angle: f64) -> Option<f64> {
        let far = match self {
            Self::Sector { from, to, far, .. } => is_between(*from, angle, *to).then_some(*far),
            Self::Polygon(polygon) => polygon.far(angle),
        };
        far.filter(|far| *far > RANGE_MIN)
    }

    /// Returns the window of all steps that cross the shape, or an error if no scan can show it
    /// clear.
    fn window(&self) -> Result<Window, ZoneError> {
        let mut directions = (REAR..REAR + STEPS).map(|step| angle(step.into()));
        if directions.all(|angle| self.far(angle).is_some()) {
            return Err(ZoneError::SensorInside);
        }
        let mut crossing: Option<RangeInclusive<u16>> = None;
        for step in REAR..REAR + STEPS {
            let angle = angle(step.into());
            let Some(far) = self.far(angle) else { continue };
            match u16::try_from(step) {
                Ok(step) if VIEW.contains(&step.into()) => {
                    if far > RANGE_MAX + TOLERANCE {
                        return Err(ZoneError::BeyondRange { angle, far });
                    }
                    let first = crossing.map_or(step, |crossing| *crossing.start());
                    crossing = Some(first..=step);
                }
                _ => return Err(ZoneError::BeyondView { angle }),
            }
        }
        crossing.and_then(|steps| Window::new(steps).ok()).ok_or(ZoneError::BetweenRays)
    }
}

/// Returns true if a number is between two others, or nearly.
fn is_between(least: f64, number: f64, most: f64) -> bool {
    (least - TOLERANCE..=most + TOLERANCE).contains(&number)
}

/// Consecutive unknown rays.
#[derive(Debug, Clone, Copy)]
struct Gap {
    first: Ray,
    last: Ray,
    rays: usize,
}

impl Gap {
    /// Returns the gap with one more ray.
    fn with(before: Option<Self>, ray: Ray) -> Self {
        let Self { first, rays, .. } = before.unwrap_or(Self { first: ray, last: ray, rays: 0 });
        Self { first, last: ray, rays: rays + 1 }
    }
}
