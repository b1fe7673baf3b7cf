//! [`DeadlineTimer`]: one timer for all deadlines of a link, one after another.
//!
//! Reuses one timer. A new timer per exchange makes tokio wake its I/O driver
//! with a system call each time, even from its own thread. Moving a timer to a
//! later time costs next to nothing, and is done only where work has to wait.

use std::future::{Future, poll_fn};
use std::pin::{Pin, pin};
use std::task::Poll;

use tokio::task::coop::{has_budget_remaining, unconstrained};
use tokio::time::{Instant, Sleep, sleep_until};

/// A timer that is kept from one exchange to the next.
#[derive(Debug, Default)]
pub(crate) struct DeadlineTimer {
    timer: Option<Pin<Box<Sleep>>>,
}

impl DeadlineTimer {
    /// Returns the output of `work`, or `None` at the deadline. Polls the work
    /// first: work that is done at its deadline counts.
    pub(crate) async fn run<T>(
        &mut self,
        deadline: Instant,
        work: impl Future<Output = T>,
    ) -> Option<T> {
        let mut work = pin!(work);
        poll_fn(|cx| {
            // Out of budget, work returns `Pending` though it may be done.
            if !has_budget_remaining() {
                cx.waker().wake_by_ref();
                return Poll::Pending;
            }
            if let Poll::Ready(done) = work.as_mut().poll(cx) {
                return Poll::Ready(Some(done));
            }
            let timer = self.timer.get_or_insert_with(|| Box::pin(sleep_until(deadline)));
            if timer.deadline() != deadline {
                timer.as_mut().reset(deadline);
            }
            // Also where the work has used up the task's budget.
            pin!(unconstrained(timer.as_mut())).poll(cx).map(|()| None)
        })
        .await
    }
}

#[cfg(test)]
mod tests {
    use tokio::sync::mpsc;
    use tokio::task::coop::consume_budget;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn work_that_is_done_is_seen_by_a_task_without_budget_though_it_is_late() {
        let (sender, mut receiver) = mpsc::channel(1);
        assert!(sender.send(7).await.is_ok());
        let mut timer = DeadlineTimer::default();
        while has_budget_remaining() {
            consume_budget().await;
        }
        assert_eq!(timer.run(Instant::now(), receiver.recv()).await, Some(Some(7)));
        assert_eq!(timer.run(Instant::now(), receiver.recv()).await, None);
    }
}
