//! [`Room`]: a room with furniture and people in it, so that scans look real.
//!
//! Plane geometry in millimetres, x forward and y left of the sensor. It uses
//! additions, multiplications, divisions and square roots only, which IEEE 754
//! defines to the last bit: the scans are the same on every machine.

use super::{Values, World, WorldTime};
use crate::emulator::random::{Random, fraction, mix};

/// The steps at which a sensor measures.
const WINDOW: std::ops::RangeInclusive<usize> = 44..=725;

/// Cosine and sine of one step, 1/1024 of a full angle.
const STEP: (f64, f64) = (0.999_981_175_282_601_1, 0.006_135_884_649_154_475);

/// The speed of people.
const WALK_MM_PER_SECOND: f64 = 700.0;

/// A rectangular room with furniture, a doorway, a window, and people who walk.
///
/// Most points are distances. The others are error codes as a real sensor sends
/// them: 19 outside of steps 44..=725; 16 beyond 4,094 mm, 6 beyond 5.6 m, 0 beyond
/// 12 m; 1 to 5 where little light is reflected; 9 for one point in 300; 7 for a
/// point between two others without a distance.
///
/// The same seed results in the same scans at the same times, on every machine.
#[derive(Debug, Clone)]
pub struct Room {
    seed: u64,
    /// The distances of the walls: front, left, back and right.
    walls: [f64; 4],
    furniture: Vec<Thing>,
    people: Vec<Person>,
}

impl Room {
    /// Creates a room of 5.0 by 4.4 metres with two people, furnished by the seed.
    pub fn new(seed: u64) -> Self {
        Self::sized(seed, 5000, 4400, 2)
    }

    /// Creates a room of `length` (along the sensor's x axis) by `width` millimetres,
    /// at least 2,000 each, with this many people. The sensor stands a little behind
    /// and to the right of its middle.
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
            Thing::block((cupboard, left - 450.0), (cupboard + 900.0, left), 0.8),
            Thing::block((-0.4 * back, -right), (0.1 * front, 350.0 - right), 0.016),
            Thing::round((front - 300.0, left - 300.0), between(120.0, 180.0), 0.7),
            Thing::round((between(-0.5, -0.2) * back, 0.6 * left), 150.0, 0.5),
        ];
        // Only the four legs of the table are at the height of the beam.
        for (x, y) in [(0.0, 0.0), (700.0, 0.0), (0.0, 500.0), (700.0, 500.0)] {
            furniture.push(Thing::round((table.0 + x, table.1 + y), 30.0, 0.6));
        }
        let people = (0..people)
            .map(|_| {
                // In the front half, so that nobody walks through the sensor.
                let mut place =
                    || (between(0.3 * front, 0.85 * front), between(-0.75 * right, 0.8 * left));
                Person { from: place(), to: place(), ahead: between(0.0, 10_000.0) }
            })
            .collect();
        Self { seed, walls, furniture, people }
    }

    /// Returns the distance of the nearest surface in this direction, and the share
    /// of the light that it reflects to the sensor.
    fn beam(&self, direction: (f64, f64), legs: &[Thing]) -> (f64, f64) {
        let wall = self.wall(direction);
        self.furniture
            .iter()
            .chain(legs)
            .filter_map(|thing| thing.meet(direction))
            .fold(wall, |nearest, met| if met.0 < nearest.0 { met } else { nearest })
    }

    fn wall(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let [front, left, back, right] = self.walls;
        let along_x = if x > 0.0 { front / x } else { back / -x };
        let along_y = if y > 0.0 { left / y } else { right / -y };
        if along_x < along_y {
            let across = y * along_x;
            // A doorway in the front wall, with a corridor's wall behind it.
            if x > 0.0 && across > 0.1 * left && across < 0.1 * left + 800.0 {
                return ((front + 2500.0) / x, 0.8);
            }
            (along_x, 0.9 * x.abs())
        } else {
            let across = x * along_y;
            // A window in the left wall, and nothing behind it.
            if y > 0.0 && across > 0.55 * front && across < 0.55 * front + 500.0 {
                return (22_000.0, 1.0);
            }
            (along_y, 0.9 * y.abs())
        }
    }

    /// Returns the value for a beam that met a surface at `distance`.
    fn value(&self, (distance, light): (f64, f64), noise: u64) -> u16 {
        let spread = fraction(noise) + fraction(mix(noise)) - 1.0;
        let measured = distance + spread * (4.0 + 0.004 * distance);
        let metres = distance / 1000.0;
        match measured {
            _ if noise.is_multiple_of(300) => 9,
            d if d < 20.0 => 8,
            d if d > 12_000.0 => 0,
            d if d > 5_600.0 => 6,
            d if d > 4_094.0 => 16,
            _ if light < 0.004 * metres * metres => 1 + (noise % 5) as u16,
            d => d as u16,
        }
    }
}

