//! [`PollTimer`]: waits for the next poll without needless system calls.
//!
//! If a timer is registered that ends before all others, tokio writes to an eventfd to wake
//! its thread, even from that thread, and `epoll_wait` returns for nothing: two of the eight
//! system calls of a scan. So this timer has a companion that is always one poll ahead: it
//! is moved there while the wait for the next poll is registered, which costs nothing, and
//! when the next wait begins it is the earliest timer already.

use std::future::{Future, poll_fn};
use std::pin::{Pin, pin};
use std::task::{Context, Poll, Waker};

use tokio::task::coop::unconstrained;
use tokio::time::{Instant, Sleep, sleep_until};

/// A timer for one poll after another.
#[derive(Debug, Default)]
pub(crate) struct PollTimer {
    /// Ends with the wait after the current one. Wakes nobody.
    ahead: Option<Pin<Box<Sleep>>>,
}

impl PollTimer {
    /// Waits until `due`. The wait after this one is expected to end at `next`, which may be
    /// wrong: then it takes the two system calls. Cancel-safe.
    pub(crate) async fn wait(&mut self, due: Instant, next: Option<Instant>) {
        let mut sleep = pin!(sleep_until(due));
        poll_fn(|cx| {
            // First: it must be registered while the companion still ends with it.
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
