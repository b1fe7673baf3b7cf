//! Writes a new recording from others, for `urg cut` and `urg repair`. A file gets its name only
//! when it is complete and on the disk: a crash or power failure leaves no partial file.

use std::collections::HashSet;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tempfile::{NamedTempFile, TempPath};
use tokio::task::spawn_blocking;
use urg_recording::{RecordingError, cut, recording_files};

use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Calls `copy` with `files` and the output `out`, and returns its outcome once the output is on
/// the disk. Keeps a new file only if `is_kept` returns true for the outcome.
///
/// A disk may hang at any call, so all of them run on blocking threads. After an interrupt, the
/// program waits for the last ones for a second.
pub(crate) async fn rewrite<T: Send + 'static>(
    files: Vec<PathBuf>,
    out: &Path,
    interrupt: &Interrupt,
    copy: impl FnOnce(Vec<File>, &mut dyn Write) -> Result<T, RecordingError> + Send + 'static,
    is_kept: impl FnOnce(&T) -> bool,
) -> Result<T, Failure> {
    let interrupted =
        |outcome| Failure::Failed(format!("{}: interrupted, and {outcome}", out.display()));
    let to = out.to_owned();
    let creating = spawn_blocking(move || match is_dash(&to) {
        true => Ok(None),
        false => create(&to).map(Some).map_err(|error| not_created(&to, &error)),
    });
    let created = tokio::select! {
        created = creating => created.map_err(|error| failure(out, &error))??,
        () = interrupt.overdue() => return Err(interrupted("not written")),
    };
    let (output, temporary) = created.map(NamedTempFile::into_parts).unzip();
    let to = out.to_owned();
    let writing = spawn_blocking(move || write(&files, output, &to, copy));
    let outcome = tokio::select! {
        written = writing => written.unwrap_or_else(|error| Err(failure(out, &error))),
        _ = interrupt.requested() => {
            Err(interrupted(if temporary.is_some() { "not written" } else { "incomplete" }))
        }
    };
    let (to, is_kept) = (out.to_owned(), outcome.as_ref().is_ok_and(is_kept));
    let ending = spawn_blocking(move || match temporary.filter(|_| is_kept) {
        Some(temporary) => keep(temporary, &to).map_err(|error| not_created(&to, &error)),
        // Removed, if it was not kept.
        None => Ok(()),
    });
    tokio::select! {
        ended = ending => ended.map_err(|error| failure(out, &error))??,
        () = interrupt.overdue() => if is_kept {
            return Err(interrupted("perhaps not written"));
        },
    }
    outcome
}

/// Copies `files` to `output`, or to standard output, and syncs it. It is `to` in messages.
fn write<T>(
    files: &[PathBuf],
    output: Option<File>,
    to: &Path,
    copy: impl FnOnce(Vec<File>, &mut dyn Write) -> Result<T, RecordingError>,
) -> Result<T, Failure> {
    // A folder has several.
    let listed = |file: &PathBuf| recording_files(file).map_err(|error| failure(file, &error));
    let files = files.iter().map(listed).collect::<Result<Vec<_>, _>>()?.concat();
    let mut known = HashSet::new();
    let is_known = |file: &&PathBuf| !known.insert(file.canonicalize().unwrap_or((*file).clone()));
    if let Some(twice) = files.iter().find(is_known) {
        return Err(failure(twice, &io::Error::other("named twice: its scans would be doubled")));
    }
    let inputs = files.iter().map(|file| open(file)).collect::<Result<_, _>>()?;
    let written = match &output {
        Some(file) => buffered(file, |output| copy(inputs, output))
            .and_then(|outcome| file.sync_all().map(|()| outcome).map_err(write_error)),
        None => buffered(io::stdout().lock(), |output| copy(inputs, output)),
    };
    written.map_err(|error| match (&error, files.as_slice()) {
        // The unfinished file is removed.
        (RecordingError::Write { source }, _) if output.is_some() => {
            Failure::new(format_args!("{}: not written", to.display()), source)
        }
        (RecordingError::Write { source }, _) => Failure::new("incomplete copy", source),
        (RecordingError::NoScans { .. }, [file, ..]) | (_, [file]) => failure(file, &error),
        (_, files) => match files.iter().find(|file| !is_readable(file)) {
            Some(file) => failure(file, &error),
            None => Failure::new("one of the files", &error),
        },
    })
}

