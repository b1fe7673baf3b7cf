//! The log lines of one test, while other tests run on other threads.

use std::sync::OnceLock;

use tracing::subscriber::{DefaultGuard, NoSubscriber};
use tracing::{Dispatch, Subscriber};

/// Sends what this thread logs to `subscriber` until the guard is dropped.
///
/// With a single subscriber in the process, tracing asks only the first thread that
/// reaches a log statement whether it is wanted, and caches the reply for all threads.
/// If that thread belongs to another test, the statement stays silent here. A second
/// subscriber makes tracing ask each one.
pub(crate) fn collect(subscriber: impl Subscriber + Send + Sync + 'static) -> DefaultGuard {
    static SECOND: OnceLock<Dispatch> = OnceLock::new();
    SECOND.get_or_init(|| Dispatch::new(NoSubscriber::default()));
    tracing::subscriber::set_default(subscriber)
}
