//! What every command that streams scans shares: merging scans and events, stopping,
//! reporting the link, and checking the rate. `urg stream` itself is `command`.

pub(crate) mod command;
pub(crate) mod feed;
pub(crate) mod follow;
pub(crate) mod health;
pub(crate) mod jitter;
pub(crate) mod rate_watch;
pub(crate) mod reporter;
