//! [`list`] and [`PortInfo`]: this machine's serial ports, and which are likely to have a sensor.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tokio_serial::{SerialPortInfo, SerialPortType};

use super::thread;
use crate::Error;
use crate::protocol::Text;

/// Number of Hokuyo as the vendor of a USB device. Known sensors have the product number 0.
const HOKUYO: u16 = 0x15d1;

/// Serial port of this machine, as the system describes it. Listing does not open the port.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct PortInfo {
    /// Path to open: `/dev/ttyACM0`, `COM3`. It can change when you unplug the device.
    pub path: String,
    /// Vendor and product number of the USB device that the port belongs to, if any, as `lsusb` writes
    /// them: `15d1:0000`. A sensor on a USB adapter has the numbers of the adapter.
    pub usb_id: Option<String>,
    /// Product name of the USB device.
    pub product: Option<Text>,
    /// Manufacturer name of the USB device.
    pub manufacturer: Option<Text>,
    /// Names of the same port that depend only on the USB socket, sorted: the links in
    /// `/dev/serial/by-path` (Linux; empty elsewhere). Use them to tell two sensors apart. Their
    /// names in `/dev/serial/by-id` are equal, because a URG has no USB serial number.
    pub stable_paths: Vec<String>,
    /// True for the USB port of a Hokuyo sensor (vendor 15d1). False for a sensor on RS-232, which
    /// cannot be recognised without opening the port.
    pub likely_sensor: bool,
}

/// Lists this machine's serial ports: likely sensors, then other USB ports, then the rest, by path.
///
/// Leaves out pseudo-terminals and names without hardware (`/dev/ttyS1`). Cancel-safe, on a thread.
///
/// # Errors
///
/// Fails with [`Open`](crate::ErrorKind::Open) if the system cannot list its ports.
pub async fn list() -> Result<Vec<PortInfo>, Error> {
    let listed = thread::run_on(list_blocking).map_err(|error| Error::open(THE_LIST, error))?;
    listed.await.map_err(|panicked| Error::open(THE_LIST, io::Error::other(panicked)))?
}

/// Name of the port in an error of listing.
const THE_LIST: &str = "the list of serial ports";

fn list_blocking() -> Result<Vec<PortInfo>, Error> {
    let links = stable_paths(Path::new("/dev/serial/by-path"));
    let mut ports: Vec<_> = available()?.into_iter().map(|port| port_info(port, &links)).collect();
    ports.sort_by_cached_key(order);
    Ok(ports)
}

pub(super) fn available() -> Result<Vec<SerialPortInfo>, Error> {
    // tokio_serial panics without this directory, as in some containers.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    if !Path::new(SYS_CLASS_TTY).is_dir() {
        return Ok(Vec::new());
    }
    let mut ports =
        tokio_serial::available_ports().map_err(|error| Error::open(THE_LIST, error.into()))?;
    ports.retain(|port| !is_without_hardware(&port.port_name));
    Ok(ports)
}

const SYS_CLASS_TTY: &str = "/sys/class/tty";

/// Returns true if the kernel has reserved the name but found no UART: a PC has 4 or 32 such names.
fn is_without_hardware(path: &str) -> bool {
    const UNKNOWN_UART: &str = "0";
    Path::new(path)
        .file_name()
        .and_then(|name| fs::read_to_string(Path::new(SYS_CLASS_TTY).join(name).join("type")).ok())
        .is_some_and(|kind| kind.trim() == UNKNOWN_UART)
}

/// Reads the links in `directory`, sorted by name, each with its target.
fn stable_paths(directory: &Path) -> Vec<(String, PathBuf)> {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    let link = |path: PathBuf| Some((path.to_str()?.to_owned(), path.canonicalize().ok()?));
    let mut links: Vec<_> = entries.filter_map(|entry| link(entry.path())).collect();
    links.sort();
    links
}

fn port_info(port: SerialPortInfo, links: &[(String, PathBuf)]) -> PortInfo {
    let target = device(&port.port_name);
    let to_it = links.iter().filter(|(_, path)| target.as_ref() == Some(path));
    let stable_paths = to_it.map(|(name, _)| name.clone()).collect();
    let path = port.port_name;
    let usb = match port.port_type {
        SerialPortType::UsbPort(usb) => Some(usb),
        _ => None,
    };
    let text = |text: &Option<String>| text.as_deref().map(Text::from);
    PortInfo {
        path,
        usb_id: usb.as_ref().map(|usb| format!("{:04x}:{:04x}", usb.vid, usb.pid)),
        product: usb.as_ref().and_then(|usb| text(&usb.product)),
        manufacturer: usb.as_ref().and_then(|usb| text(&usb.manufacturer)),
        stable_paths,
        likely_sensor: usb.is_some_and(|usb| usb.vid == HOKUYO),
    }
}

/// Sort key of a port: sensors, USB, others; `ttyUSB9` before `ttyUSB10`.
fn order(port: &PortInfo) -> (bool, bool, String, u64) {
    let name = port.path.trim_end_matches(|c: char| c.is_ascii_digit());
    let number = port.path.strip_prefix(name).and_then(|digits| digits.parse().ok());
    (!port.likely_sensor, port.usb_id.is_none(), name.to_owned(), number.unwrap_or(0))
}

/// Returns true if `path` is the USB port of a sensor, by any of its names. Blocks.
pub(super) fn is_usb_sensor(path: &str) -> bool {
    // If listing fails, count the port as a serial line, which only makes its deadlines longer.
    let is_it = |port: &PortInfo| port.likely_sensor && is_same(&port.path, path);
    list_blocking().is_ok_and(|ports| ports.iter().any(is_it))
}

/// Returns the port's driver if it is one of Linux's that set another baud rate than they report above
/// 115,200 baud (`findings/adapter_speeds.sh`).
pub(super) fn misreporting_driver(path: &str) -> Option<String> {
    let link = Path::new(SYS_CLASS_TTY).join(device(path)?.file_name()?).join("device/driver");
    let name = fs::read_link(link).ok()?.file_name()?.to_str()?.to_owned();
    (name.starts_with("mos7840") || name.starts_with("ti_usb_3410")).then_some(name)
}

/// Resolves `path` to its device. `None` on Windows: ports are no files there, and
/// `canonicalize` opens the port. Opening a Bluetooth port connects to its device, and
/// opening a board's port may restart the board.
fn device(path: &str) -> Option<PathBuf> {
    if cfg!(windows) { None } else { fs::canonicalize(path).ok() }
}

/// Returns true if `path` is a name of the `listed` port.
pub(super) fn is_same(listed: &str, path: &str) -> bool {
    match (device(listed), device(path)) {
        (Some(listed), Some(path)) => listed == path,
        // On Windows com3 and \\.\COM3 are names of COM3.
        _ => listed.eq_ignore_ascii_case(path.strip_prefix(r"\\.\").unwrap_or(path)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_windows_port_is_the_same_under_all_its_names() {
        assert!(is_same("COM3", r"\\.\com3"));
        assert!(!is_same("COM3", "COM30"));
    }
}
