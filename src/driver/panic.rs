//! [`catch`]: turns a panic of the driver into an output, so that each caller gets it as the
//! cause. `std::thread::panicking` does not work: it is also true while another panic drops
//! the runtime and the driver with it.

use std::any::Any;
use std::future::{Future, poll_fn};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::task::Poll;

/// Payload of a panic, for `resume_unwind`.
pub(crate) type Payload = Box<dyn Any + Send>;

/// Runs `work` and catches its panic. Never polls `work` again after a panic; whatever it
/// borrows must tolerate that.
pub(crate) fn catch<T>(
    mut work: Pin<&mut impl Future<Output = T>>,
) -> impl Future<Output = Result<T, Payload>> {
    poll_fn(move |cx| match catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(cx))) {
        Ok(outcome) => outcome.map(Ok),
        Err(payload) => Poll::Ready(Err(payload)),
    })
}

/// Extracts the message of a panic.
pub(crate) fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    text.or(payload.downcast_ref::<&str>().copied()).unwrap_or("no message").to_owned()
}
