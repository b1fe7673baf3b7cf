//! The handle, streams and data in a service's tasks, and data as it leaves them.

mod auto_traits;
mod borrowed_state;
mod cancel;
mod errors;
mod names;
mod observer;
mod panics;
#[cfg(feature = "serde")]
mod serde;
