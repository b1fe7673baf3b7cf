//! The picture of a scan as a file.

use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::Path;

use tokio_scip::{Scan, Version};

use crate::format::svg::svg;
use crate::format::utc::Utc;

/// Saves the picture in the current directory, under a name of its own: that
/// of the scan's time, and nothing that the sensor says. Gives the name, or what
/// to tell the user. Blocks.
pub(crate) fn save(scan: &Scan, version: &Version) -> Result<String, String> {
    save_in(Path::new("."), scan, version)
}

fn save_in(directory: &Path, scan: &Scan, version: &Version) -> Result<String, String> {
    let stamp = Utc::from(scan.stamp()).file_name();
    let more = (2..1000).map(|number| format!("-{number}"));
    for suffix in std::iter::once(String::new()).chain(more) {
        let name = format!("urg-{stamp}{suffix}.svg");
        // Never over a file that is there.
        match OpenOptions::new().write(true).create_new(true).open(directory.join(&name)) {
            Ok(mut file) => {
                let written = file.write_all(svg(scan, version).as_bytes());
                return written.map(|()| name.clone()).map_err(|error| cannot(&name, &error));
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(cannot(&name, &error)),
        }
    }
    Err(format!("cannot save urg-{stamp}.svg: there are too many of that second"))
}

fn cannot(name: &str, error: &io::Error) -> String {
    format!("cannot save {name}: {error}")
}
