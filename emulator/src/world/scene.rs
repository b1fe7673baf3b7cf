//! [`Scene`]: surroundings put together from walls, discs and people, for tests of a service.

use std::time::Duration;

use super::path::{Mount, Path};
use super::surface::{Echo, Surface, millimetres, nearest};
use super::sweep::sweep;
use super::walk::Walk;
use super::{Values, World, WorldTime};

/// Number of steps, 1.6 ms, for which everything stands still: a person moves by a millimetre.
const STILL: usize = 16;

/// Fraction of the light that surfaces of a scene reflect.
const REFLECTS: f64 = 0.7;

/// Surroundings made of walls, discs and people, some of which move.
///
/// Positions are in metres in the sensor's frame, x forward and y left, or in the frame of its
/// [path](Self::sensor_on). Each ray shows them at its own time. A direction without a surface has
/// error code 0. As with a real sensor, each distance is off by some millimetres,
/// and some points are missing, drawn from the seed. Call
/// [`without_noise`](Self::without_noise) to make distances exact.
///
/// ```
/// use std::time::Duration;
/// use urg_emulator::{Emulator, Scene, Walk};
///
/// // A corridor 2 m wide; after 5 s a person walks by, 1 m in front of the sensor.
/// let corridor = Scene::new(1).wall((-1.0, 1.0), (4.0, 1.0)).wall((-1.0, -1.0), (4.0, -1.0));
/// let visitor = Walk::new((1.0, -0.8), (1.0, 0.8)).starting_at(Duration::from_secs(5));
/// let emulator = Emulator::builder().world(corridor.person(visitor)).build();
/// ```
#[derive(Debug, Clone)]
pub struct Scene {
    /// Seed of the errors of measurement, or `None` for exact distances.
    noise: Option<u64>,
    surfaces: Vec<Surface>,
    moving: Vec<Moving>,
    sensor: Path,
}

#[derive(Debug, Clone, Copy)]
enum Moving {
    Disc { radius: f64, walk: Walk },
    Person(Walk),
}

impl Moving {
    fn surfaces(&self, time: Duration) -> Vec<Surface> {
        let surfaces = match self {
            Self::Disc { radius, walk } => {
                walk.at(time).map(|at| vec![Surface::disc(at.position, *radius, REFLECTS)])
            }
            Self::Person(walk) => walk.at(time).map(|at| at.legs().to_vec()),
        };
        surfaces.unwrap_or_default()
    }
}

impl Scene {
    /// Creates a scene without surfaces. The seed determines the noise.
    pub fn new(seed: u64) -> Self {
        Self { noise: Some(seed), surfaces: Vec::new(), moving: Vec::new(), sensor: Path::new([]) }
    }

    /// Makes distances exact, rounded to a millimetre, and measures every point in range.
    #[must_use]
    pub fn without_noise(mut self) -> Self {
        self.noise = None;
        self
    }

    /// Moves the sensor on a path, whose [poses](Path::pose) are the truth for a map or an
    /// odometry. The sine of an angle differs between machines in its last digit, so values may
    /// differ by a millimetre.
    #[must_use]
    pub fn sensor_on(mut self, path: Path) -> Self {
        self.sensor = path;
        self
    }

    /// Adds a wall between two positions.
    #[must_use]
    pub fn wall(mut self, from: (f64, f64), to: (f64, f64)) -> Self {
        self.surfaces.push(Surface::wall(millimetres(from), millimetres(to), REFLECTS));
        self
    }

    /// Adds the four walls of a rectangle between two opposite corners: a room if the
    /// sensor is inside, a box if it is outside.
    #[must_use]
    pub fn rectangle(self, corner: (f64, f64), opposite: (f64, f64)) -> Self {
        let ((x0, y0), (x1, y1)) = (corner, opposite);
        self.wall((x0, y0), (x1, y0))
            .wall((x1, y0), (x1, y1))
            .wall((x1, y1), (x0, y1))
            .wall((x0, y1), (x0, y0))
    }

    /// Adds a disc, such as a pillar. A disc around the sensor is not measured.
    #[must_use]
    pub fn disc(mut self, centre: (f64, f64), radius: f64) -> Self {
        self.surfaces.push(Surface::disc(millimetres(centre), radius * 1000.0, REFLECTS));
        self
    }

    /// Adds a disc whose centre moves, such as a robot.
    #[must_use]
    pub fn moving_disc(mut self, radius: f64, walk: Walk) -> Self {
        self.moving.push(Moving::Disc { radius: radius * 1000.0, walk });
        self
    }

    /// Adds a person who walks: two legs of 13 cm, side by side and striding.
    #[must_use]
    pub fn person(mut self, walk: Walk) -> Self {
        self.moving.push(Moving::Person(walk));
        self
    }
}

impl World for Scene {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        let moving = |step| {
            let at = time.at_step(step + STILL / 2);
            self.moving.iter().flat_map(move |moving| moving.surfaces(at)).collect::<Vec<_>>()
        };
        let moving: Vec<_> = (0..values.len()).step_by(STILL).map(moving).collect();
        sweep(self.noise, time, values, |step, direction| {
            let moving = moving.get(step / STILL).into_iter().flatten();
            let sensor = Mount::at(self.sensor.pose(time.at_step(step)));
            let surfaces = self.surfaces.iter().chain(moving);
            let seen = surfaces.map(|surface| surface.seen_from(sensor.place));
            nearest(seen, sensor.direction(direction), Echo::NONE)
        });
    }
}
