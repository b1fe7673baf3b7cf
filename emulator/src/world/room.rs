//! [`Room`]: a room with furniture and people in it, so that scans look real.

use tokio_scip::scan::Pose;

use super::path::Mount;
use super::sparse::Sparse;
use super::surface::{Echo, Surface, Vector, nearest};
use super::sweep::sweep;
use super::walk::{Stride, WALKING_SPEED};
use super::{Values, World, WorldTime};
use crate::random::{Random, mix};

/// Rectangular room with furniture, a doorway, a window, and people who walk.
///
/// Most points are distances. The others are codes as a real sensor sends them, of a URG: 19
/// outside steps 44..=725; 16 beyond 4,094 mm, 6 beyond 5.6 m, 0 beyond 12 m; 1 to 5 where
/// little light is reflected; 9 for one point in 300; 7 for a point between two others
/// without a distance.
///
/// The same seed gives the same scans at the same times, on every machine.
#[derive(Debug, Clone)]
pub struct Room {
    seed: u64,
    /// Distances of the walls: front, left, back and right.
    walls: [f64; 4],
    furniture: Vec<Surface>,
    people: Vec<Person>,
    sensor: Mount,
}

impl Room {
    /// Creates a room of 5.0 by 4.4 metres with two people, furnished by the seed.
    pub fn new(seed: u64) -> Self {
        Self::sized(seed, 5000, 4400, 2)
    }

    /// Creates a room of `length` (along the sensor's x axis) by `width` millimetres, at
    /// least 2,000 each, with this number of people. The sensor stands a little behind and
    /// to the right of the middle.
    pub fn sized(seed: u64, length: u16, width: u16, people: usize) -> Self {
        let (length, width) = (f64::from(length.max(2000)), f64::from(width.max(2000)));
        let walls = [0.58 * length, 0.53 * width, 0.42 * length, 0.47 * width];
        let [front, left, back, right] = walls;
        let mut random = Random::new(mix(seed));
        let mut between = |from: f64, to: f64| from + (to - from) * random.fraction();

        let cupboard = between(-0.3 * back, 0.2 * front);
        let table = (between(0.45 * front, 0.6 * front), between(-0.7 * right, -0.5 * right));
        let mut furniture = vec![
            // A cupboard at the left wall, a dark cabinet at the right one, a
            // pillar in the front left corner and a bin.
            Surface::block((cupboard, left - 450.0), (cupboard + 900.0, left), 0.8),
            Surface::block((-0.4 * back, -right), (0.1 * front, 350.0 - right), 0.016),
            Surface::disc((front - 300.0, left - 300.0), between(120.0, 180.0), 0.7),
            Surface::disc((between(-0.5, -0.2) * back, 0.6 * left), 150.0, 0.5),
        ];
        // Only the four legs of the table are at the height of the beam.
        for (x, y) in [(0.0, 0.0), (700.0, 0.0), (0.0, 500.0), (700.0, 500.0)] {
            furniture.push(Surface::disc((table.0 + x, table.1 + y), 30.0, 0.6));
        }
        let people = (0..people)
            .map(|_| {
                // In the front half, so that people do not walk through the sensor.
                let mut place =
                    || (between(0.3 * front, 0.85 * front), between(-0.75 * right, 0.8 * left));
                Person { from: place(), to: place(), ahead: between(0.0, 10_000.0) }
            })
            .collect();
        Self { seed, walls, furniture, people, sensor: Mount::at(Pose::default()) }
    }

    /// Moves and turns the sensor from where it stands otherwise. Sensors in rooms with the
    /// same seed and size measure the same walls from their places.
    ///
    /// A sensor outside the walls measures no distance. The sine of an angle differs between
    /// machines in its last digit, so a turned sensor's values may differ by a millimetre.
    #[must_use]
    pub fn seen_from(mut self, pose: Pose) -> Self {
        self.sensor = Mount::at(pose);
        self
    }

    /// Creates a room as hard to measure as in captures of a real sensor: 55 % of the points
    /// have no distance, mostly with error codes 0, 6, 16 and 7. The others lie on objects
    /// from 0.25 m to about 4 m away.
    pub fn hard(seed: u64) -> Sparse<Self> {
        let mut room = Self::sized(seed, 5400, 4700, 3);
        // Two posts next to the sensor, as on the vehicle that carries it.
        for centre in [(60.0, 280.0), (90.0, -340.0)] {
            room.furniture.push(Surface::disc(centre, 20.0, 0.6));
        }
        Sparse::new(room, 0.44, seed)
    }

    /// Echo of the walls, the doorway and the window.
    fn wall(&self, (x, y): Vector) -> Echo {
        let [front, left, back, right] = self.walls;
        let (ahead, beside) = self.sensor.place;
        if !(-back..front).contains(&ahead) || !(-right..left).contains(&beside) {
            return Echo::NONE;
        }
        let along_x = if x > 0.0 { (front - ahead) / x } else { (back + ahead) / -x };
        let along_y = if y > 0.0 { (left - beside) / y } else { (right + beside) / -y };
        if along_x < along_y {
            let across = beside + y * along_x;
            // A doorway in the front wall, with a corridor's wall behind it.
            if x > 0.0 && across > 0.1 * left && across < 0.1 * left + 800.0 {
                return Echo { distance: (front - ahead + 2500.0) / x, light: 0.8 };
            }
            Echo { distance: along_x, light: 0.9 * x.abs() }
        } else {
            let across = ahead + x * along_y;
            // A window in the left wall, and nothing behind it.
            if y > 0.0 && across > 0.55 * front && across < 0.55 * front + 500.0 {
                return Echo::NONE;
            }
            Echo { distance: along_y, light: 0.9 * y.abs() }
        }
    }
}

impl World for Room {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        let walked = WALKING_SPEED * 1000.0 * (time.at.as_micros() as f64 / 1_000_000.0);
        let people = self.people.iter();
        let legs: Vec<_> = people.flat_map(|person| person.legs(walked)).collect();
        let things = self.furniture.iter().chain(&legs);
        let things: Vec<_> = things.map(|thing| thing.seen_from(self.sensor.place)).collect();
        sweep(Some(self.seed), time, values, |_, direction| {
            let direction = self.sensor.direction(direction);
            nearest(things.iter().copied(), direction, self.wall(direction))
        });
    }
}

/// Person who walks back and forth between two positions.
#[derive(Debug, Clone)]
struct Person {
    from: Vector,
    to: Vector,
    /// Distance walked before power-up, in millimetres.
    ahead: f64,
}

impl Person {
    fn legs(&self, walked: f64) -> [Surface; 2] {
        Stride::between(self.from, self.to, self.ahead + walked).legs()
    }
}
