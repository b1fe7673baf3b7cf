//! Recordings of Hokuyo URG laser range sensors: the scans of a stream and the replies of a sensor,
//! in a file that you can open with robotics tools and replay. [`ros`] has the ROS 2 messages.
//!
//! [`Recorder`] writes [MCAP](https://mcap.dev) as ROS 2 does, so that `ros2 bag play`, Foxglove, Lichtblick,
//! PlotJuggler and others read it. [`Recording`] reads such a file, returns its scans, and replays the
//! sensor. To complete a file that was cut off use [`repair`]; to copy a part of one use [`cut`].
//!
//! ```
//! use urg_recording::{Recorder, Recording, ReplayPace};
//! use tokio_scip::{Rate, Sensor, Window};
//! use urg_emulator::Emulator;
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let path = std::env::temp_dir().join(format!("recording-{}.mcap", std::process::id()));
//! // Records ten scans; instead of the emulator, `open("/dev/ttyACM0")`.
//! let mut recorder = Recorder::create(&path)?;
//! let sensor = Sensor::builder().depth(1024).connect(Emulator::default()).await?;
//! recorder.observe(&sensor);
//! let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
//! recorder.describe(&sensor, &scans).await?;
//! for _ in 0..10 {
//!     let Some(item) = scans.next().await else { break };
//!     recorder.record(&item)?;
//! }
//! recorder.finish().await?;
//!
//! // And again, from the file.
//! let recording = Recording::open(&path)?;
//! let (Some(window), Some(rate)) = (recording.window(), recording.rate()) else { return Ok(()) };
//! let sensor = Sensor::builder().connect(recording.replay(ReplayPace::Recorded)?).await?;
//! let mut replayed = sensor.scans(window, rate).await?;
//! let mut count = 0;
//! while let Some(scan) = replayed.next().await {
//!     scan?;
//!     count += 1;
//! }
//! assert_eq!(count, 10);
//! # std::fs::remove_file(&path)?;
//! # Ok(())
//! # }
//! ```
//!
//! # What is in the file
//!
//! | topic | ROS 2 type | a message is |
//! |---|---|---|
//! | `/scan` | `sensor_msgs/msg/LaserScan` | a scan of the stream |
//! | `/scip/replies` | `std_msgs/msg/UInt8MultiArray` | the unchanged bytes of a reply; the label of its dimension is the request, empty for fences and unsolicited replies |
//! | `/scip/events` | `std_msgs/msg/String` | a JSON object: [`Event`] |
//!
//! All messages are CDR with their definitions, of types that every ROS 2 has. The log time runs steadily
//! from the wall clock at the beginning of the recording. The publish time is the wall clock when a reply's
//! first byte arrived ([`stamp`](tokio_scip::scan::ScanTimes::stamp)). The header of a scan has the time of
//! its [first ray](tokio_scip::Scan::first_ray_stamp). The metadata `tokio_scip` identifies the sensor. A
//! file only grows, so you can read it if it was cut off. After 4 GB or 65,000 chunks, or earlier on request,
//! a recording continues in a further file ([`RecorderBuilder::split_duration`]).
//!
//! # Replaying
//!
//! [`Recording::replay`] returns an [`Emulator`](urg_emulator::Emulator) on USB. It answers `V` as the
//! recorded sensor did, in SCIP 2 `VV` and `PP`. It answers each poll with the next reply recorded for the
//! stream, byte for byte, including refused and malformed replies, and replies to scans that the recording's
//! own consumer missed. Scans have the recorded stamps. If you ask for another window than the recorded one,
//! each step has its latest known value, or [none](tokio_scip::Geometry::unknown_value). Fences use up no
//! reply, unless the stream has one step and the fence asks for the same. Of several sensors in one file, the
//! first is replayed. To get the same scans without a replay, use [`Recording::scans`].
//!
//! In SCIP 2 the driver polls a replay, too, and a stream (`MD`) that another program asks for sends
//! every scan. Subscribe with [`Rate::UNLIMITED`](tokio_scip::Rate::UNLIMITED) to keep the recorded
//! times: the sensor sent its scans as its motor turned, and polls at another rate fall behind.
//!
//! A recording without replies is replayed from its `/scan` messages. Without a reply to `V`
//! before the first scan, `V` is answered with what the metadata have.
//!
//! The poll after the last reply ends the driver. Streams then end as they do after
//! [`Sensor::close`](tokio_scip::Sensor::close): with `None`, and no error before it. If a part of the file
//! could not be read, the driver ends with [`Disconnected`](tokio_scip::ErrorKind::Disconnected), whose
//! source contains the [`RecordingError`].
//!
//! A replay reads the recording on demand, in small pieces, on the runtime's thread.

mod builder;
mod copy;
mod error;
mod event;
mod file;
mod folder;
mod from_ros;
mod held;
mod item;
mod latched;
mod left_out;
mod mcap;
mod messages;
mod parts;
mod pending;
mod polls;
mod progress;
mod queue;
mod range;
mod reader;
mod record;
mod recorder;
mod replay;
mod reply;
pub mod ros;
mod scans;
mod stream;
mod sync;
mod writer;

use std::sync::{Mutex, MutexGuard, PoisonError};

pub use self::builder::RecorderBuilder;
pub use self::copy::{Copied, cut, cut_topic, repair};
pub use self::error::RecordingError;
pub use self::event::{Event, Events};
pub use self::file::RecordingFile;
pub use self::folder::recording_files;
pub use self::left_out::{LeftOut, LeftOutCounter, LeftOutReason};
pub use self::mcap::{ChunkBytes, Compression};
pub use self::progress::Progress;
pub use self::reader::Recording;
pub use self::record::{Entry, Record};
pub use self::recorder::Recorder;
pub use self::reply::RecordedReply;
#[doc(no_inline)]
pub use self::ros::LaserScan;
pub use self::scans::RecordedScans;
#[doc(no_inline)]
pub use urg_emulator::ReplayPace;

const METADATA: &str = "tokio_scip";

/// Locks what one thread changes and another reads, even after a panic.
fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
