//! [`PollTimer`]: waits for the next poll without needless system calls.
//!
//! When a timer becomes the earliest one, tokio writes to an eventfd to wake its thread,
//! even from that thread. `epoll_wait` then returns for nothing: two of the eight system
//! calls of a scan. So this timer has a companion that is always one poll ahead. Moving the
//! companion is free while the wait for the next poll is registered. When the next wait
//! begins, the companion already is the earliest timer.

use std::future::{Future, poll_fn};
use std::pin::{Pin, pin};
use std::task::{Context, Poll, Waker};

use tokio::task::coop::unconstrained;
use tokio::time::{Instant, Sleep, sleep_until};

/// Timer for one poll after another.
#[derive(Debug, Default)]
pub(crate) struct PollTimer {
    /// Fires at the end of the wait after the current one. Wakes no task.
    ahead: Option<Pin<Box<Sleep>>>,
}

impl PollTimer {
    /// Waits until `due`. `next` is when the following wait should end; if it is wrong, that
    /// wait costs the two system calls. Cancel-safe.
    pub(crate) async fn wait(&mut self, due: Instant, next: Option<Instant>) {
        let mut sleep = pin!(sleep_until(due));
        poll_fn(|cx| {
            // First, while the companion still fires at the same time.
            let is_due = sleep.as_mut().poll(cx);
            if let (Poll::Pending, Some(next)) = (is_due, next) {
                self.move_ahead(next);
            }
            is_due
        })
        .await;
    }

    fn move_ahead(&mut self, next: Instant) {
        let ahead = self.ahead.get_or_insert_with(|| Box::pin(sleep_until(next)));
        if ahead.deadline() != next {
            ahead.as_mut().reset(next);
        }
        // Registers it the first time.
        let _ = pin!(unconstrained(ahead.as_mut())).poll(&mut Context::from_waker(Waker::noop()));
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn the_companion_ends_with_the_wait_after_the_current_one() {
        let second = |number| Instant::now() + Duration::from_secs(number);
        let dues = [1, 2, 3, 4].map(second);
        let mut timer = PollTimer::default();
        for due in dues.windows(2) {
            timer.wait(due[0], Some(due[1])).await;
            assert_eq!(Instant::now(), due[0]);
            assert_eq!(timer.ahead.as_ref().map(|ahead| ahead.deadline()), Some(due[1]));
        }
    }
}