/// Creates a temporary file beside `path`, such as `run.mcap.a1B2c3.part`, which is removed on drop. It
/// is an error if `path` exists, or can only be a folder.
fn create(path: &Path) -> io::Result<NamedTempFile> {
    if path.symlink_metadata().is_ok() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    if path.to_string_lossy().ends_with(std::path::is_separator) {
        return Err(io::Error::other("expected a file, found the name of a folder"));
    }
    // The error of a temporary file would name that file.
    folder(path).metadata()?;
    let mut prefix = path.file_name().unwrap_or_default().to_owned();
    prefix.push(".");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".part");
    // Same permissions as any new file. The default of `tempfile` is 0o600.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder(path))
}

/// Renames a temporary file to `path`. Sync its content first. It is an error if `path` exists by now.
fn keep(temporary: TempPath, path: &Path) -> io::Result<()> {
    temporary.persist_noclobber(path)?;
    if cfg!(unix) {
        // Ignores file systems that cannot sync a folder: a power failure may undo the rename.
        let _ = File::open(folder(path)).and_then(|folder| folder.sync_all());
    }
    Ok(())
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Checks whether a path means standard input or output.
pub(crate) fn is_dash(path: &Path) -> bool {
    path.as_os_str() == "-"
}

pub(crate) fn failure(path: &Path, error: &dyn std::error::Error) -> Failure {
    Failure::at(path.display(), error)
}

fn not_created(path: &Path, error: &io::Error) -> Failure {
    if error.kind() == io::ErrorKind::AlreadyExists {
        return Failure::Failed(format!("{} exists: use another name", path.display()));
    }
    perhaps_without_folder(path, error)
}

/// Describes a file that cannot be created, and says if its folder is missing. Blocks.
pub(crate) fn perhaps_without_folder(path: &Path, error: &dyn std::error::Error) -> Failure {
    let (failure, folder) = (failure(path, error), folder(path));
    if folder.exists() {
        return failure;
    }
    failure.advise(format_args!("there is no folder {}: create it first", folder.display()))
}

fn open(path: &Path) -> Result<File, Failure> {
    let file = if is_dash(path) { stdin() } else { File::open(path) };
    file.map_err(|error| failure(path, &error))
}

/// Reads a file again, to find which one of several cannot be read.
fn is_readable(path: &Path) -> bool {
    is_dash(path) || open(path).is_ok_and(|file| cut([file], .., None, io::sink()).is_ok())
}

/// Standard input as a file, whose index can be read if it is one.
fn stdin() -> io::Result<File> {
    #[cfg(unix)]
    let handle = std::os::fd::AsFd::as_fd(&io::stdin()).try_clone_to_owned()?;
    #[cfg(windows)]
    let handle = std::os::windows::io::AsHandle::as_handle(&io::stdin()).try_clone_to_owned()?;
    Ok(handle.into())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_named_once_it_is_kept() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("run.mcap");
        let names = || {
            let entries = std::fs::read_dir(place.path()).unwrap();
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
        };
        let (mut file, temporary) = create(&path).unwrap().into_parts();
        file.write_all(b"one").unwrap();
        let found: Vec<String> = names();
        assert!(found.len() == 1 && found[0].ends_with(".part"), "{found:?}");
        let late = create(&path).unwrap().into_temp_path();
        drop(create(&path).unwrap());
        keep(temporary, &path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        assert_eq!(keep(late, &path).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(create(&path).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(names(), ["run.mcap"]);
    }
}
