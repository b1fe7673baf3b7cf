//! [`Sparse`]: another world with points missing, as in scans of real sensors.

use super::sweep::WINDOW;
use super::{Values, World, WorldTime};
use crate::emulator::random::{fraction, mix};

/// Error codes in the order of their frequency in captures of a real URG-04LX, each
/// with the share of the runs that it and those before it have.
const CODES: [(u16, f64); 4] = [(0, 0.40), (6, 0.70), (16, 0.88), (7, 1.0)];

/// A world in which a share of the points has an error code and no distance.
///
/// In captures of a real URG-04LX indoors 55 % of the points had none, mostly with
/// error codes 0, 6, 16 and 7, in runs of neighbouring steps that stay in place. A
/// service that was tested with [`Room`](super::Room) alone, where 8 % are missing, meets
/// them first at its users'.
///
/// ```
/// use tokio_scip::emulator::{Emulator, Room, Sparse};
///
/// let emulator = Emulator::builder().world(Sparse::new(Room::new(0), 0.5, 0)).build();
/// ```
#[derive(Debug, Clone)]
pub struct Sparse<W> {
    world: W,
    share: f64,
    seed: u64,
}

impl<W: World> Sparse<W> {
    /// Removes a `share` of the distances of `world`, 0 to 1, at places drawn from the
    /// seed.
    pub fn new(world: W, share: f64, seed: u64) -> Self {
        Self { world, share: share.clamp(0.0, 1.0), seed }
    }
}

impl<W: World> World for Sparse<W> {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        self.world.measure(time, values);
        // In each block of steps one run of neighbours is missing, of the share's length,
        // so that the share holds for every part of the scan.
        let (mut block, mut first) = (0, *WINDOW.start());
        while first <= *WINDOW.end() {
            let drawn = mix(self.seed ^ mix(block + 1));
            let length = 8 << (drawn % 3);
            let missing = self.share * length as f64 + fraction(mix(drawn));
            let missing = (missing as usize).min(length);
            // Divided in 64 bits, so that 32-bit systems draw the same.
            let start = ((drawn >> 8) % (length - missing + 1) as u64) as usize;
            let code = code(fraction(mix(drawn ^ 1)));
            for step in first + start..first + start + missing {
                if let Some(value) = values.get_mut(step).filter(|_| WINDOW.contains(&step))
                    && *value >= 20
                {
                    *value = code;
                }
            }
            block += 1;
            first += length;
        }
        self.flicker(time, values);
    }
}

impl<W> Sparse<W> {
    /// Makes one in three distances next to a missing point miss, too, others in each
    /// revolution: the ends of a run are not sharp.
    fn flicker(&self, time: WorldTime, values: &mut Values) {
        if self.share == 0.0 {
            return;
        }
        let revolution = mix(self.seed ^ mix(time.revolution));
        let before = *values;
        for (step, value) in values.iter_mut().enumerate().filter(|(step, _)| WINDOW.contains(step))
        {
            let is_missing = |step: usize| before.get(step).is_none_or(|&value| value < 20);
            let is_at_end = is_missing(step + 1) || is_missing(step.wrapping_sub(1));
            let noise = mix(revolution.wrapping_add(step as u64));
            if *value >= 20 && is_at_end && noise.is_multiple_of(3) {
                *value = 7;
            }
        }
    }
}

fn code(drawn: f64) -> u16 {
    CODES.iter().find(|(_, up_to)| drawn < *up_to).map_or(0, |(code, _)| *code)
}
