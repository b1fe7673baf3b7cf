//! Random numbers that are equal on every machine.

use std::ops::Range;
use std::time::Duration;

/// Returns the seeds of a model: the number of them that `name` sets, or [`times`] `usual`, from the
/// one that `NAME_FIRST` sets.
pub(crate) fn seeds(name: &str, usual: u64) -> Range<u64> {
    let first = number(&format!("{name}_FIRST")).unwrap_or(0);
    first..first + number(name).unwrap_or(times() * usual)
}

/// Returns how many times the usual seeds to run: `SCIP_TIMES`, which CI sets, or once.
pub(crate) fn times() -> u64 {
    number("SCIP_TIMES").unwrap_or(1)
}

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().unwrap_or_else(|_| panic!("{name}={text}")))
}

/// The splitmix64 generator (Steele, Lea and Flood, 2014).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }

    /// Returns true once in `times` calls on average.
    pub(crate) fn once_in(&mut self, times: u64) -> bool {
        self.below(times) == 0
    }

    pub(crate) fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.below(from.len() as u64) as usize]
    }

    pub(crate) fn ms(&mut self, bound: u64) -> Duration {
        Duration::from_millis(self.below(bound))
    }
}
