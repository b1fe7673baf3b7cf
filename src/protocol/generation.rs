//! [`Protocol`]: the two protocols of Hokuyo's scanners.

use std::fmt;

/// Protocol that a sensor speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Protocol {
    /// SCIP 1.1: a URG-04LX after power-up, and its contemporaries.
    Scip1,
    /// SCIP 2: every newer model, and a URG-04LX that was asked for it.
    Scip2,
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Scip1 => "SCIP 1.1",
            Self::Scip2 => "SCIP 2",
        })
    }
}
