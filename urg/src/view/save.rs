//! Saves the picture of a scan to a file.

use std::fs::OpenOptions;
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
    let stamp = time::file_name(scan.stamp());
    let more = (2..1000).map(|number| format!("-{number}"));
    for suffix in std::iter::once(String::new()).chain(more) {
        let name = format!("urg-{stamp}{suffix}.svg");
        // Never overwrite an existing file.
        match OpenOptions::new().write(true).create_new(true).open(directory.join(&name)) {
            Ok(mut file) => {
                let written = file.write_all(svg(scan, version).as_bytes());
                return written.map(|()| name.clone()).map_err(|error| cannot(&name, &error));
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(cannot(&name, &error)),
        }
    }
    Err(format!("cannot save urg-{stamp}.svg: all names for this second are taken"))
}

fn cannot(name: &str, error: &io::Error) -> String {
    format!("cannot save {name}: {error}")
}

#[cfg(test)]
mod tests {
    use tokio_scip::{Sensor, Window};
    use urg_emulator::Emulator;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn each_picture_is_a_file_of_its_own() {
        let sensor = Sensor::builder().connect(Emulator::builder().build()).await.unwrap();
        let scan = sensor.scan(Window::DETECTION).await.unwrap();
        let version = sensor.version().await.unwrap();
        let directory = std::env::temp_dir().join(format!("urg-save-{}", std::process::id()));
        std::fs::create_dir(&directory).unwrap();
        let mut names: Vec<_> =
            (0..3).map(|_| save_in(&directory, &scan, &version).unwrap()).collect();
        for name in &names {
            let text = std::fs::read_to_string(directory.join(name)).unwrap();
            assert!(text.ends_with("</svg>\n"), "{name}");
            assert!(!name.contains("H0713090"), "nothing of the sensor's in a name");
        }
        names.dedup();
        assert_eq!(names.len(), 3, "{names:?}");
        std::fs::remove_dir_all(&directory).unwrap();
        let error = save_in(&directory, &scan, &version).unwrap_err();
        assert!(error.starts_with("cannot save urg-"), "{error}");
    }
}
