//! [`Operation`]: what a failed command was for.

/// What the driver wanted of the sensor when a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Operation {
    /// To know which sensor it is.
    Identify,
    /// To switch the laser on.
    LaserOn,
    /// To switch the laser off.
    LaserOff,
    /// To change the baud rate.
    SetBaudRate,
    /// To get a scan, or to know whether the sensor answers.
    Scan,
}
