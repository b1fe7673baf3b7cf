//! Log lines of one test, while others run on other threads.

use std::sync::OnceLock;

use tracing::subscriber::{DefaultGuard, NoSubscriber};
use tracing::{Dispatch, Subscriber};

/// Sends what this thread logs to `subscriber`, until the guard is dropped.
///
/// While a process has a single subscriber, tracing asks the thread that first comes
/// to a place in the code whether its lines are wanted, and keeps the answer: a thread
/// of another test, which wants none, would silence that place for all. A second
/// subscriber makes tracing ask all of them.
pub(crate) fn collect(subscriber: impl Subscriber + Send + Sync + 'static) -> DefaultGuard {
    static SECOND: OnceLock<Dispatch> = OnceLock::new();
    SECOND.get_or_init(|| Dispatch::new(NoSubscriber::default()));
    tracing::subscriber::set_default(subscriber)
}
