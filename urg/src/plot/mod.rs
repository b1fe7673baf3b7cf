//! Geometry of a polar plot in any medium: the sector, the range rings and the places of
//! points. Plots look from above, with the sensor's front up.

pub(crate) mod colours;
pub(crate) mod missing;
pub(crate) mod pose;
pub(crate) mod summary;

use std::f64::consts::FRAC_PI_2;
use std::iter;
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{Geometry, Point, Scan, Window};

/// Radii in metres of pictures that show less than the sensor measures. A URG-04LX is shown whole.
pub(crate) const RADII: [f64; 10] = [6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0];
/// How long a picture keeps its radius after the last point that needed it.
pub(crate) const HOLD: Duration = Duration::from_secs(10);

/// Computes the largest radius of a plot, in metres: a little more than the sensor can measure.
pub(crate) fn whole(geometry: &Geometry) -> f64 {
    // Whole decimetres, for round labels: 4.2 m for a URG-04LX.
    (f64::from(*geometry.distances().end()) / 100.0 * 1.02).ceil() / 10.0
}

/// Computes the radius of a plot that shows all points of a scan, in metres. A sensor that can measure
/// 60 m is mostly in a room of 5 m.
pub(crate) fn reach(scan: &Scan) -> f64 {
    let farthest = scan.points().map(|point| f64::from(point.range)).fold(0.0, f64::max);
    let whole = whole(scan.geometry());
    RADII.into_iter().find(|radius| *radius >= farthest).unwrap_or(whole).min(whole)
}

/// Iterates over the points, each with the index of its shade if the scan has intensities.
pub(crate) fn points(scan: &Scan) -> impl Iterator<Item = (Point, Option<usize>)> + '_ {
    let intensities = scan.intensities().unwrap_or_default().iter();
    let shades = intensities.map(|intensity| Some(colours::shade(*intensity)));
    let rays = scan.rays().zip(shades.chain(iter::repeat(None)));
    rays.filter_map(|(ray, shade)| Some((ray.point()?, shade)))
}

/// Radius of a plot that follows the scans. It grows at once, and shrinks after [`HOLD`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    pub(crate) metres: f64,
    needed_at: Option<Instant>,
}

impl Reach {
    /// Radius before the first scan: that of a URG-04LX.
    pub(crate) fn new() -> Self {
        Self { metres: whole(&Geometry::URG_04LX), needed_at: None }
    }

    pub(crate) fn follow(&mut self, scan: &Scan, now: Instant) {
        let needed = reach(scan);
        let is_held = self.needed_at.is_some_and(|at| now.saturating_duration_since(at) < HOLD);
        if needed >= self.metres || !is_held {
            *self = Self { metres: needed, needed_at: Some(now) };
        }
    }
}

/// Place on the plot, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) right: f64,
    pub(crate) ahead: f64,
}

impl Place {
    /// Converts a point to a place: `x` ahead, `y` to the left.
    pub(crate) fn from_point(x: f64, y: f64) -> Self {
        Self { right: -y, ahead: x }
    }
}

/// Place `range` metres away at `angle`, radians counter-clockwise from the front.
pub(crate) fn place(range: f64, angle: f64) -> Place {
    Place::from_point(range * angle.cos(), range * angle.sin())
}

/// Part of a text to align with its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// Directions that a window covers, in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sector {
    /// Rightmost direction.
    pub(crate) from: f64,
    /// Leftmost direction.
    pub(crate) to: f64,
}

/// Rectangle around a plot: the distance of each side from the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Extent {
    pub(crate) left: f64,
    pub(crate) right: f64,
    pub(crate) ahead: f64,
    pub(crate) behind: f64,
}

impl Extent {
    /// Extends the rectangle as far as a place.
    pub(crate) fn include(&mut self, Place { right, ahead }: Place) {
        self.left = self.left.max(-right);
        self.right = self.right.max(right);
        self.ahead = self.ahead.max(ahead);
        self.behind = self.behind.max(-ahead);
    }
}

