//! A stream of scans on its way to an output, whichever that is: its updates in
//! order, the end of it, the state of its link, and the rate that it reaches.

pub(crate) mod feed;
pub(crate) mod follow;
pub(crate) mod jitter;
pub(crate) mod link;
pub(crate) mod rate_watch;
pub(crate) mod reporter;
pub(crate) mod wire_speed;
