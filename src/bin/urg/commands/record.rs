//! `urg record`: scans, and every reply of the sensor, into a file.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::Instant;

use tokio_scip::recording::{Recorder, RecordingError};
use tokio_scip::{Event, Rate, ScanStream, Sensor, State, Window};

use crate::args::{LinkArgs, PaceArgs, WindowArgs};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::time::clock;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::port::missing;
use crate::port::name::{PortArg, PortName};
use crate::port::open::open_with;
use crate::recording::file::{Existing, RecorderFile};
use crate::recording::progress::Progress;
use crate::recording::recorded::Recorded;
use crate::recording::span::RangeArgs;
use crate::recording::split::SplitLimit;
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::follow;
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::Reporter;

/// Record scans, and every reply of the sensor, into a file
///
/// Runs until Ctrl-C, --count or --duration, also while the sensor is unplugged
/// and when it comes back. After a kill or on a full disk, the file has
/// everything that is older than a second. It is MCAP as ROS 2 writes it: `ros2 bag
/// play`, Foxglove, PlotJuggler and others open it. Other commands read it in place
/// of a sensor: use it as PORT. A recording without a single scan is a failure.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "urg record [OPTIONS] <PORT> <FILE>",
    after_help = "\
Examples:
  urg record /dev/ttyACM0 run.mcap
  urg record serial:H0713090 night.mcap --wait --duration 8h
  urg view run.mcap                      replay at the recorded pace
  urg stream run.mcap --rate max         replay as fast as possible
  urg record run.mcap part.mcap --range 1:30..2:00 --rate max    cut a part out"
)]
pub(crate) struct Record {
    #[command(flatten)]
    port: PortArg,
    /// File to write: FILE.mcap
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Overwrite a file that exists, once the sensor is found
    #[arg(long)]
    force: bool,
    /// Go on in a further file, run_0002.mcap and so on, after this time or size:
    /// 1h, 30m, 500MB, 2GB [default: after 65,000 seconds of data]
    ///
    /// Each file is complete and can be replayed alone. No scan is lost or doubled.
    /// Further files overwrite nothing: they take the next number that is free.
    #[arg(long, value_name = "LIMIT")]
    split: Option<SplitLimit>,
    /// Name of the sensor's coordinate frame, for ROS
    #[arg(long, value_name = "NAME", default_value = "laser")]
    frame_id: String,
    #[command(flatten)]
    pace: PaceArgs,
    #[command(flatten)]
    range: RangeArgs,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    link: LinkArgs,
}

impl Record {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let Some(file) = &self.file else { return Err(self.without_file().await) };
        let (mut port, rate) = self.port.polled_at(self.pace.rate).await?;
        port.restrict(self.range.range)?;
        let window = self.window.window(port.default_window())?;
        let mut file = tokio::select! {
            file = self.file(&port, file) => file?,
            _ = interrupt.requested() => return Ok(()),
        };
        let recorder = self.recorder(&file).map_err(|error| file.failure(&error))?;
        let (sensor, scans) = tokio::select! {
            opened = self.open(&port, window, rate, &recorder) => opened?,
            _ = interrupt.requested() => return Ok(()),
        };
        file.begin()?;
        let run = RecordRun {
            recorder,
            watch: RateWatch::new(&port, window, rate),
            feed: Feed::new(&port, scans),
            reporter: Reporter::new(port, sensor),
            progress: Progress::new(),
            began: Instant::now(),
            missed: 0,
        };
        run.run(&self.pace, interrupt, &file).await
    }

    /// Returns the failure where one name was given instead of two: which FILE,
    /// or, where that name is a recording, which PORT.
    async fn without_file(&self) -> Failure {
        match &self.port.name {
            Some(port) if port.recorded().is_none() => Failure::Usage(format!(
                "which FILE.mcap? The recording needs a name: `urg record {port} run.mcap`"
            )),
            _ => missing::failure().await,
        }
    }

    /// Opens the file. Fails if it cannot be recorded into.
    async fn file(&self, port: &PortName, file: &Path) -> Result<RecorderFile, Failure> {
        let name = file.display();
        if !Recorded::is_name(file) {
            return Err(Failure::Usage(format!(
                "cannot record into {name}: expected a name that ends in .mcap, such as {name}.mcap"
            )));
        }
        if port.recorded().is_some_and(|recorded| recorded.is(file)) {
            return Err(Failure::Usage(format!("{name} cannot be recorded into itself")));
        }
        let existing = if self.force { Existing::Overwrite } else { Existing::Refuse };
        RecorderFile::open(file, existing).await
    }

    /// Starts to record into the file. Only a regular file is followed by others.
    fn recorder(&self, file: &RecorderFile) -> Result<Recorder, RecordingError> {
        let builder = Recorder::builder().frame_id(&self.frame_id);
        let builder = match self.split {
            None => builder,
            Some(SplitLimit::Duration(duration)) => builder.split_duration(duration),
            Some(SplitLimit::Bytes(bytes)) => builder.split_bytes(bytes),
        };
        match file.is_regular() {
            true => builder.write_to_parts(file.writer(), file.path()),
            false => builder.write_to(file.writer()),
        }
    }

    async fn open(
        &self,
        port: &PortName,
        window: Window,
        rate: Rate,
        recorder: &Recorder,
    ) -> Result<(Sensor, ScanStream), Failure> {
        let failed = |error| Failure::at(&port.to_string(), &error);
        let builder = Sensor::builder().on_reply(recorder.observer());
        let sensor = open_with(port, &self.link, Delivery::All, builder).await?;
        let scans = sensor.scans(window, rate).await.map_err(failed)?;
        recorder.describe(&sensor, &scans).await.map_err(failed)?;
        Ok((sensor, scans))
    }
}

