//! [`MotorStats`]: what the driver knows about the sensor's motor.

use std::time::Duration;

/// Motor of the sensor, measured from the arrivals of replies: see
/// [`guide::time`](crate::guide::time).
///
/// As data (feature `serde`) it has `jumps`, and in seconds `revolution` and `lateness`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct MotorStats {
    /// Duration of a revolution, once it is known to 0.1 %.
    pub revolution: Option<Duration>,
    /// Mean time from the end of a revolution to the arrival of its scan. Excludes the
    /// delay common to all scans, and scans that arrived unusually late.
    pub lateness: Duration,
    /// Number of times that the phase of the motor jumped since the link was found.
    pub jumps: u64,
}

#[cfg(feature = "serde")]
impl serde::Serialize for MotorStats {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;
        let mut motor = serializer.serialize_struct("MotorStats", 3)?;
        let revolution = self.revolution.map(|revolution| revolution.as_secs_f64());
        motor.serialize_field("revolution", &revolution)?;
        motor.serialize_field("lateness", &self.lateness.as_secs_f64())?;
        motor.serialize_field("jumps", &self.jumps)?;
        motor.end()
    }
}
