//! Chooses what each `G` asks for, so that its echo tells its reply from those
//! to other `G`s that may still be on their way.

use crate::Window;

/// How many steps a fence can have.
const STEPS: u16 = 769;

/// What was asked for lately.
#[derive(Debug, Default)]
pub(crate) struct UniqueRequests {
    /// The windows of the last `G`s, polls and fences, the newest first.
    recent: [Option<Window>; Window::MAX_EXTRA_POINTS as usize],
    /// The steps that were asked for alone since the last answered fence: a
    /// fence must be none of them.
    single: [u64; STEPS.div_ceil(64) as usize],
    /// The step of the next fence.
    fence: u16,
}

impl UniqueRequests {
    /// Begins anywhere: what a program that has ended asked for may still be
    /// answered, and must not be answered to the first fence of the next one.
    pub(crate) fn starting(seed: u64) -> Self {
        Self { fence: (seed % u64::from(STEPS)) as u16, ..Self::default() }
    }

    /// What to ask for in order to get `window`: that, or more points; and how
    /// many of those to skip in front.
    ///
    /// It differs from the `G`s before as far as the window leaves room for
    /// that, so that even a reply that a faulty line delivers twice is never
    /// taken for the next.
    pub(crate) fn poll(&mut self, window: Window) -> (Window, usize) {
        let age = |asked: &Window| {
            let place = self.recent.iter().position(|recent| recent.as_ref() == Some(asked));
            place.unwrap_or(self.recent.len())
        };
        // Of those that are equally old the last one wins: that without surplus.
        let (asked, surplus) = (0..=self.recent.len() as u16)
            .rev()
            .filter_map(|groups| window.widened(groups))
            .max_by_key(|(asked, _)| age(asked))
            .unwrap_or((window, 0));
        self.note(asked);
        (asked, surplus)
    }

    /// The single step to ask for as a fence: one that nothing else was asked
    /// for, so that an older reply is never taken for the answer to it.
    pub(crate) fn fence(&mut self) -> Window {
        for _ in 0..STEPS {
            if !self.was_asked_alone(self.fence) {
                break;
            }
            self.fence = (self.fence + 1) % STEPS;
        }
        let window = Window::single(self.fence);
        self.fence = (self.fence + 1) % STEPS;
        self.note(window);
        window
    }

    /// A fence was answered: no older reply is on its way.
    pub(crate) fn clear(&mut self) {
        self.single = Default::default();
    }

    fn note(&mut self, window: Window) {
        self.recent.rotate_right(1);
        if let Some(newest) = self.recent.first_mut() {
            *newest = Some(window);
        }
        let step = window.start().number();
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
        // Widened to the right there is a second step; to the left there is one.
        assert_eq!(unique_requests.poll(Window::single(1)), (Window::single(1), 0));
        assert_eq!(unique_requests.poll(Window::single(3)), (Window::single(3), 0));
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

    #[test]
    fn a_poll_differs_from_the_fence_before_it() {
        let mut unique_requests = UniqueRequests::default();
        let fence = unique_requests.fence();
        let (asked, surplus) = unique_requests.poll(fence);
        assert_ne!(asked, fence);
        assert_eq!(asked.points(), 2);
        assert_eq!(surplus, 0);
    }
}
