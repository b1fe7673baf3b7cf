//! Commands, one file each. `check`, `record`, `stream` and `view` have their own modules.

#[cfg(not(all(
    feature = "serve",
    feature = "view",
    any(feature = "dds", feature = "zenoh", feature = "foxglove")
)))]
pub(crate) mod absent;
pub(crate) mod baud;
pub(crate) mod cut;
pub(crate) mod emulate;
pub(crate) mod info;
pub(crate) mod laser;
pub(crate) mod list;
pub(crate) mod packaging;
#[cfg(any(feature = "dds", feature = "zenoh", feature = "foxglove"))]
pub(crate) mod publish;
pub(crate) mod reboot;
pub(crate) mod repair;
pub(crate) mod scan;
#[cfg(feature = "serve")]
pub(crate) mod serve;
