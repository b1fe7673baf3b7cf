//! Writes a new recording from others, for `urg cut` and `urg repair`. A file gets its name once
//! it is complete.

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_scip::recording::RecordingError;

use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::whole_file::WholeFile;

/// Recording to read.
pub(crate) type Input = Box<dyn Read + Send>;

/// Calls `copy` with `files` and the output `out`, and waits until the output is on the disk.
/// Returns the outcome of `copy`, and the file to keep; `None` for standard output.
pub(crate) async fn rewrite<T: Send + 'static>(
    files: Vec<PathBuf>,
    out: &Path,
    interrupt: &Interrupt,
    copy: impl FnOnce(Vec<Input>, &mut dyn Write) -> Result<T, RecordingError> + Send + 'static,
) -> Result<(T, Option<WholeFile>), Failure> {
    let created = match is_dash(out) {
        true => None,
        false => Some(WholeFile::create(out).map_err(|error| failure(out, &error))?),
    };
    let (whole, output) = created.unzip();
    let to = out.to_owned();
    let writing = tokio::task::spawn_blocking(move || {
        let inputs = files.iter().map(|file| open(file)).collect::<Result<_, _>>()?;
        let written = match &output {
            Some(file) => buffered(file, |output| copy(inputs, output))
                .and_then(|outcome| file.sync_all().map(|()| outcome).map_err(write_error)),
            None => buffered(io::stdout().lock(), |output| copy(inputs, output)),
        };
        written.map_err(|error| match (&error, files.as_slice()) {
            (RecordingError::Write { .. }, _) => failure(&to, &error),
            (_, [file]) => failure(file, &error),
            _ => Failure::of("one of the files", &error),
        })
    });
    let written = tokio::select! {
        written = writing => written.map_err(|error| failure(out, &error))??,
        _ = interrupt.requested() => {
            let outcome = if whole.is_some() { "not written" } else { "incomplete" };
            let name = out.display();
            return Err(Failure::Failed(format!("{name}: interrupted, and {outcome}")));
        }
    };
    Ok((written, whole))
}

/// Checks whether a path means standard input or output.
pub(crate) fn is_dash(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// Describes an error of a file.
pub(crate) fn failure(path: &Path, error: &dyn std::error::Error) -> Failure {
    Failure::at(&path.display().to_string(), error)
}

fn open(path: &Path) -> Result<Input, Failure> {
    Ok(match is_dash(path) {
        true => Box::new(io::stdin()),
        false => Box::new(File::open(path).map_err(|error| failure(path, &error))?),
    })
}

fn buffered<T>(
    output: impl Write,
    copy: impl FnOnce(&mut dyn Write) -> Result<T, RecordingError>,
) -> Result<T, RecordingError> {
    let mut output = BufWriter::new(output);
    let outcome = copy(&mut output)?;
    output.flush().map(|()| outcome).map_err(write_error)
}

fn write_error(error: io::Error) -> RecordingError {
    RecordingError::Write { source: Arc::new(error) }
}
