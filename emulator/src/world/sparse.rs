//! [`Sparse`]: another world with points missing, as in scans of real sensors.

use super::{Values, World, WorldTime};
use crate::random::{fraction, mix};

/// Another world, with error codes in place of some of its distances.
///
/// In captures of a real URG-04LX indoors 55 % of the points had no distance, mostly with
/// error codes 0, 6, 16 and 7, in runs of neighbouring steps that stay in place. If you
/// test your service only with [`Room`](super::Room), where 8 % are missing, it meets
/// such scans first in production.
///
/// ```
/// use urg_emulator::{Emulator, Room, Sparse};
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
    /// Removes the fraction `share` of the distances of `world`, 0 to 1, at positions
    /// drawn from the seed.
    pub fn new(world: W, share: f64, seed: u64) -> Self {
        Self { world, share: share.clamp(0.0, 1.0), seed }
    }
}

impl<W: World> World for Sparse<W> {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        self.world.measure(time, values);
        // Each block of steps misses one run of neighbours, so that the fraction is the
        // same in every part of the scan.
        let (geometry, window) = (time.geometry, time.geometry.window());
        let (mut block, mut first) = (0, *window.start());
        while first <= *window.end() {
            let drawn = mix(self.seed ^ mix(block + 1));
            let length = 8 << (drawn % 3);
            let missing = self.share * length as f64 + fraction(mix(drawn));
            let missing = (missing as usize).min(length);
            // Divided in 64 bits, so that 32-bit systems draw the same numbers.
            let start = ((drawn >> 8) % (length - missing + 1) as u64) as usize;
            let code = geometry.missing(fraction(mix(drawn ^ 1)));
            for step in first + start..first + start + missing {
                if let Some(value) = values.get_mut(step).filter(|_| window.contains(&step))
                    && geometry.is_distance(*value)
                {
                    *value = code;
                }
            }
            block += 1;
            first += length;
        }
        self.flicker(time, values);
    }

    fn measure_intensities(&mut self, time: WorldTime, values: &Values, intensities: &mut Values) {
        self.world.measure_intensities(time, values, intensities);
    }
}

impl<W> Sparse<W> {
    /// Also removes one in three distances next to a missing point, different ones in
    /// each revolution: the ends of a run are not sharp.
    fn flicker(&self, time: WorldTime, values: &mut Values) {
        if self.share == 0.0 {
            return;
        }
        let revolution = mix(self.seed ^ mix(time.revolution));
        let (geometry, before) = (time.geometry, values.to_vec());
        let window = geometry.window();
        for (step, value) in values.iter_mut().enumerate().filter(|(step, _)| window.contains(step))
        {
            let is_missing =
                |step: usize| before.get(step).is_none_or(|&value| !geometry.is_distance(value));
            let is_at_end = is_missing(step + 1) || is_missing(step.wrapping_sub(1));
            let noise = mix(revolution.wrapping_add(step as u64));
            if geometry.is_distance(*value) && is_at_end && noise.is_multiple_of(3) {
                *value = geometry.codes.flickering;
            }
        }
    }
}
