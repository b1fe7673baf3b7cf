//! Whether a sensor is connected and its scans are good: [`State`], [`StateWatch`] to await a
//! change, and [`Freshness`] to check against a limit.

mod counters;
mod freshness;
mod link_log;
mod link_state;
mod shared;
#[expect(clippy::module_inception, reason = "it is named after its type")]
mod state;
mod watch;

use std::sync::{Mutex, MutexGuard, PoisonError};

#[doc(no_inline)]
pub use self::freshness::Freshness;
pub use self::freshness::StaleError;
pub(crate) use self::link_state::{KnownFrame, LinkState, ParametersReply, VersionReply};
pub(crate) use self::shared::Shared;
#[doc(no_inline)]
pub use self::state::State;
#[cfg(feature = "serde")]
use self::state::{age, chain};
pub use self::watch::StateWatch;

#[inline(never)]
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Counters and plain values: always consistent.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
