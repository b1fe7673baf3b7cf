//! [`UniqueRequests`]: chooses the window of each `G`, so that its echo differs from
//! every other `G` whose reply may still be on its way.

use crate::Window;

/// Number of steps that a fence can ask for.
const STEPS: u16 = 769;

/// Window to request in place of another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Widened {
    pub(crate) asked: Window,
    /// Index of the window's first value. The values before it are extra.
    pub(crate) first: usize,
    /// True if the latest `G` asked for the same: the window has no room to differ.
    pub(crate) repeats: bool,
}

/// Recently requested windows.
#[derive(Debug, Default)]
pub(crate) struct UniqueRequests {
    /// Windows of the last `G`s, polls and fences, newest first.
    recent: [Option<Window>; Window::MAX_EXTRA_POINTS as usize],
    /// Steps requested alone since the last answered fence. The next fence must use
    /// another step.
    single: [u64; STEPS.div_ceil(64) as usize],
    /// Step of the next fence.
    fence: u16,
}

impl UniqueRequests {
    /// Starts at a random step, so that a reply to an earlier process's fence hardly ever
    /// matches ours.
    pub(crate) fn starting(seed: u64) -> Self {
        Self { fence: (seed % u64::from(STEPS)) as u16, ..Self::default() }
    }

    /// Chooses the window to request in order to get `window`: the same window, or one
    /// with extra points.
    ///
    /// The choice differs from the latest `G`s as far as the window leaves room. Then
    /// even a reply that a faulty line delivers twice cannot match the next poll.
    pub(crate) fn widen(&mut self, window: Window) -> Widened {
        let (asked, first) = self.choose(window);
        let repeats = self.recent.first() == Some(&Some(asked));
        self.note(asked);
        Widened { asked, first, repeats }
    }

    fn choose(&self, window: Window) -> (Window, usize) {
        let age = |asked: &Window| {
            let place = self.recent.iter().position(|recent| recent.as_ref() == Some(asked));
            place.unwrap_or(self.recent.len())
        };
        // Of several equally old choices the last one wins, which has no points in front.
        (0..=self.recent.len() as u16)
            .rev()
            .filter_map(|groups| widened(window, groups))
            .max_by_key(|(asked, _)| age(asked))
            .unwrap_or((window, 0))
    }

    /// Chooses the single step to request as a fence. No other `G` asked for it alone, so
    /// no older reply can match it.
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

    /// Notes an answered fence: no older reply is on its way.
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

/// Returns true if the driver may request `asked` in order to get `window`.
#[cfg(feature = "mcap")]
pub(crate) fn is_widened(window: Window, asked: Window) -> bool {
    let widened = |groups| widened(window, groups);
    (0..=Window::MAX_EXTRA_POINTS).filter_map(widened).any(|(widened, _)| widened == asked)
}

/// Widens `window` by `groups` points in front or, without room there, behind. Also returns the
/// number of points to skip in front. Returns `None` if neither side has room. The points of the
/// window are the same in the wider one.
fn widened(window: Window, groups: u16) -> Option<(Window, usize)> {
    let cluster_count = window.cluster_count();
    let (start, end) = (window.start().number(), window.end().number());
    let steps = groups.saturating_mul(u16::from(cluster_count));
    let (steps, first) = match start.checked_sub(steps) {
        Some(start) => (start..=end, usize::from(groups)),
        // Steps after the end would fill up a partial last group.
        None if !window.steps().is_multiple_of(cluster_count.into()) => return None,
        None => (start..=end.saturating_add(steps), 0),
    };
    let window = Window::new(steps).ok()?.with_cluster_count(cluster_count).ok()?;
    Some((window, first))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(start: u16, end: u16, cluster_count: u8) -> Window {
        Window::new(start..=end).unwrap().with_cluster_count(cluster_count).unwrap()
    }

    /// First and last step of every point.
    fn points(window: Window) -> Vec<(u16, u16)> {
        let (end, group) = (window.end().number(), u16::from(window.cluster_count()));
        (window.start().number()..=end)
            .step_by(usize::from(group))
            .map(|first| (first, end.min(first + group - 1)))
            .collect()
    }

    #[test]
    fn a_widened_window_has_the_points_of_the_narrow_one_at_the_place_it_says() {
        let mut refused = 0;
        for start in 0..=768 {
            for end in [start, start + 1, start + 7, start + 41, 725, 764, 767, 768] {
                if end < start || end > 768 {
                    continue;
                }
                for cluster_count in [1, 2, 4, 5, 99] {
                    for groups in 0..4 {
                        let narrow = window(start, end, cluster_count);
                        let Some((wide, skip)) = widened(narrow, groups) else {
                            refused += 1;
                            continue;
                        };
                        assert_eq!(wide.points(), narrow.points() + usize::from(groups));
                        let kept = points(wide).into_iter().skip(skip).take(narrow.points());
                        assert!(kept.eq(points(narrow)), "{narrow} by {groups}");
                    }
                }
            }
        }
        assert!(refused > 0);
    }

    #[test]
    fn four_successive_polls_have_four_echoes_where_there_is_room() {
        for narrow in [Window::DETECTION, window(0, 765, 1), window(12, 768, 4), window(3, 768, 1)]
        {
            let echoes: Vec<Window> =
                (0..4).filter_map(|groups| widened(narrow, groups)).map(|(wide, _)| wide).collect();
            assert_eq!(echoes.len(), 4, "{narrow}");
            for (index, echo) in echoes.iter().enumerate() {
                assert!(!echoes.iter().skip(index + 1).any(|other| other == echo), "{narrow}");
            }
        }
        assert_eq!(widened(Window::FULL, 1), None);
        assert_eq!(widened(window(2, 767, 1), 3), None);
        // Steps after the end would fill up the partial last group.
        assert_eq!(widened(window(0, 10, 4), 1), None);
        assert_eq!(widened(window(0, 11, 4), 1), Some((window(0, 15, 4), 0)));
        assert_eq!(widened(window(0, 98, 99), u16::MAX), None);
    }

    #[test]
    fn a_fence_is_no_step_that_was_asked_for_since_the_last_answered_one() {
        let mut unique_requests = UniqueRequests::default();
        assert_eq!(unique_requests.fence(), Window::single(0));
        // Widening to the right adds a second step. Widening to the left leaves a single
        // step.
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
    fn the_first_fence_is_a_step_that_the_seed_selects() {
        for (seed, step) in [(7, 7), (768, 768), (769, 0), (u64::from(STEPS) * 5 + 3, 3)] {
            assert_eq!(UniqueRequests::starting(seed).fence(), Window::single(step), "{seed}");
        }
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
        let Widened { asked, first, repeats } = unique_requests.widen(fence);
        assert!(!repeats);
        assert_ne!(asked, fence);
        assert_eq!(asked.points(), 2);
        assert_eq!(first, 0);
    }
}
