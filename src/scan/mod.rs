//! Scans: the values of one reply to `G`, with their geometry and times.
//!
//! Rays and points come from the scan itself. A [`Pose`] moves points to another frame. To test a
//! function that takes a `&Scan`, make one from any values with a [`ScanBuilder`].

mod angles;
mod builder;
#[cfg(feature = "serde")]
mod data;
mod pose;
mod ray;
#[expect(clippy::module_inception, reason = "it is named after its type")]
mod scan;
mod times;
mod values;

pub use self::builder::{ScanBuilder, ScanError};
pub use self::pose::Pose;
#[doc(no_inline)]
pub use self::ray::Point;
pub use self::ray::Ray;
#[doc(no_inline)]
pub use self::scan::Scan;
pub(crate) use self::scan::ScanMeta;
pub use self::times::{ScanTimes, StampQuality};
pub(crate) use self::values::Values;
