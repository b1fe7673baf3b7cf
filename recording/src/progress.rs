//! [`Progress`]: counts of a running recording.

/// Progress of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[non_exhaustive]
pub struct Progress {
    /// Scans in the file, or on their way into it.
    pub scans: u64,
    /// Replies in the file, or on their way into it.
    pub replies: u64,
    /// Bytes written.
    pub bytes: u64,
    /// Files started: 1, plus 1 for each split.
    pub files: u64,
    /// Scans missing from the file because the disk was too slow for too long (up to 8 MiB
    /// wait for it), or had failed.
    pub lost: u64,
    /// Replies missing from the file, for the same reasons.
    pub lost_replies: u64,
    /// Syncs that took longer than the [interval](super::RecorderBuilder::sync_interval):
    /// if the power fails, you may then lose more than two seconds.
    pub late_syncs: u64,
    /// True if the file system cannot sync: if the power fails, you may lose more.
    pub cannot_sync: bool,
    /// True if an old file could not be removed: all files together may be larger than
    /// [asked](super::RecorderBuilder::keep_bytes).
    pub cannot_remove: bool,
    /// True if a file might not grow (EFBIG), and the recording continued in a further one before
    /// the limit of its own.
    pub has_outgrown_file: bool,
}
