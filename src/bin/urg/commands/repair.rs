//! `urg repair`: a complete recording out of one that is cut off or damaged.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use tokio_scip::recording::{RecordingError, Repaired, repair};

use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;

/// Make a complete file of a recording that is cut off or damaged
///
/// A kill or a full disk leaves a recording without its end, which rosbags, `ros2
/// bag` and others do not open. This copies every message with its bytes and times
/// to a new file, and adds the index and the end. Damaged parts, about a second
/// each, are left out. FILE stays as it is.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  urg repair cut.mcap                    writes cut.repaired.mcap
  urg repair cut.mcap whole.mcap")]
pub(crate) struct Repair {
    /// Recording to read: FILE.mcap
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// File to write, which must not exist [default: FILE.repaired.mcap]
    #[arg(value_name = "OUT")]
    out: Option<PathBuf>,
}

impl Repair {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let Self { file, out } = self;
        let out = out.unwrap_or_else(|| file.with_extension("repaired.mcap"));
        let written = {
            let (file, out) = (file.clone(), out.clone());
            tokio::task::spawn_blocking(move || copy(&file, &out))
        };
        let outcome = tokio::select! {
            written = written => {
                written.map_err(|error| failure(&file, &error)).and_then(|outcome| outcome)
            }
            _ = interrupt.requested() => Err(Failure::Failed(format!(
                "{}: interrupted: {} is incomplete", file.display(), out.display()
            ))),
        }?;
        let (file, out) = (file.display(), out.display());
        match outcome {
            Repaired { was_truncated: false, damaged_parts: 0, .. } => {
                notice(format_args!("{file} is complete: nothing to repair, {out} not written"));
            }
            Repaired { was_truncated, damaged_parts, damaged_at, .. } => {
                let mut found = Vec::new();
                if was_truncated {
                    found.push("its end was missing".to_owned());
                }
                if let Some(first) = damaged_at.first() {
                    found.push(format!(
                        "{damaged_parts} damaged parts left out, the first at byte {first}"
                    ));
                }
                notice(format_args!("{out}: complete ({file}: {})", found.join("; ")));
            }
        }
        Ok(())
    }
}

/// Blocks until the copy is written. One that is not needed is removed.
fn copy(file: &Path, out: &Path) -> Result<Repaired, Failure> {
    let input = File::open(file).map_err(|error| failure(file, &error))?;
    let output = OpenOptions::new().write(true).create_new(true).open(out);
    let mut output = BufWriter::new(output.map_err(|error| failure(out, &error))?);
    let repaired = repair(input, &mut output).map_err(|error| match &error {
        RecordingError::Write { .. } => failure(out, &error),
        _ => failure(file, &error),
    });
    let repaired = repaired.and_then(|repaired| {
        output.flush().map(|()| repaired).map_err(|error| failure(out, &error))
    });
    if !matches!(&repaired, Ok(repaired) if repaired.was_truncated || repaired.damaged_parts > 0) {
        // It is a copy, or a part of one.
        let _ = std::fs::remove_file(out);
    }
    repaired
}

fn failure(path: &Path, error: &dyn std::error::Error) -> Failure {
    Failure::at(&path.display().to_string(), error)
}