impl Sector {
    pub(crate) fn from_window(window: Window, geometry: &Geometry) -> Self {
        let angle = |step| f64::from(geometry.degrees(step).to_radians());
        Self { from: angle(window.start()), to: angle(window.end()) }
    }

    /// Computes the rectangle around the sector, for a radius of 1.
    pub(crate) fn extent(self) -> Extent {
        // Even a window of a few steps needs a picture with two dimensions.
        const LEAST: f64 = 0.25;
        let corners = [self.from, self.to, -FRAC_PI_2, 0.0, FRAC_PI_2];
        let mut extent = Extent { left: LEAST, right: LEAST, ahead: LEAST, behind: 0.1 };
        for angle in corners.into_iter().filter(|angle| (self.from..=self.to).contains(angle)) {
            extent.include(place(1.0, angle));
        }
        extent
    }

    /// Directions to label, in whole degrees, right to left: every 30 degrees, or closer in
    /// a sector that is too narrow for two labels.
    pub(crate) fn directions(self) -> Vec<i32> {
        let each = |degrees: i32| {
            let most = 180 / degrees;
            let inside =
                |angle: &i32| (self.from..=self.to).contains(&f64::from(*angle).to_radians());
            (-most..=most).map(|n| n * degrees).filter(inside).collect::<Vec<_>>()
        };
        [30, 10, 5].into_iter().map(each).find(|found| found.len() > 1).unwrap_or_else(|| each(1))
    }

    /// Computes the place and the anchor of a range label. The place is `range` metres
    /// along the right edge and `distance` metres outside the sector, where nothing is
    /// measured. The anchor keeps the text out of the sector.
    pub(crate) fn beside(self, range: f64, distance: f64) -> (Place, Anchor) {
        let Place { right, ahead } = place(range, self.from);
        let (sin, cos) = self.from.sin_cos();
        let anchor = match cos {
            _ if cos < -0.3 => Anchor::End,
            _ if cos > 0.3 => Anchor::Start,
            _ => Anchor::Middle,
        };
        (Place { right: right + distance * cos, ahead: ahead + distance * sin }, anchor)
    }

    /// Iterates along an arc, right to left, in steps of at most `spacing` metres.
    pub(crate) fn arc(self, radius: f64, spacing: f64) -> impl Iterator<Item = Place> {
        let length = radius * (self.to - self.from);
        // At most 3600 parts: a tenth of a degree on a full circle.
        let parts = (length / spacing).ceil().clamp(1.0, 3600.0);
        let (from, step) = (self.from, (self.to - self.from) / parts);
        (0..=parts as u32).map(move |n| place(radius, from + f64::from(n) * step))
    }
}

/// Iterates over the radii of the range rings up to `reach` metres, from the inside out.
pub(crate) fn rings(reach: f64) -> impl Iterator<Item = f64> {
    let near = [0.1, 0.25, 0.5].into_iter().find(|spacing| reach / spacing <= 5.0);
    let far = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0];
    let far = far.into_iter().find(|spacing| reach / spacing <= 10.0);
    let spacing = near.or(far).unwrap_or(reach / 5.0);
    (1..=10).map(move |n| f64::from(n) * spacing).take_while(move |ring| *ring <= reach)
}

#[cfg(test)]
mod tests {
    use tokio_scip::Sensor;
    use urg_emulator::{Emulator, Model, Values, WorldTime};

