//! [`Progress`]: counts of a recording under way.

/// The progress of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Progress {
    /// Scans in the file, or on their way into it.
    pub scans: u64,
    /// Replies in the file, or on their way into it.
    pub replies: u64,
    /// Bytes written.
    pub bytes: u64,
    /// Files started: 1, and 1 more for each time the recording was split.
    pub files: u64,
    /// Scans that are not in the file because the disk was too slow for too long
    /// (8 MiB wait for it), or had failed.
    pub lost: u64,
    /// Replies that are not in the file, for the same reasons.
    pub lost_replies: u64,
}
