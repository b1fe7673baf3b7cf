//! [`Timer`]: a timer that is kept, and the retries of calls that a port refused.

use std::future::{Future, poll_fn};
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::time::{Instant, Sleep, sleep_until};

/// Delay before a refused call is retried.
const RETRY: Duration = Duration::from_millis(5);

/// Timer that is kept from one exchange to the next. With a new timer each time, tokio
/// wakes its I/O driver by a system call, even from its own thread. Moving a timer to a
/// later time costs next to nothing.
#[derive(Debug, Default)]
pub(crate) struct Timer(Option<Pin<Box<Sleep>>>);

impl Timer {
    pub(crate) async fn wait(&mut self, at: Instant) {
        poll_fn(|cx| self.poll(cx, at)).await;
    }

    pub(crate) fn poll(&mut self, cx: &mut Context<'_>, at: Instant) -> Poll<()> {
        let timer = self.0.get_or_insert_with(|| Box::pin(sleep_until(at)));
        if timer.deadline() != at {
            timer.as_mut().reset(at);
        }
        timer.as_mut().poll(cx)
    }
}

/// Returns `Pending` after a call that a signal interrupted or that the port refused for now, and
/// polls again after [`RETRY`]. Such a port has registered no waker, and may refuse forever.
pub(super) fn again_if_interrupted<T>(
    outcome: Poll<io::Result<T>>,
    timer: &mut Timer,
    cx: &mut Context<'_>,
) -> Poll<io::Result<T>> {
    use io::ErrorKind::{Interrupted, WouldBlock};
    match outcome {
        Poll::Ready(Err(error)) if matches!(error.kind(), Interrupted | WouldBlock) => {
            ready!(timer.poll(cx, Instant::now() + RETRY));
            cx.waker().wake_by_ref();
            Poll::Pending
        }
        outcome => outcome,
    }
}
