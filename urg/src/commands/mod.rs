//! Commands, one file each. `check`, `record`, `stream` and `view` have their own modules.

pub(crate) mod baud;
pub(crate) mod cut;
pub(crate) mod emulate;
pub(crate) mod info;
pub(crate) mod laser;
pub(crate) mod list;
pub(crate) mod packaging;
#[cfg_attr(
    not(any(feature = "dds", feature = "zenoh", feature = "foxglove")),
    path = "publish_absent.rs"
)]
pub(crate) mod publish;
pub(crate) mod repair;
pub(crate) mod scan;
#[cfg_attr(not(feature = "serve"), path = "serve_absent.rs")]
pub(crate) mod serve;
