//! `urg repair`: restores a truncated or damaged recording.

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_scip::recording::{RecordingError, Repaired, repair};

use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::output::whole_file::WholeFile;

/// Restore a recording that is truncated or damaged
///
/// If `urg record` is killed or the disk fills up, the recording has no end. `ros2
/// bag`, rosbags and others do not open such a file. This command copies every message
/// unchanged to a new file, and adds the index and the end. You lose only damaged
/// parts, about one second each. FILE is not changed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  urg repair cut.mcap                    writes cut.repaired.mcap
  urg repair cut.mcap whole.mcap
  ssh robot cat cut.mcap | urg repair - whole.mcap")]
pub(crate) struct Repair {
    /// Recording to read: FILE.mcap, or - for standard input, which needs OUT
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// File to create; must not exist yet [default: FILE.repaired.mcap]
    #[arg(value_name = "OUT")]
    out: Option<PathBuf>,
}

impl Repair {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let Self { file, out } = self;
        if is_stdin(&file) && out.is_none() {
            let text = "standard input has no name: `urg repair - whole.mcap` gives OUT one";
            return Err(Failure::Usage(text.to_owned()));
        }
        let out = out.unwrap_or_else(|| file.with_extension("repaired.mcap"));
        let (whole, output) = WholeFile::create(&out).map_err(|error| failure(&out, &error))?;
        let written = {
            let (file, out) = (file.clone(), out.clone());
            tokio::task::spawn_blocking(move || copy(&file, &out, &output))
        };
        let repaired = tokio::select! {
            written = written => {
                written.map_err(|error| failure(&file, &error)).and_then(|outcome| outcome)
            }
            _ = interrupt.requested() => Err(Failure::Failed(format!(
                "{}: interrupted: {} not written", file.display(), out.display()
            ))),
        }?;
        if repaired.messages > 0 && (repaired.was_truncated || repaired.damaged_parts > 0) {
            whole.keep().map_err(|error| failure(&out, &error))?;
        }
        let (file, out) = (file.display(), out.display());
        match repaired {
            Repaired { was_truncated: false, damaged_parts: 0, .. } => {
                notice(format_args!("{file} is complete: nothing to repair, {out} not written"));
            }
            Repaired { messages: 0, .. } => {
                return Err(Failure::Failed(format!(
                    "{file}: no message in it can be read: nothing to repair, {out} not written"
                )));
            }
            Repaired { was_truncated, damaged_parts, damaged_at, .. } => {
                let mut found = Vec::new();
                if was_truncated {
                    found.push("its end was missing or damaged".to_owned());
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

/// Copies and repairs `file`. Blocks until the copy is on the disk.
fn copy(file: &Path, out: &Path, output: &File) -> Result<Repaired, Failure> {
    let input: Box<dyn Read + Send> = match is_stdin(file) {
        true => Box::new(io::stdin()),
        false => Box::new(File::open(file).map_err(|error| failure(file, &error))?),
    };
    copy_into(input, output).map_err(|error| match &error {
        RecordingError::Write { .. } => failure(out, &error),
        _ => failure(file, &error),
    })
}

fn copy_into(input: Box<dyn Read + Send>, output: &File) -> Result<Repaired, RecordingError> {
    let mut buffered = BufWriter::new(output);
    let repaired = repair(input, &mut buffered)?;
    let written = buffered.flush().and_then(|()| output.sync_all());
    let write_error = |error| RecordingError::Write { source: Arc::new(error) };
    written.map(|()| repaired).map_err(write_error)
}

fn is_stdin(path: &Path) -> bool {
    path.as_os_str() == "-"
}

fn failure(path: &Path, error: &dyn std::error::Error) -> Failure {
    Failure::at(&path.display().to_string(), error)
}
