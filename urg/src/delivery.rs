//! [`Delivery`]: which scans of a stream a command needs.

/// Which scans a consumer must receive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Delivery {
    /// Only the newest scan, for live display.
    Newest,
    /// All scans, for files. A slow consumer may lag by nearly two minutes; a replay waits for it.
    All,
}

impl Delivery {
    /// Number of scans that a stream buffers.
    pub(crate) fn ring_depth(self) -> usize {
        match self {
            Self::Newest => 1,
            Self::All => 1024,
        }
    }
}
