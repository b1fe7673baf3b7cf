//! `urg record`: records scans, and the replies of the sensor, into a file. `limits` parses its options, `trigger`
//! waits for the trigger of `--before`, `writing` writes the file, and `totals` formats its progress.

mod limits;
mod totals;
mod trigger;
mod writing;

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::Instant;

use urg_recording::{Recorder, RecorderBuilder, RecordingError, RecordingFile};

use self::limits::{SplitLimit, sync_interval};
use self::trigger::trigger;
use self::writing::{Writing, failure};
use crate::args::{CompressionName, LinkArgs, PaceArgs, WindowArgs, duration, frame_id};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::output::stdout::is_closed;
use crate::port::name::{PortArg, missing_port};
use crate::port::open::{open, proven_baud_rate};
use crate::recording::recorded::Recorded;
use crate::recording::rewrite::perhaps_without_folder;
use crate::stream::feed::{Feed, Update, check_window};
use crate::stream::follow::follow;
use crate::stream::reporter::Reporter;

/// Record scans, and the replies of the sensor, into a file
///
/// Runs until Ctrl-C, --count or --duration. Unplug the sensor and plug it back in: recording resumes. If the
/// program is killed or the disk fills up, you lose at most one second; if the power fails, two. The file is MCAP as
/// ROS 2 writes it: open it with `ros2 bag play`, Foxglove, PlotJuggler and others, or use it as PORT of any other
/// command. A recording without a single scan is an error. Pass
/// - as FILE to write to standard output, once a second.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "urg record [OPTIONS] <PORT> <FILE>",
    after_help = "\
Examples:
  urg record /dev/ttyACM0 run.mcap
  urg record serial:H0713090 night.mcap --wait --duration 8h
  urg view run.mcap                      replay at the recorded pace
  urg stream run.mcap --rate max         replay as fast as possible
  urg record /dev/ttyACM0 log.mcap --wait --split 1h --keep 20GB
  urg record /dev/ttyACM0 crash.mcap --before 60s --duration 10s
  ssh robot urg record /dev/ttyACM0 - > run.mcap
  ssh robot urg record /dev/ttyACM0 - | urg stream -"
)]
pub(crate) struct Record {
    #[command(flatten)]
    port: PortArg,
    /// File to write: FILE.mcap, or - for standard output
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Overwrite an existing file, once the sensor is found
    #[arg(long)]
    force: bool,
    /// Start a new file, run_0002.mcap and so on, after this time or size: 1h, 30m,
    /// 500MB, 2GB [default: after 4 GB or 65,000 seconds of data]
    ///
    /// Each file is complete: you can replay it alone. No scan is lost or written twice.
    /// New files never overwrite others: they take the next free number.
    #[arg(long, value_name = "LIMIT")]
    split: Option<SplitLimit>,
    /// Remove the oldest files of a split recording beyond this size or age: 20GB, 7d;
    /// repeat the option to limit both
    ///
    /// If you start the recording again under the same name, it continues after its
    /// last file. The current file is never removed.
    #[arg(long, value_name = "LIMIT")]
    keep: Vec<SplitLimit>,
    /// Hold this time in memory, and write it once you press Enter or send SIGUSR1
    ///
    /// From then on, record until Ctrl-C, --count or --duration. A line from a program on
    /// standard input is a trigger, too. Holds at most 4 MiB, two minutes at 10 Hz.
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    pub(crate) before: Option<Duration>,
    /// Sync the file to the disk this often; 0 leaves it to the system
    ///
    /// If the power fails, you lose at most this time and one more second.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = sync_interval,
        allow_hyphen_values = true)]
    sync: Duration,
    /// Compress the file
    ///
    /// zstd (not in every build) takes the fewest bytes, lz4 the least CPU time. You lose no more if the
    /// program is killed or the power fails.
    #[arg(long, value_name = "NAME", value_enum, default_value_t = CompressionName::None)]
    compress: CompressionName,
    /// Name of the sensor's coordinate frame, for ROS
    #[arg(long, value_name = "NAME", default_value = "laser", value_parser = frame_id)]
    frame_id: String,
    #[command(flatten)]
    pace: PaceArgs,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    link: LinkArgs,
}

