//! [`Writing`]: a recording that is being written, from its first scan to its end.

use std::io;
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{Rate, State};
use urg_recording::{Progress, Recorder, RecordingError};

use super::totals::RecordTotals;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::output::stderr;
use crate::port::open::line_baud_rate;
use crate::recording::contents::ScanTimes;
use crate::stream::feed::Update;
use crate::stream::follow::StreamEnd;
use crate::stream::reporter::Reporter;

/// Minimum time between updates of the progress line, so that you can read it.
const REFRESH_INTERVAL: Duration = Duration::from_millis(200);

/// What can go wrong without ending the recording, and the notice of it.
type Trouble = (fn(&Progress) -> bool, &'static str);
const TROUBLES: [Trouble; 4] = [
    (
        |progress| progress.cannot_sync,
        "this file system cannot sync files: if the power fails, more is lost",
    ),
    (
        |progress| progress.late_syncs > 0,
        "the disk is slow: it takes longer than --sync for what is written; no scan is delayed, but \
         more is lost if the power fails",
    ),
    (
        |progress| progress.has_outgrown_file,
        "the file may not grow (its file system or `ulimit -f` limits it): the recording continues in \
         a further file",
    ),
    (
        |progress| progress.cannot_remove,
        "an old file cannot be removed: all files take more than --keep",
    ),
];

pub(super) struct Writing<'a> {
    recorder: Recorder,
    reporter: Reporter,
    target: &'a str,
    /// Time before the trigger, with which the file begins.
    held: Duration,
    began: Instant,
    times: ScanTimes,
    /// When the progress line may change again.
    refresh_at: Instant,
    /// Which of [`TROUBLES`] the user knows.
    are_told: [bool; TROUBLES.len()],
}

impl<'a> Writing<'a> {
    pub(super) fn new(
        recorder: Recorder,
        reporter: Reporter,
        target: &'a str,
        rate: Rate,
        held: Duration,
    ) -> Self {
        let times = ScanTimes::new(Some(rate), line_baud_rate(&reporter.sensor));
        let began = Instant::now() - held;
        let are_told = [false; TROUBLES.len()];
        Self { recorder, reporter, target, held, began, times, refresh_at: began, are_told }
    }

    /// Writes a scan or an error into the file.
    pub(super) fn take(&mut self, update: Update) -> Result<(), Failure> {
        self.reporter.report(&update);
        let item = match update {
            Update::Scan(scan) => {
                let at = scan.received_at().saturating_duration_since(self.began);
                self.times.add(at, scan.times().stamp);
                Ok(scan)
            }
            Update::Error(error) => Err(error),
            Update::Event(_) => return Ok(()),
        };
        self.recorder.record(&item).map_err(|error| failure(self.target, &error))?;
        tell_troubles(&self.recorder.progress(), &mut self.are_told);
        self.show_progress();
        Ok(())
    }

    fn show_progress(&mut self) {
        if Instant::now() < self.refresh_at {
            return;
        }
        self.refresh_at = Instant::now() + REFRESH_INTERVAL;
        stderr::show(|| {
            let away = match self.reporter.sensor.watch_state().get() {
                State::Connected { .. } => "",
                _ => "; sensor away",
            };
            let totals = RecordTotals::new(self.recorder.progress(), &self.reporter, &self.times);
            format!("{}{away} (Ctrl-C ends it)", totals.after(self.began.elapsed()))
        });
    }

    /// Writes the end of the file, and reports how the stream ended.
    pub(super) async fn finish(
        self,
        followed: Result<StreamEnd, Failure>,
        interrupt: &Interrupt,
    ) -> Result<(), Failure> {
        let Self { recorder, reporter, target, held, began, times, mut are_told, .. } = self;
        // Without a scan, the time that it waited for one.
        let recorded = times.length();
        let length = if recorded.is_zero() { began.elapsed() } else { held + recorded };
        let finished = finish(recorder, target, interrupt).await;
        let ended = reporter.finish(followed?);
        let progress = finished?;
        tell_troubles(&progress, &mut are_told);
        let totals = RecordTotals::new(progress, &reporter, &times);
        notice(format_args!("{target}: {}", totals.after(length)));
        ended
    }
}

/// Reports each trouble once.
fn tell_troubles(progress: &Progress, are_told: &mut [bool; TROUBLES.len()]) {
    for ((is_so, text), is_told) in TROUBLES.into_iter().zip(are_told) {
        if is_so(progress) && !std::mem::replace(is_told, true) {
            notice(text);
        }
    }
}

/// Writes the end of the file. After a signal, waits for a slow disk for a while.
async fn finish(
    mut recorder: Recorder,
    target: &str,
    interrupt: &Interrupt,
) -> Result<Progress, Failure> {
    let completed = tokio::select! {
        completed = recorder.complete() => completed.map_err(|error| failure(target, &error))?,
        () = interrupt.overdue() => return Err(Failure::Failed(format!(
            "{target}: the disk or the reader is too slow: the end of the recording is missing, and the rest can be read"
        ))),
    };
    tokio::select! {
        finished = recorder.finish() => finished.map_err(|error| failure(target, &error)),
        () = interrupt.overdue() => {
            notice(format_args!(
                "{target}: the file is complete, but the disk is too slow: if the power fails now, \
                 its end may be lost"
            ));
            Ok(completed)
        }
    }
}

pub(super) fn failure(target: &str, error: &RecordingError) -> Failure {
    match error {
        RecordingError::Write { source } if source.kind() == io::ErrorKind::BrokenPipe => {
            let text = format!("{target}: its reader has closed it, and the recording has ended");
            Failure::Failed(text)
        }
        error => Failure::at(target, error),
    }
}