impl Default for Room {
    /// [`Room::new`] with seed 0.
    fn default() -> Self {
        Self::new(0)
    }
}

impl World for Room {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        let legs: Vec<Thing> = self
            .people
            .iter()
            .flat_map(|person| person.legs(time.at.as_micros() as f64 / 1_000_000.0))
            .collect();
        let moment = mix(self.seed ^ mix(time.revolution.wrapping_add(1)));

        // Step 0 looks to the right rear, -135 degrees.
        let half = 0.5_f64.sqrt();
        let mut direction = (-half, -half);
        for (step, value) in values.iter_mut().enumerate() {
            if WINDOW.contains(&step) {
                let noise = mix(moment.wrapping_add(step as u64));
                *value = self.value(self.beam(direction, &legs), noise);
            }
            direction = (
                direction.0 * STEP.0 - direction.1 * STEP.1,
                direction.1 * STEP.0 + direction.0 * STEP.1,
            );
        }
        hide_lone_points(values);
    }
}

/// Replaces each distance between two error codes by error code 7, as the sensor does.
fn hide_lone_points(values: &mut Values) {
    let mut before = true;
    for step in WINDOW {
        let after = values.get(step + 1).is_none_or(|&value| value < 20);
        if let Some(value) = values.get_mut(step) {
            let is_distance = *value >= 20;
            if is_distance && before && after {
                *value = 7;
            }
            before = !is_distance;
        }
    }
}

/// An object with a surface.
#[derive(Debug, Clone, Copy)]
struct Thing {
    shape: Shape,
    /// The share of the light that its surface reflects.
    reflects: f64,
}

#[derive(Debug, Clone, Copy)]
enum Shape {
    Round { centre: (f64, f64), radius: f64 },
    Block { low: (f64, f64), high: (f64, f64) },
}

impl Thing {
    fn round(centre: (f64, f64), radius: f64, reflects: f64) -> Self {
        Self { shape: Shape::Round { centre, radius }, reflects }
    }

    fn block(low: (f64, f64), high: (f64, f64), reflects: f64) -> Self {
        Self { shape: Shape::Block { low, high }, reflects }
    }

    /// Returns the distance at which a beam from the sensor meets it, and the share of
    /// the light that is reflected: less at a flat angle.
    fn meet(&self, (x, y): (f64, f64)) -> Option<(f64, f64)> {
        let (distance, cosine) = match self.shape {
            Shape::Round { centre, radius } => {
                let nearest = centre.0 * x + centre.1 * y;
                let away = centre.0 * y - centre.1 * x;
                let inside = radius * radius - away * away;
                if inside < 0.0 {
                    return None;
                }
                (nearest - inside.sqrt(), inside.sqrt() / radius)
            }
            Shape::Block { low, high } => {
                let (x_in, x_out) = crossing(low.0 / x, high.0 / x);
                let (y_in, y_out) = crossing(low.1 / y, high.1 / y);
                if x_in.max(y_in) > x_out.min(y_out) {
                    return None;
                }
                (x_in.max(y_in), if x_in > y_in { x.abs() } else { y.abs() })
            }
        };
        (distance > 0.0).then_some((distance, self.reflects * cosine))
    }
}

fn crossing(a: f64, b: f64) -> (f64, f64) {
    (a.min(b), a.max(b))
}

/// A person who walks back and forth between two places.
#[derive(Debug, Clone)]
struct Person {
    from: (f64, f64),
    to: (f64, f64),
    /// The way walked before power-up, in millimetres.
    ahead: f64,
}

impl Person {
    /// Returns the two legs, which is all that a sensor at shin height meets.
    fn legs(&self, seconds: f64) -> [Thing; 2] {
        let (dx, dy) = (self.to.0 - self.from.0, self.to.1 - self.from.1);
        let way = (dx * dx + dy * dy).sqrt().max(1.0);
        let walked = self.ahead + WALK_MM_PER_SECOND * seconds;
        let along = back_and_forth(walked, way) / way;
        let (x, y) = (self.from.0 + dx * along, self.from.1 + dy * along);
        // The legs swing in opposite directions, by half a stride each.
        let stride = back_and_forth(walked, 350.0) - 175.0;
        let (ux, uy) = (dx / way, dy / way);
        let leg = |side: f64, swing: f64| {
            Thing::round((x + ux * swing - uy * side, y + uy * swing + ux * side), 65.0, 0.5)
        };
        [leg(110.0, stride), leg(-110.0, -stride)]
    }
}

/// Returns a position that moves from 0 to `length` and back as `distance` grows.
fn back_and_forth(distance: f64, length: f64) -> f64 {
    let phase = distance % (2.0 * length);
    if phase < length { phase } else { 2.0 * length - phase }
}
