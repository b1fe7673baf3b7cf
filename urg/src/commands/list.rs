//! `urg list`: lists the serial ports of this machine.

use std::fmt::Write;

use clap::ValueEnum;
use tokio_scip::port::{self, PortInfo};

use crate::failure::{Failure, chain};
use crate::format::json_line;
use crate::output::notice::notice;
use crate::output::stdout::print;

/// List the serial ports, likely sensors first
///
/// A likely sensor has Hokuyo's USB id, 15d1. Behind a USB-to-serial adapter you see the adapter's
/// id, and on RS-232 a sensor looks like any other device: run `urg info PORT` to identify it. This
/// command opens no port. It cannot find a sensor on Ethernet, because none announces itself: try
/// the address with which they are delivered, `urg info tcp://192.168.0.10`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  urg list\n  urg list --format json | jq -r '.[] | select(.likely_sensor).path'"
)]
pub(crate) struct List {
    /// Output format
    #[arg(long, value_enum, default_value_t = ListFormat::Text)]
    format: ListFormat,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ListFormat {
    /// One line per port, and its stable names below it
    Text,
    /// Array with one object per port
    Json,
}

impl List {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let ports = port::list().await.map_err(|error| Failure::Failed(chain(&error)))?;
        if matches!(self.format, ListFormat::Json) {
            return print(json_line(&ports)?).await;
        }
        if ports.is_empty() {
            notice("this machine has no serial port: plug a sensor in, or try `urg info emulated`");
        }
        print(text(&ports)).await
    }
}

fn text(ports: &[PortInfo]) -> String {
    let width = ports.iter().map(|port| port.path.len()).max().unwrap_or_default();
    let mut text = String::new();
    for port in ports {
        let id = port.usb_id.as_deref().unwrap_or_default();
        let mut line = format!("{:width$}  {id:9}", port.path);
        // `Display` escapes control characters in the strings of a USB device.
        for part in [&port.manufacturer, &port.product].into_iter().flatten() {
            let _ = write!(line, "  {part}");
        }
        if port.likely_sensor {
            line.push_str("  (likely a sensor)");
        }
        let _ = writeln!(text, "{}", line.trim_end());
        for stable in &port.stable_paths {
            let _ = writeln!(text, "    {stable}");
        }
    }
    text
}
