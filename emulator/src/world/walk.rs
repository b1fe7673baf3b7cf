//! [`Walk`]: the way of something that moves, and the legs of a person on it.

use std::time::Duration;

use super::surface::{Surface, Vector, millimetres};

/// Usual speed of a person, in metres per second.
pub(super) const WALKING_SPEED: f64 = 0.7;

/// Straight path at constant speed.
///
/// Positions are in metres, x forward and y left of the sensor; times count from the
/// sensor's first or latest power-up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Walk {
    from: Vector,
    to: Vector,
    starts_at: Duration,
    /// In metres per second.
    speed: f64,
    /// Turns around at each end and never leaves.
    repeats: bool,
}

/// Point of a walk, in millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stride {
    pub(super) position: Vector,
    /// Direction from the start to the end of the walk.
    pub(super) heading: Vector,
    /// Distance walked so far.
    pub(super) walked: f64,
}

impl Walk {
    /// Creates a walk from one position to another, in metres: at 0.7 m/s, once, starting
    /// at power-up. Before and after the walk, the person or disc is absent.
    pub fn new(from: (f64, f64), to: (f64, f64)) -> Self {
        Self { from, to, starts_at: Duration::ZERO, speed: WALKING_SPEED, repeats: false }
    }

    /// Sets when the walk starts, counted from power-up.
    #[must_use]
    pub fn starting_at(mut self, time: Duration) -> Self {
        self.starts_at = time;
        self
    }

    /// Sets the speed in metres per second, at least 0.001.
    #[must_use]
    pub fn speed(mut self, metres_per_second: f64) -> Self {
        self.speed = metres_per_second.max(0.001);
        self
    }

    /// Makes the walk go back and forth between its ends for ever.
    #[must_use]
    pub fn back_and_forth(mut self) -> Self {
        self.repeats = true;
        self
    }

    /// Time that the walk takes in one direction.
    pub fn duration(&self) -> Duration {
        let (dx, dy) = (self.to.0 - self.from.0, self.to.1 - self.from.1);
        let seconds = (dx * dx + dy * dy).sqrt() / self.speed;
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
    }

    /// Position at `time` after power-up, in metres, or `None` before the start and after the end.
    /// The legs of a person are beside it, up to 0.3 m away.
    pub fn position(&self, time: Duration) -> Option<(f64, f64)> {
        self.at(time).map(|Stride { position: (x, y), .. }| (x / 1000.0, y / 1000.0))
    }

    /// Point of the walk at `time` after power-up, or `None` before its start and after its end.
    pub(super) fn at(&self, time: Duration) -> Option<Stride> {
        let since = time.checked_sub(self.starts_at)?;
        if !self.repeats && since > self.duration() {
            return None;
        }
        let walked = self.speed * 1000.0 * (since.as_micros() as f64 / 1_000_000.0);
        Some(Stride::between(millimetres(self.from), millimetres(self.to), walked))
    }
}

impl Stride {
    /// Point after walking `walked` millimetres back and forth between two positions.
    pub(super) fn between(from: Vector, to: Vector, walked: f64) -> Self {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let way = (dx * dx + dy * dy).sqrt().max(1.0);
        let along = back_and_forth(walked, way) / way;
        Self {
            position: (from.0 + dx * along, from.1 + dy * along),
            heading: (dx / way, dy / way),
            walked,
        }
    }

    /// Two legs of a person: a sensor at shin height meets nothing else.
    pub(super) fn legs(&self) -> [Surface; 2] {
        let Self { position: (x, y), heading: (ux, uy), walked } = *self;
        // The legs swing in opposite directions, by half a stride each.
        let stride = back_and_forth(walked, 350.0) - 175.0;
        let leg = |side: f64, swing: f64| {
            Surface::disc((x + ux * swing - uy * side, y + uy * swing + ux * side), 65.0, 0.5)
        };
        [leg(110.0, stride), leg(-110.0, -stride)]
    }
}

/// Position that moves from 0 to `length` and back as `distance` grows.
fn back_and_forth(distance: f64, length: f64) -> f64 {
    let phase = distance % (2.0 * length);
    if phase < length { phase } else { 2.0 * length - phase }
}
