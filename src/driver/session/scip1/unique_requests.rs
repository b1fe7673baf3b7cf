//! [`UniqueRequests`]: chooses the window of each `G`, so that its echo differs from
//! every other `G` whose reply may still be on its way.

use crate::Window;

/// Number of steps that a fence can ask for.
const STEPS: u16 = 769;

/// Window to request in place of another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) struct Widened {
    pub(in super::super) asked: Window,
    /// Index of the window's first value. The values before it are extra.
    pub(in super::super) first: usize,
    /// True if the latest `G` asked for the same: the window has no room to differ.
    pub(in super::super) repeats: bool,
}

/// Recently requested windows.
#[derive(Debug, Default)]
pub(in super::super) struct UniqueRequests {
    /// [Keys](Window::key) of the last `G`s, polls and fences, newest first.
    recent: [u64; Window::MAX_EXTRA_POINTS as usize],
    /// Steps requested alone since the last answered fence. The next fence must use another step.
    single: [u64; STEPS.div_ceil(64) as usize],
    /// Step of the next fence.
    fence: u16,
}

impl UniqueRequests {
    /// Starts at a random step, so that a reply to an earlier process's fence hardly ever matches ours.
    pub(in super::super) fn random() -> Self {
        Self { fence: fastrand::u16(..STEPS), ..Self::default() }
    }

    /// Chooses the window to request in order to get `window`: the same, or one with extra points.
    ///
    /// The choice differs from the latest `G`s as far as the window leaves room. Then
    /// even a reply that a faulty line delivers twice cannot match the next poll.
    pub(super) fn widen(&mut self, window: Window) -> Widened {
        let (asked, first) = self.choose(window);
        let repeats = self.is_latest(asked);
        self.record(asked);
        Widened { asked, first, repeats }
    }

    /// Returns true if the next request for `window` must have the echo of the latest `G`.
    pub(super) fn repeats(&self, window: Window) -> bool {
        self.is_latest(self.choose(window).0)
    }

    fn is_latest(&self, asked: Window) -> bool {
        self.recent.first() == Some(&asked.key())
    }

    fn choose(&self, window: Window) -> (Window, usize) {
        let (mut chosen, mut greatest_age) = ((window, 0), 0);
        // Of several equally old choices the last one wins, which has no points in front.
        for points in (0..=Window::MAX_EXTRA_POINTS).rev() {
            let Some(choice) = window.widened(points) else { continue };
            let age = self.age(choice.0);
            if age >= greatest_age {
                (chosen, greatest_age) = (choice, age);
            }
        }
        chosen
    }

    /// Number of `G`s since the latest one for this window.
    fn age(&self, asked: Window) -> usize {
        let place = self.recent.iter().position(|recent| *recent == asked.key());
        place.unwrap_or(self.recent.len())
    }

    /// Chooses the single step of a fence. No other `G` asked for it alone: no older reply matches.
    pub(super) fn fence(&mut self) -> Window {
        for _ in 0..STEPS {
            if !self.was_asked_alone(self.fence) {
                break;
            }
            self.fence = (self.fence + 1) % STEPS;
        }
        let window = Window::single(self.fence);
        self.fence = (self.fence + 1) % STEPS;
        self.record(window);
        window
    }

    /// Forgets the single steps: a fence was answered, so no older reply is on its way.
    pub(super) fn clear(&mut self) {
        self.single = Default::default();
    }

    fn record(&mut self, window: Window) {
        let [newest, second, _] = self.recent;
        self.recent = [window.key(), newest, second];
        let step = window.start();
        if window.steps() == 1
            && let Some(word) = self.single.get_mut(usize::from(step / 64))
        {
            *word |= 1 << (step % 64);
        }
    }

    fn was_asked_alone(&self, step: u16) -> bool {
        let word = self.single.get(usize::from(step / 64));
        word.is_some_and(|word| word & (1 << (step % 64)) != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fence_is_no_step_that_was_asked_for_since_the_last_answered_one() {
        let mut unique_requests = UniqueRequests::default();
        assert_eq!(unique_requests.fence(), Window::single(0));
        // Widening to the right adds a second step. Widening to the left leaves a single step.
        let alone = |asked| Widened { asked, first: 0, repeats: false };
        for step in [Window::single(1), Window::single(3)] {
            assert_eq!(unique_requests.widen(step), alone(step));
        }
        assert_eq!(unique_requests.fence(), Window::single(2));
        assert_eq!(unique_requests.fence(), Window::single(4));
        unique_requests.clear();
        unique_requests.fence = 1;
        assert_eq!(unique_requests.fence(), Window::single(1));
    }

    #[test]
    fn fences_go_round_all_steps_even_if_all_were_asked_for() {
        let mut unique_requests = UniqueRequests::default();
        let round: Vec<Window> = (0..STEPS).map(|_| unique_requests.fence()).collect();
        assert_eq!(round, (0..STEPS).map(Window::single).collect::<Vec<_>>());
        assert_eq!(unique_requests.fence(), Window::single(0));
    }
}