/// A stream on its way into the file.
struct RecordRun {
    recorder: Recorder,
    feed: Feed,
    reporter: Reporter,
    watch: RateWatch,
    progress: Progress,
    began: Instant,
    /// Scans of which only the replies are in the file.
    missed: u64,
}

impl RecordRun {
    async fn run(
        mut self,
        pace: &PaceArgs,
        interrupt: &Interrupt,
        file: &RecorderFile,
    ) -> Result<(), Failure> {
        let Self { recorder, feed, reporter, watch, progress, began, missed } = &mut self;
        let take = async |update: Update| {
            reporter.report(&update);
            let item = match update {
                Update::Scan(scan) => Ok(scan),
                Update::Error(error) => Err(error),
                Update::Event(event) => {
                    match event {
                        Event::Reconnected => watch.restart(),
                        Event::Missed { scans } => *missed += scans,
                        _ => {}
                    }
                    return Ok(());
                }
            };
            recorder.record(&item).map_err(|error| file.failure(&error))?;
            if let Ok(scan) = &item
                && let Some(text) = watch.scanned(scan, &reporter.sensor)
            {
                notice(text);
            }
            if reporter.port.recorded().is_some() {
                // The replay waits for the recorder.
                tokio::select! {
                    () = recorder.ready() => {}
                    _ = interrupt.requested() => {}
                }
            }
            progress.show(|| {
                let away = match &*reporter.sensor.state().borrow() {
                    State::Connected { .. } => "",
                    _ => "; sensor away",
                };
                let totals = RecordTotals::new(recorder, reporter, *missed);
                format!("{}{away} (Ctrl-C ends it)", totals.after(began.elapsed()))
            });
            Ok(())
        };
        let followed = follow(feed, pace, interrupt, take).await;
        let elapsed = self.began.elapsed();
        let mut totals = RecordTotals::new(&self.recorder, &self.reporter, self.missed);
        let name = file.path().display();
        let finished = tokio::select! {
            finished = self.recorder.finish() => finished.map_err(|error| file.failure(&error)),
            () = interrupt.overdue() => Err(Failure::Failed(format!(
                "{name}: the disk is too slow: the end of the file is missing, and the rest can be read"
            ))),
        };
        let ended = self.reporter.finish(followed?);
        let finished = finished?;
        (totals.bytes, totals.files) = (finished.bytes, finished.files);
        notice(format_args!("{name}: {}", totals.after(elapsed)));
        ended
    }
}

/// The numbers of what was recorded and what was not.
#[derive(Debug, Clone, Copy, Default)]
struct RecordTotals {
    scans: u64,
    bytes: u64,
    files: u64,
    /// Scans that are not in the file, though they arrived.
    lost: u64,
    /// Replies that are not in the file, so that a replay lacks them.
    lost_replies: u64,
    /// Polls without a scan over a working link.
    failed: u64,
    disconnects: u64,
}

impl RecordTotals {
    fn new(recorder: &Recorder, reporter: &Reporter, missed: u64) -> Self {
        let progress = recorder.progress();
        Self {
            scans: progress.scans,
            bytes: progress.bytes,
            files: progress.files,
            lost: progress.lost + missed,
            lost_replies: progress.lost_replies,
            failed: reporter.failed,
            disconnects: reporter.sensor.stats().disconnects,
        }
    }

    /// Returns a line of text.
    fn after(self, elapsed: Duration) -> String {
        let Self { scans, bytes, files, lost, lost_replies, failed, disconnects } = self;
        let noun = if scans == 1 { "scan" } else { "scans" };
        let mut text = format!("{scans} {noun} in {}, ", clock(elapsed.as_secs_f64()));
        text.push_str(&match bytes {
            0..1_000_000 => format!("{} kB", bytes / 1000),
            _ => format!("{:.1} MB", bytes as f64 / 1e6),
        });
        if files > 1 {
            // Writing to a string does not fail.
            let _ = write!(text, " in {files} files");
        }
        text.push_str(&match lost {
            0 => ", none lost".to_owned(),
            lost => format!(", {lost} lost"),
        });
        if lost_replies > 0 {
            let _ = write!(text, ", {lost_replies} replies lost");
        }
        if failed > 0 {
            let _ = write!(text, ", {failed} polls without a scan");
        }
        if disconnects > 0 {
            let _ = write!(text, ", link lost {disconnects}x");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_the_time_the_size_and_what_is_missing() {
        let good = RecordTotals { scans: 598, bytes: 2_345_678, ..RecordTotals::default() };
        assert_eq!(good.after(Duration::from_secs(61)), "598 scans in 1:01, 2.3 MB, none lost");
        assert!(good.after(Duration::from_secs(3601)).starts_with("598 scans in 1:00:01, "));
        let bad = RecordTotals {
            scans: 3,
            bytes: 13_999,
            files: 2,
            lost: 2,
            lost_replies: 5,
            failed: 4,
            disconnects: 1,
        };
        assert_eq!(
            bad.after(Duration::from_millis(999)),
            "3 scans in 0:00, 13 kB in 2 files, 2 lost, 5 replies lost, 4 polls without a scan, link lost 1x"
        );
    }
}
