//! [`RecordingError`].

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::left_out::{LeftOut, listed};

/// Error of recording, reading or replaying. As for all errors of this crate, `Display` covers its own layer,
/// [`source`](std::error::Error::source) returns the cause, and clones are cheap.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file exists, and you did not ask to overwrite it.
    #[error("{} already exists: choose another name, or allow overwriting", path.display())]
    Exists {
        /// Path of the file.
        path: PathBuf,
    },
    /// The frame of the scans is no name that tf2 accepts ([`ros::is_frame_id`](super::ros::is_frame_id)).
    #[error(
        "invalid frame {frame_id:?}: expected a name such as laser, without a leading `/`, blanks and \
         control characters"
    )]
    FrameId {
        /// What was found.
        frame_id: String,
    },
    /// Another recorder writes the file.
    #[error("{} is being recorded into by another recorder: choose another name", path.display())]
    Busy {
        /// Path of the file.
        path: PathBuf,
    },
    /// The file was removed, cut short or written to by another program. The recording has ended.
    #[error("the recording has ended, and may be lost: its file {reason} by another program")]
    Gone {
        /// What happened to the file.
        reason: &'static str,
    },
    /// Creating or opening the file failed.
    #[error("cannot open {}", path.display())]
    Open {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: Arc<io::Error>,
    },
    /// Writing failed, and the recording has ended. You can read what was written before.
    #[error(
        "writing the recording failed: it has ended, but everything written before can be read"
    )]
    Write {
        /// Error of the system.
        source: Arc<io::Error>,
    },
    /// Reading failed, so the rest of the file was not read.
    #[error("reading the recording failed")]
    Read {
        /// Error of the system.
        source: Arc<io::Error>,
    },
    /// This is not an MCAP file.
    #[error("not a recording: expected an MCAP file, found other bytes at its start")]
    NotMcap,
    /// The file is a bag in another format.
    #[error(
        "cannot read {}: expected an MCAP file, found {found}; {}",
        path.display(), conversion(path)
    )]
    OtherFormat {
        /// Path of the file.
        path: PathBuf,
        /// Name of the format.
        found: &'static str,
    },
    /// The folder has no recording.
    #[error(
        "no recording in the folder {}: {reason}; expected one made by `ros2 bag record --storage mcap`",
        path.display()
    )]
    Folder {
        /// Path of the folder.
        path: PathBuf,
        /// What is missing.
        reason: &'static str,
    },
    /// This build does not write the compression: feature `compression` writes `lz4`, feature `zstd` both.
    #[error(
        "cannot compress with {compression}: build with the feature `{}`",
        feature(compression)
    )]
    NotWritten {
        /// Name of the compression.
        compression: String,
    },
    /// The file's chunks are compressed, and this build does not read the compression. Feature
    /// `compression` reads `zstd` and `lz4`.
    #[error("cannot read a recording with `{compression}` compression: {}", remedy(compression))]
    Compressed {
        /// Name of the compression.
        compression: String,
    },
    /// A part of the file is malformed: a chunk, about a second of a recording. Reading
    /// continues after it. A missing end of the file is not an error.
    #[error("the recording is damaged at byte {offset}: {reason}")]
    Damaged {
        /// Position of the malformed part in the file.
        offset: u64,
        /// Check that failed.
        reason: &'static str,
    },
    /// The recording has neither replies to polls nor messages with scans of a URG.
    #[error(
        "no scan in this recording: expected replies of a sensor, or sensor_msgs/msg/LaserScan of a URG on the topic {topic}{}{}",
        listed(left_out),
        instead(left_out, topics, others)
    )]
    NoScans {
        /// Topic that was read: `/scan`, or what you passed to [`Recording::topic`](super::Recording::topic).
        topic: String,
        /// Messages that were read and are no scan.
        left_out: Vec<LeftOut>,
        /// Other topics with laser scans, at most 16.
        topics: Vec<String>,
        /// Topics with messages of other types, at most 16: `/tf (tf2_msgs/msg/TFMessage)`.
        others: Vec<String>,
    },
}

impl RecordingError {
    pub(super) fn open(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::Open { path: path.into(), source: Arc::new(error) }
    }

    pub(super) fn read(error: io::Error) -> Self {
        Self::Read { source: Arc::new(error) }
    }

    pub(super) fn write(error: io::Error) -> Self {
        match error.get_ref().and_then(|error| error.downcast_ref()) {
            Some(FileGone(reason)) => Self::Gone { reason },
            None => Self::Write { source: Arc::new(error) },
        }
    }
}

/// What another program did to a file, so that it is no longer written to.
#[derive(Debug, thiserror::Error)]
#[error("the file {0} by another program")]
pub(super) struct FileGone(pub(super) &'static str);

/// Says what else the file has, if that is the reason.
fn instead(left_out: &[LeftOut], topics: &[String], others: &[String]) -> String {
    let others = others.join(", ");
    match topics {
        [] if others.is_empty() || !left_out.is_empty() => String::new(),
        [] if others.contains("MultiEcho") => {
            format!("; found {others}: play it to ROS's laser_proc, and record what that publishes")
        }
        [] => format!("; found {others}: record the scans with `ros2 bag record --storage mcap`"),
        topics => format!("; choose a topic: {}", topics.join(", ")),
    }
}

/// Says how to make an MCAP file of a bag in another format.
fn conversion(path: &Path) -> String {
    let (from, to) = (path.display(), path.with_extension(""));
    if to.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap")) {
        return format!("decompress it with `zstd -d '{from}' -o '{}'`", to.display());
    }
    format!(
        "convert it with `rosbags-convert --src '{from}' --dst '{}_mcap' --dst-storage mcap`, which \
         `pip install rosbags` installs",
        to.with_extension("").display()
    )
}

fn feature(compression: &str) -> &str {
    if compression == "zstd" { "zstd" } else { "compression" }
}

fn remedy(compression: &str) -> &'static str {
    match compression {
        "zstd" | "lz4" => {
            "build with the feature `compression`, or remove the compression with `mcap decompress in.mcap -o out.mcap`"
        }
        _ => {
            "expected `zstd`, `lz4` or no compression; copy the file with the program that wrote it, without compression"
        }
    }
}
