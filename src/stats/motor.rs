//! [`MotorStats`]: what the driver knows about the sensor's motor.

use std::time::Duration;

/// Motor of the sensor, measured from the arrivals of replies on its own USB port: see
/// [`guide::time`](crate::guide::time).
///
/// As data (feature `serde`) it has `revolution` in seconds, `jumps` and `clock_drift_ppm`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct MotorStats {
    /// Duration of a revolution.
    #[cfg_attr(feature = "serde", serde(serialize_with = "seconds"))]
    pub revolution: Duration,
    /// Number of times that the phase of the motor jumped since the link was found.
    pub jumps: u64,
    /// How much faster the sensor's clock runs than this computer's, in parts per million. `None` in
    /// SCIP 1.1, which does not send it.
    pub clock_drift_ppm: Option<i32>,
}

#[cfg(feature = "serde")]
fn seconds<S: serde::Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_secs_f64())
}