    use super::*;

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-3
    }

    #[test]
    fn the_front_is_up_and_the_left_is_left() {
        let front = place(2.0, 0.0);
        assert!(near(front.right, 0.0) && near(front.ahead, 2.0));
        let left = place(2.0, FRAC_PI_2);
        assert!(near(left.right, -2.0) && near(left.ahead, 0.0));
        let (beside, anchor) = Sector { from: -FRAC_PI_2, to: 0.0 }.beside(2.0, 0.5);
        assert_eq!(anchor, Anchor::Middle);
        assert!(near(beside.right, 2.0) && near(beside.ahead, -0.5));
    }

    #[test]
    fn a_plot_has_room_for_its_sector_and_no_more() {
        let full = Sector::from_window(Window::FULL, &Geometry::URG_04LX).extent();
        assert!(near(full.left, 1.0) && near(full.right, 1.0) && near(full.ahead, 1.0));
        assert!(near(full.behind, 0.5_f64.sqrt()));
        let right = Sector { from: -FRAC_PI_2, to: 0.0 }.extent();
        assert!(near(right.left, 0.25) && near(right.right, 1.0) && near(right.behind, 0.1));
        let step = Sector { from: 0.1, to: 0.1 }.extent();
        assert!(step.left + step.right > 0.4 && step.ahead > 0.9);
    }

    #[test]
    fn there_are_three_to_ten_rings_at_any_zoom() {
        assert_eq!(whole(&Geometry::URG_04LX), 4.2);
        assert_eq!(rings(4.2).collect::<Vec<_>>(), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(rings(1.0).collect::<Vec<_>>(), [0.25, 0.5, 0.75, 1.0]);
        for reach in [0.5, 2.0, 3.0, 11.0, 99.0, 1005.0, 1e9] {
            assert!((3..=10).contains(&rings(reach).count()), "{reach}");
        }
    }

    /// Scan of a UTM that sees points in these distances.
    async fn utm(millimetres: &[u32]) -> Scan {
        let seen = millimetres.to_vec();
        let world = move |_: WorldTime, values: &mut Values| {
            values.fill(1);
            values.iter_mut().zip(&seen).for_each(|(value, seen)| *value = *seen);
        };
        let emulator = Emulator::builder().model(Model::Utm30lx).world(world).build();
        Sensor::builder().connect(emulator).await.unwrap().scan(Window::DETECTION).await.unwrap()
    }

    #[tokio::test(start_paused = true)]
    async fn a_plot_is_as_large_as_what_the_sensor_sees() {
        for (seen, expected) in [
            (&[][..], 6.0),
            (&[400, 5900], 6.0),
            (&[9000], 10.0),
            (&[29_000], 30.0),
            (&[59_000], 61.2),
        ] {
            assert_eq!(reach(&utm(seen).await), expected, "{seen:?}");
        }
        let urg = Scan::builder(Window::new(384..=384).unwrap(), [30]).build().unwrap();
        assert_eq!(reach(&urg), 4.2);
    }

    #[tokio::test(start_paused = true)]
    async fn a_plot_grows_at_once_and_shrinks_later() {
        let (near, far) = (utm(&[3000]).await, utm(&[14_000]).await);
        let (mut shown, start) = (Reach::new(), Instant::now());
        let mut after = |scan, seconds| {
            shown.follow(scan, start + Duration::from_secs(seconds));
            shown.metres
        };
        assert_eq!([after(&near, 0), after(&far, 1), after(&near, 2)], [6.0, 15.0, 15.0]);
        assert_eq!([after(&far, 9), after(&near, 18), after(&near, 19)], [15.0, 15.0, 6.0]);
    }

    #[test]
    fn directions_and_arcs_stay_inside_of_the_sector() {
        let sector = Sector::from_window(Window::DETECTION, &Geometry::URG_04LX);
        assert_eq!(sector.directions(), [-90, -60, -30, 0, 30, 60, 90]);
        let narrow = |from: f64, to: f64| Sector { from: from.to_radians(), to: to.to_radians() };
        assert_eq!(narrow(-31.0, -9.0).directions(), [-30, -20, -10]);
        assert_eq!(narrow(-1.5, 1.5).directions(), [-1, 0, 1]);
        assert_eq!(narrow(0.1, 0.2).directions(), [0; 0]);
        let arc: Vec<_> = sector.arc(1.0, 0.1).collect();
        assert!(arc.len() > 40);
        assert!(arc.iter().all(|place| near(place.right.hypot(place.ahead), 1.0)));
        assert!(arc.windows(2).all(|two| {
            let [a, b] = two else { return false };
            (a.right - b.right).hypot(a.ahead - b.ahead) <= 0.1
        }));
    }
}
