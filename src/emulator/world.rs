//! What the sensor sees: the [`World`] trait, and worlds that are known in
//! advance. A room to look at is in `room`.

use std::fmt;
use std::time::Duration;

/// The steps of one revolution that a sensor reports on, 0..=768.
pub const STEPS: usize = 769;

/// One 12-bit code (0..=4095) for each step, at its number: a distance in
/// millimetres from 20, an error code from 0 to 19 (C-42-3320-A p. 7).
pub type Values = [u16; STEPS];

/// Error code 19, "Non-Measurable Distance": what a sensor sends for the steps
/// outside its window, 0..=43 and 726..=768.
pub(super) const FAR: u16 = 19;

/// When a world is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct WorldTime {
    /// The revolution whose distances are asked for, from 0 at power-up: the
    /// last one that was finished when the command was served.
    pub revolution: u64,
    /// How many `G` commands this sensor has sent distances for before, over
    /// all its power-ups. With it a test can tell each reply from every other.
    pub request: u64,
    /// When that revolution ended, after power-up.
    pub at: Duration,
}

/// What a sensor sees in one revolution.
///
/// A world is asked only when a `G` command is served, while the emulated
/// sensor is locked: it must not call the [`Emulator`](super::Emulator) that it
/// belongs to, and should not take long.
///
/// Implemented for closures, too:
///
/// ```
/// use tokio_scip::emulator::{Values, Emulator, WorldTime};
///
/// // Every scan carries its own number in its first point.
/// let emulator = Emulator::builder()
///     .world(|look: WorldTime, codes: &mut Values| {
///         codes.fill(1234);
///         codes[44] = 20 + (look.request % 4000) as u16;
///     })
///     .build();
/// ```
pub trait World: Send {
    /// Fills in all codes. They hold 19 for every step when it is called; only
    /// the low 12 bits are sent.
    fn look(&mut self, look: WorldTime, codes: &mut Values);
}

impl<F: FnMut(WorldTime, &mut Values) + Send> World for F {
    fn look(&mut self, look: WorldTime, codes: &mut Values) {
        self(look, codes);
    }
}

/// A world that is always the same, code by code.
#[derive(Clone, PartialEq, Eq)]
pub struct Fixed(pub Values);

impl Fixed {
    /// The same code at every step.
    pub fn filled(code: u16) -> Self {
        Self([code; STEPS])
    }
}

impl fmt::Debug for Fixed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Fixed").finish_non_exhaustive()
    }
}

impl World for Fixed {
    fn look(&mut self, _: WorldTime, codes: &mut Values) {
        *codes = self.0;
    }
}
