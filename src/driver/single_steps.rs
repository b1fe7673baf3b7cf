//! A set of single-step windows.

use crate::Window;

/// Which windows `G{n}{n}01` were asked for: a fence must be none of them.
#[derive(Debug, Default)]
pub(crate) struct SingleSteps {
    bits: [u64; Self::COUNT.div_ceil(64) as usize],
}

impl SingleSteps {
    /// How many steps there are.
    pub(crate) const COUNT: u16 = 769;

    /// Adds the window, if it is one of a single step and no clusters.
    pub(crate) fn insert(&mut self, window: Window) {
        if window.steps() == 1
            && let Some(word) = self.bits.get_mut(usize::from(window.start().number() / 64))
        {
            *word |= 1 << (window.start().number() % 64);
        }
    }

    pub(crate) fn contains(&self, step: u16) -> bool {
        let word = self.bits.get(usize::from(step / 64));
        word.is_some_and(|word| word & (1 << (step % 64)) != 0)
    }

    pub(crate) fn clear(&mut self) {
        self.bits = Default::default();
    }
}
