//! `urg list`: the serial ports of this machine.

use std::fmt::Write;

use tokio_scip::port::{self, PortInfo};

use crate::failure::{Failure, chain};
use crate::notice::notice;
use crate::output::print;

/// List the serial ports, likely sensors first
///
/// A likely sensor has the USB id of the URG sensors, 15d1:0000. A sensor behind
/// a USB-to-serial adapter shows the adapter's id, and one on RS-232 cannot be
/// told from anything else: `urg info PORT` asks who is there. No port is
/// opened.
#[derive(Debug, clap::Args)]
pub(crate) struct List {}

impl List {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let ports = port::list().await.map_err(|error| Failure::Failed(chain(&error)))?;
        if ports.is_empty() {
            notice("no serial ports here: plug a sensor in, or try `urg info emulated`");
        }
        print(&text(&ports)).await
    }
}

fn text(ports: &[PortInfo]) -> String {
    let width = ports.iter().map(|port| port.path.len()).max().unwrap_or_default();
    let mut text = String::new();
    for port in ports {
        let id = port.usb_id.map(|id| id.to_string()).unwrap_or_default();
        let mut line = format!("{:width$}  {id:9}", port.path);
        // What a USB device says of itself is escaped by its `Display`.
        for part in [&port.manufacturer, &port.product].into_iter().flatten() {
            let _ = write!(line, "  {part}");
        }
        if port.is_likely_sensor() {
            line.push_str("  (likely a sensor)");
        }
        let _ = writeln!(text, "{}", line.trim_end());
        for stable in &port.stable_paths {
            let _ = writeln!(text, "    {stable}");
        }
    }
    text
}
