//! `urg cut`: copies a part of a recording, or joins the files of a split recording. Times
//! stay as recorded.

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_scip::recording::{CutOutcome, RecordingError, cut};

use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::output::whole_file::WholeFile;
use crate::recording::span::RangeArgs;

/// Copy a part of a recording, or join the files of a split recording
///
/// Messages keep their bytes, times and numbers. You lose only damaged parts, about
/// one second each. The input files are not changed.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "urg cut [OPTIONS] <FILE>... <OUT>",
    after_help = "\
Examples:
  urg cut run.mcap part.mcap --range 1:30..2:00
  urg cut run.mcap run_0002.mcap run_0003.mcap whole.mcap
  urg cut run.mcap - --range 90s.. | ssh host 'cat > part.mcap'"
)]
pub(crate) struct Cut {
    /// Recordings to read, in order, then the file to create, which must not exist yet; `-`
    /// means standard input or output
    #[arg(value_name = "FILE", required = true, num_args = 2..)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    range: RangeArgs,
}

impl Cut {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let Self { mut files, range } = self;
        let Some(out) = files.pop() else { return Ok(()) };
        let name = out.display().to_string();
        let created = match is_dash(&out) {
            true => None,
            false => Some(WholeFile::create(&out).map_err(|error| failure(&out, &error))?),
        };
        let (whole, output) = created.unzip();
        let written = {
            let out = out.clone();
            tokio::task::spawn_blocking(move || write(&files, range, &out, output))
        };
        let outcome = tokio::select! {
            written = written => written.map_err(|error| Failure::at(&name, &error))??,
            _ = interrupt.requested() => {
                let outcome = if whole.is_some() { "not written" } else { "incomplete" };
                return Err(Failure::Failed(format!("{name}: interrupted, and {outcome}")));
            }
        };
        if let Some(whole) = whole {
            if outcome.messages == 0 {
                return Err(Failure::Failed(format!("{name}: nothing in this part")));
            }
            whole.keep().map_err(|error| failure(&out, &error))?;
        }
        let CutOutcome { scans, damaged_parts, was_truncated, .. } = outcome;
        let noun = if scans == 1 { "scan" } else { "scans" };
        let mut text = format!("{name}: {scans} {noun}");
        if damaged_parts > 0 {
            text.push_str(&format!(", {damaged_parts} damaged parts left out"));
        }
        if was_truncated {
            text.push_str(", the end of a file that was read is missing or damaged");
        }
        notice(text);
        Ok(())
    }
}

/// Copies `files` to `output`, or to standard output. Blocks until the copy is on the disk.
fn write(
    files: &[PathBuf],
    range: RangeArgs,
    out: &Path,
    output: Option<File>,
) -> Result<CutOutcome, Failure> {
    let mut inputs: Vec<Box<dyn Read + Send>> = Vec::new();
    for path in files {
        inputs.push(if is_dash(path) {
            Box::new(io::stdin())
        } else {
            Box::new(File::open(path).map_err(|error| failure(path, &error))?)
        });
    }
    let bounds = range.bounds();
    let copied = match &output {
        Some(file) => copy_into(inputs, bounds, file)
            .and_then(|outcome| file.sync_all().map(|()| outcome).map_err(write_error)),
        None => copy_into(inputs, bounds, io::stdout().lock()),
    };
    copied.map_err(|error| copy_failure(files, out, &error))
}

fn copy_into(
    inputs: Vec<Box<dyn Read + Send>>,
    bounds: crate::recording::span::Bounds,
    output: impl Write,
) -> Result<CutOutcome, RecordingError> {
    let mut buffered = BufWriter::new(output);
    let outcome = cut(inputs, bounds, &mut buffered)?;
    buffered.flush().map(|()| outcome).map_err(write_error)
}

fn write_error(error: io::Error) -> RecordingError {
    RecordingError::Write { source: Arc::new(error) }
}

fn copy_failure(files: &[PathBuf], out: &Path, error: &RecordingError) -> Failure {
    match (error, files) {
        (RecordingError::Write { .. }, _) => failure(out, error),
        (_, [file]) => failure(file, error),
        _ => Failure::of("one of the files", error),
    }
}

fn is_dash(path: &Path) -> bool {
    path.as_os_str() == "-"
}

fn failure(path: &Path, error: &dyn std::error::Error) -> Failure {
    Failure::at(&path.display().to_string(), error)
}