impl Record {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        // First: without a handler SIGUSR1 ends the program.
        let trigger = self.before.map(|before| (before, trigger()));
        let Some(file) = &self.file else { return Err(self.without_file().await) };
        let (port, rate) = interrupt.unless(self.port.polled_at(self.pace.rate)).await?;
        if let Some(recorded) = port.recorded() {
            // `urg cut` does not overwrite its input.
            let copy = if file == recorded.path() { Path::new("copy.mcap") } else { file };
            return Err(Failure::Usage(format!(
                "{recorded} is a recording: `urg cut {} {}` copies it, or a part of it, \
                 with its times",
                recorded.path().display(),
                copy.display()
            )));
        }
        let window = self.window.window(port.default_window())?;
        let is_stdout = file.as_os_str() == "-";
        let target = if is_stdout { "standard output".into() } else { file.to_string_lossy() };
        let file = match is_stdout {
            true => self.require_pipe().map(|()| None)?,
            false => Some(interrupt.unless(self.file(file)).await?),
        };
        let opening = async {
            let sensor = open(&port, &self.link, Delivery::All).await?;
            check_window(&port, &sensor, window).await?;
            let begun = match file {
                Some(file) => self.builder().record_into(file),
                None => self.builder().write_to(io::stdout()),
            };
            let mut recorder = begun.map_err(|error| failure(&target, &error))?;
            // The metadata have the baud rate, so before any scan.
            proven_baud_rate(&sensor).await;
            recorder.observe(&sensor);
            let feed = Feed::open(&port, &sensor, window, rate).await?;
            let described = recorder.describe(&sensor, feed.scans()).await;
            described.map_err(|error| Failure::at(&port, &error))?;
            Ok((sensor, feed, recorder))
        };
        let (sensor, mut feed, mut recorder) = interrupt.unless(opening).await?;
        let mut reporter = Reporter::new(port, sensor).with_rate(window, rate);
        let held = match trigger {
            Some((before, trigger)) => {
                let holding = hold(&mut recorder, &mut feed, &mut reporter, &target, trigger);
                before.min(tokio::select! {
                    held = holding => held?,
                    _ = interrupt.requested() => Duration::ZERO,
                })
            }
            None => Duration::ZERO,
        };
        let writing = Writing::new(recorder, reporter, &target, feed.scans().rate(), held);
        self.write(writing, feed, interrupt).await
    }

    /// Writes the stream into the file until one of them ends.
    async fn write(
        &self,
        mut writing: Writing<'_>,
        mut feed: Feed,
        interrupt: &Interrupt,
    ) -> Result<(), Failure> {
        let take = async |update| writing.take(update);
        let followed = follow(&mut feed, &self.pace, interrupt, take).await;
        writing.finish(followed, interrupt).await
    }

    /// Asks for the missing argument: FILE, or PORT if the only argument is a recording.
    async fn without_file(&self) -> Failure {
        match &self.port.name {
            Some(port) if port.recorded().is_none() => Failure::Usage(format!(
                "which FILE.mcap? The recording needs a name: `urg record {port} run.mcap`"
            )),
            _ => missing_port().await,
        }
    }

    /// Checks that standard output can hold a recording.
    fn require_pipe(&self) -> Result<(), Failure> {
        if self.split.is_some() || !self.keep.is_empty() {
            let text = "--split and --keep are for files: standard output is one recording";
            return Err(Failure::Usage(text.to_owned()));
        }
        if is_closed() {
            let text = "standard output is closed: send it to a file or a program";
            return Err(Failure::Usage(text.to_owned()));
        }
        if io::stdout().is_terminal() {
            let text = "a recording is no text for a terminal: send standard output to a file or a \
                        program, as in `urg record PORT - > run.mcap`";
            return Err(Failure::Usage(text.to_owned()));
        }
        Ok(())
    }

    /// Opens the file, after checking that it can hold a recording. Opening a pipe waits for its
    /// reader; you can drop the future meanwhile.
    async fn file(&self, file: &Path) -> Result<RecordingFile, Failure> {
        let name = file.display();
        if !Recorded::is_name(file) {
            return Err(Failure::Usage(format!(
                "cannot record into {name}: expected a name that ends in .mcap, such as {name}.mcap"
            )));
        }
        if !self.keep.is_empty() && self.split.is_none() {
            let text = "--keep removes old files of a split recording: say with --split how \
                        long each is, such as --split 1h";
            return Err(Failure::Usage(text.to_owned()));
        }
        let (builder, path) = (self.builder(), file.to_owned());
        let opening = move || builder.open(&path).map_err(|error| not_opened(&path, &error));
        let opened = tokio::task::spawn_blocking(opening).await;
        opened.map_err(|error| Failure::new(format_args!("cannot write {name}"), &error))?
    }

    fn builder(&self) -> RecorderBuilder {
        let mut builder = Recorder::builder();
        if let Some(before) = self.before {
            builder = builder.before(before);
        }
        builder = builder
            .frame_id(&self.frame_id)
            .compression(self.compress.into())
            .overwrite(self.force)
            .sync_interval(Some(self.sync).filter(|interval| !interval.is_zero()));
        if let Some(limit) = self.split {
            builder = match limit {
                SplitLimit::Duration(duration) => builder.split_duration(duration),
                SplitLimit::Bytes(bytes) => builder.split_bytes(bytes),
            };
        }
        for limit in &self.keep {
            builder = match *limit {
                SplitLimit::Duration(duration) => builder.keep_duration(duration),
                SplitLimit::Bytes(bytes) => builder.keep_bytes(bytes),
            };
        }
        builder
    }
}

/// Describes a file that cannot be recorded into. Blocks.
fn not_opened(file: &Path, error: &RecordingError) -> Failure {
    let name = file.display();
    match error {
        RecordingError::Exists { path } if path != file => Failure::Failed(format!(
            "{} is a part of another recording, between whose files those of {name} would stand: \
             move it away, or use another name",
            path.display()
        )),
        RecordingError::Exists { .. } => {
            Failure::Failed(format!("{name} exists: use another name, or --force to overwrite it"))
        }
        error => perhaps_without_folder(file, error),
    }
}

/// Holds scans and replies in memory until the trigger. Returns how long that took.
async fn hold(
    recorder: &mut Recorder,
    feed: &mut Feed,
    reporter: &mut Reporter,
    target: &str,
    trigger: impl Future<Output = ()>,
) -> Result<Duration, Failure> {
    let began = Instant::now();
    tokio::pin!(trigger);
    notice(format_args!("{target}: waiting for Enter or SIGUSR1"));
    loop {
        let update = tokio::select! {
            () = &mut trigger => break,
            update = feed.next() => update,
        };
        // At the end of the stream `follow` finds it again.
        let Some(update) = update else { break };
        reporter.report(&update);
        let item = match update {
            Update::Scan(scan) => Ok(scan),
            Update::Error(error) => Err(error),
            Update::Event(_) => continue,
        };
        recorder.record(&item).map_err(|error| failure(target, &error))?;
    }
    recorder.trigger();
    Ok(began.elapsed())
}
