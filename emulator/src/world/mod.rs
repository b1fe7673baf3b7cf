//! Surroundings that the sensor measures: the [`World`] trait, and [`Fixed`], whose
//! values are known in advance.
//!
//! `scene` and `room` are made of shapes (`surface`, `walk`), whose echoes `sweep`
//! turns into values, as seen from a `path`. `sparse` removes distances of any world.

mod path;
mod room;
mod scene;
mod sparse;
mod surface;
mod sweep;
mod walk;

use std::time::Duration;

use crate::models::Geometry;

pub use self::path::Path;
pub use self::room::Room;
pub use self::scene::Scene;
pub use self::sparse::Sparse;
pub use self::walk::Walk;

/// Number of steps in a full scan of a URG, 0..=768.
pub const STEPS: usize = 769;

/// One value for each step, at the step's index: a distance in millimetres, or a code for no
/// distance. A URG has 769 steps, and error codes from 0 to 19 (C-42-3320-A p. 7).
pub type Values = [u32];

/// When a world is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct WorldTime {
    /// Revolution whose distances are sent, 0 for the first one after power-up: the last
    /// one that had ended when the command was served.
    pub revolution: u64,
    /// Number of scans that this sensor sent before, over all its power-ups. Use it to tell each reply in your test from every other.
    pub request: u64,
    /// Time from power-up to the end of that revolution.
    pub at: Duration,
    /// Duration of that revolution.
    pub period: Duration,
    /// What the sensor measures.
    pub(crate) geometry: Geometry,
}

impl WorldTime {
    /// Time from power-up until the ray of a step was measured: the revolution of a URG ends at
    /// the rear, step 896.
    pub fn at_step(&self, step: usize) -> Duration {
        let until_end = usize::from(self.geometry.turn).saturating_sub(step) as u32;
        self.at.saturating_sub(self.period * until_end / self.geometry.resolution.into())
    }
}

/// Surroundings of an emulated sensor.
///
/// A world is called only when a scan is sent, while the emulated sensor is locked. It must not call the [`Emulator`](super::Emulator) that it belongs to, and
/// should not take long.
///
/// Closures implement it, too:
///
/// ```
/// use urg_emulator::{Emulator, Values, WorldTime};
///
/// // Every scan has its own number in its first point.
/// let emulator = Emulator::builder()
///     .world(|time: WorldTime, values: &mut Values| {
///         values.fill(1234);
///         values[44] = 20 + (time.request % 4000) as u32;
///     })
///     .build();
/// ```
pub trait World: Send {
    /// Fills in the value of each step. Before the call, all values say that the step is not
    /// measured: 19 for a URG. A URG in SCIP 1.1 sends only the low
    /// 12 bits, SCIP 2 the low 18 bits.
    fn measure(&mut self, time: WorldTime, values: &mut Values);

    /// Fills in the intensity of each step, for the models that measure it. By default about as in
    /// scans of real UST-10LX: `2,000,000 / (1000 + value)` and at least 370, or 0 without a distance.
    fn measure_intensities(&mut self, time: WorldTime, values: &Values, intensities: &mut Values) {
        let _ = time;
        for (intensity, value) in intensities.iter_mut().zip(values) {
            *intensity = match value {
                0..20 | 65_533 => 0,
                value => (2_000_000 / value.saturating_add(1000)).max(370),
            };
        }
    }
}

impl<F: FnMut(WorldTime, &mut Values) + Send> World for F {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        self(time, values);
    }
}

/// World with the same values at any time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fixed(Vec<u32>);

impl Fixed {
    /// Creates a world with these values from step 0 on. The last one repeats.
    pub fn new(values: impl Into<Vec<u32>>) -> Self {
        Self(values.into())
    }

    /// Creates a world with the same value at every step.
    pub fn filled(value: u32) -> Self {
        Self(vec![value])
    }
}

impl World for Fixed {
    fn measure(&mut self, _: WorldTime, values: &mut Values) {
        let last = self.0.last().into_iter().cycle();
        values.iter_mut().zip(self.0.iter().chain(last)).for_each(|(slot, value)| *slot = *value);
    }
}
