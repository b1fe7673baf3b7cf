//! Saves the picture of a scan to a file.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use tokio_scip::{Scan, Version};

use crate::format::svg::svg;
use crate::format::time;

/// Saves the picture in the current directory. Returns the file's name, or a message for
/// the user. The name contains the scan's time and nothing that the sensor sent. Blocks.
pub(crate) fn save(scan: &Scan, version: &Version) -> Result<String, String> {
    save_in(Path::new("."), scan, version)
}

fn save_in(directory: &Path, scan: &Scan, version: &Version) -> Result<String, String> {
    let name = format!("urg-{}.svg", time::file_name(scan.stamp()));
    let written = File::create_new(directory.join(&name))
        .and_then(|mut file| file.write_all(svg(scan, version).as_bytes()));
    match written {
        Ok(()) => Ok(name),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            Err(format!("{name} exists: the scan is saved already"))
        }
        Err(error) => Err(format!("cannot save {name}: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use tokio_scip::Window;

    use super::*;

    #[test]
    fn a_scan_is_saved_once() {
        let steps = Window::DETECTION.steps();
        let scan = Scan::builder(Window::DETECTION, vec![1000; steps]).build().unwrap();
        let directory = tempfile::tempdir().unwrap();
        let save = || save_in(directory.path(), &scan, &Version::default());
        let name = save().unwrap();
        let text = std::fs::read_to_string(directory.path().join(&name)).unwrap();
        assert!(text.ends_with("</svg>\n"), "{name}");
        assert_eq!(save().unwrap_err(), format!("{name} exists: the scan is saved already"));
        directory.close().unwrap();
    }
}
