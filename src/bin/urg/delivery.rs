//! The choice between the newest scan and all scans, which decides how many a
//! stream keeps and whether a replay waits for its consumer.

/// The scans that a consumer has to get.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Delivery {
    /// The newest one, for eyes: older ones are dropped.
    Newest,
    /// All of them, for files: nearly two minutes of them wait for a consumer
    /// that is slow, and a replay waits for it without a limit.
    All,
}

impl Delivery {
    /// Returns the number of scans that a stream keeps.
    pub(crate) fn ring_depth(self) -> usize {
        match self {
            Self::Newest => 1,
            Self::All => 1024,
        }
    }
}
