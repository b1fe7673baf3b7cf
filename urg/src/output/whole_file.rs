//! New file that gets its name only when it is complete and on the disk, so that a crash or a
//! power failure never leaves a partial file under that name.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempPath};

/// Temporary file, to be renamed to `path`. Removed on drop.
pub(crate) struct WholeFile {
    path: PathBuf,
    temporary: TempPath,
}

impl WholeFile {
    /// Creates the temporary file beside `path`, such as `run.mcap.a1B2c3.part`. It is an error
    /// if `path` exists.
    pub(crate) fn create(path: &Path) -> io::Result<(Self, File)> {
        if path.symlink_metadata().is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let mut prefix = path.file_name().unwrap_or_default().to_owned();
        prefix.push(".");
        let mut builder = Builder::new();
        builder.prefix(&prefix).suffix(".part");
        // Same permissions as any new file. The default of `tempfile` is 0o600.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let (file, temporary) = builder.tempfile_in(folder(path))?.into_parts();
        Ok((Self { path: path.to_owned(), temporary }, file))
    }

    /// Renames the file. Sync its content first. It is an error if `path` exists by now.
    pub(crate) fn keep(self) -> io::Result<()> {
        self.temporary.persist_noclobber(&self.path)?;
        if cfg!(unix) {
            // Ignores file systems that cannot sync a folder: a power failure may undo the rename.
            let _ = File::open(folder(&self.path)).and_then(|folder| folder.sync_all());
        }
        Ok(())
    }
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn a_file_has_its_name_only_once_it_is_kept_and_replaces_no_other() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("run.mcap");
        let names = || {
            let entries = std::fs::read_dir(place.path()).unwrap();
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
        };
        let (whole, mut file) = WholeFile::create(&path).unwrap();
        file.write_all(b"one").unwrap();
        let found: Vec<String> = names();
        assert!(found.len() == 1 && found[0].ends_with(".part"), "{found:?}");
        let (late, _) = WholeFile::create(&path).unwrap();
        let (dropped, _) = WholeFile::create(&path).unwrap();
        drop(dropped);
        whole.keep().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        assert_eq!(late.keep().unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        let Err(error) = WholeFile::create(&path) else { panic!("created") };
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(names(), ["run.mcap"]);
    }
}
