//! The deadlines of a session, one after the other on one timer.

use std::future::Future;
use std::pin::Pin;

use tokio::task::coop::unconstrained;
use tokio::time::{Instant, Sleep, sleep_until};

/// A timer that is kept from one exchange to the next.
///
/// A timer of its own for each would be the runtime's next one each time, of
/// which the runtime tells the thread that waits for I/O by a system call, its
/// own thread too. Moving a timer to a later time costs next to nothing.
#[derive(Debug, Default)]
pub(crate) struct Alarm {
    timer: Option<Pin<Box<Sleep>>>,
}

impl Alarm {
    /// What `work` gives, or `None` at the deadline. Looks at the work first.
    pub(crate) async fn limit<T>(
        &mut self,
        deadline: Instant,
        work: impl Future<Output = T>,
    ) -> Option<T> {
        let timer = self.timer.get_or_insert_with(|| Box::pin(sleep_until(deadline)));
        timer.as_mut().reset(deadline);
        tokio::select! {
            biased;
            done = work => Some(done),
            // Also where the work has used up all that a task may do at a time.
            () = unconstrained(timer.as_mut()) => None,
        }
    }
}
