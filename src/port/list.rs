//! The serial ports of this machine: [`list`], and which of them are sensors'.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use tokio::task::spawn_blocking;
use tokio_serial::{SerialPortInfo, SerialPortType};

use super::serial::open_error;
use crate::Error;
use crate::protocol::Text;

/// A USB device's vendor and product number, written `15d1:0000`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct UsbId {
    /// The vendor.
    pub vendor: u16,
    /// The vendor's product.
    pub product: u16,
}

impl UsbId {
    /// What URG sensors have, all models alike.
    pub const URG: Self = Self { vendor: 0x15d1, product: 0x0000 };
}

impl fmt::Display for UsbId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04x}:{:04x}", self.vendor, self.product)
    }
}

/// As data: its text, such as `"15d1:0000"`.
#[cfg(feature = "serde")]
impl serde::Serialize for UsbId {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A serial port of this machine, as the system describes it; it was not
/// opened to find out.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct PortInfo {
    /// What to open: `/dev/ttyACM0`, `COM3`. It depends on the order in which
    /// devices were plugged in.
    pub path: String,
    /// The USB device that the port belongs to, if it is one. A sensor behind
    /// an adapter shows the adapter's id.
    pub usb_id: Option<UsbId>,
    /// The product as the USB device names it.
    pub product: Option<Text>,
    /// The manufacturer as the USB device names it.
    pub manufacturer: Option<Text>,
    /// Names of the same port that depend only on the socket it is plugged
    /// into, sorted: the links in `/dev/serial/by-path` (Linux; empty
    /// elsewhere). Two sensors have different ones, whereas their names in
    /// `/dev/serial/by-id` collide, since a URG has no USB serial number.
    pub stable_paths: Vec<String>,
}

impl PortInfo {
    /// Whether this is the USB port of a URG sensor. It may be of a model or in
    /// a mode that speaks only SCIP 2. A sensor on RS-232 cannot be told from
    /// anything else there.
    pub fn is_likely_sensor(&self) -> bool {
        self.usb_id == Some(UsbId::URG)
    }
}

/// The serial ports of this machine: likely sensors first, then other USB
/// ports, then the rest, by path.
///
/// Ports that the kernel only keeps a name for (`/dev/ttyS1` without hardware)
/// are left out, pseudo-terminals too. Cancel-safe.
///
/// # Errors
///
/// [`Error::Open`] if the system cannot say.
pub async fn list() -> Result<Vec<PortInfo>, Error> {
    match spawn_blocking(list_blocking).await {
        Ok(ports) => ports,
        Err(panicked_or_cancelled) => Err(open_error(THE_LIST, panicked_or_cancelled.into())),
    }
}

const THE_LIST: &str = "the list of serial ports";

fn list_blocking() -> Result<Vec<PortInfo>, Error> {
    let stable = stable_paths(Path::new("/dev/serial/by-path"));
    let mut ports: Vec<_> = available()?.into_iter().map(|port| port_info(port, &stable)).collect();
    ports.sort_by_cached_key(order);
    Ok(ports)
}

fn available() -> Result<Vec<SerialPortInfo>, Error> {
    // tokio_serial panics without this directory, as in some containers.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    if !Path::new(SYS_CLASS_TTY).is_dir() {
        return Ok(Vec::new());
    }
    let mut ports =
        tokio_serial::available_ports().map_err(|error| open_error(THE_LIST, error.into()))?;
    ports.retain(|port| !is_without_hardware(&port.port_name, Path::new(SYS_CLASS_TTY)));
    Ok(ports)
}

const SYS_CLASS_TTY: &str = "/sys/class/tty";

/// Whether the kernel has reserved the name and found no UART. It lists four
/// or 32 of them on a PC with one.
fn is_without_hardware(path: &str, sys_class_tty: &Path) -> bool {
    const UNKNOWN_UART: &str = "0";
    Path::new(path)
        .file_name()
        .and_then(|name| fs::read_to_string(sys_class_tty.join(name).join("type")).ok())
        .is_some_and(|kind| kind.trim() == UNKNOWN_UART)
}

/// What each link in `directory` points to in the end, with the links' names.
fn stable_paths(directory: &Path) -> BTreeMap<PathBuf, Vec<String>> {
    let mut stable: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for link in fs::read_dir(directory).into_iter().flatten().flatten() {
        if let (Ok(target), Ok(name)) =
            (link.path().canonicalize(), link.path().into_os_string().into_string())
        {
            stable.entry(target).or_default().push(name);
        }
    }
    stable.values_mut().for_each(|names| names.sort());
    stable
}

fn port_info(port: SerialPortInfo, stable: &BTreeMap<PathBuf, Vec<String>>) -> PortInfo {
    let stable_paths = fs::canonicalize(&port.port_name)
        .ok()
        .and_then(|target| stable.get(&target).cloned())
        .unwrap_or_default();
    let path = port.port_name;
    match port.port_type {
        SerialPortType::UsbPort(usb) => PortInfo {
            path,
            usb_id: Some(UsbId { vendor: usb.vid, product: usb.pid }),
            product: usb.product.as_deref().map(Text::from),
            manufacturer: usb.manufacturer.as_deref().map(Text::from),
            stable_paths,
        },
        _ => PortInfo { path, usb_id: None, product: None, manufacturer: None, stable_paths },
    }
}

/// Sensors, USB, others; `ttyUSB9` before `ttyUSB10`.
fn order(port: &PortInfo) -> (bool, bool, String, u64) {
    let name = port.path.trim_end_matches(|c: char| c.is_ascii_digit());
    let number = port.path.strip_prefix(name).and_then(|digits| digits.parse().ok());
    (!port.is_likely_sensor(), port.usb_id.is_none(), name.to_owned(), number.unwrap_or(0))
}

/// The ports that a sensor on USB can be on. Blocks.
pub(super) fn likely_sensors() -> Result<Vec<String>, Error> {
    let ports = list_blocking()?;
    Ok(ports.into_iter().filter(PortInfo::is_likely_sensor).map(|port| port.path).collect())
}

/// Whether `path` is a sensor's own USB port, by whichever of its names.
/// Blocks.
pub(super) fn is_usb_sensor(path: &str) -> bool {
    // A system that cannot list its ports may still open one: its line then
    // counts as a slow one, which only makes deadlines long.
    likely_sensors().is_ok_and(|ports| ports.iter().any(|port| is_same(port, path)))
}

/// Whether the system lists `path`. Blocks.
#[cfg(not(unix))]
pub(super) fn is_listed(path: &str) -> bool {
    available().is_ok_and(|ports| ports.iter().any(|port| is_same(&port.port_name, path)))
}

fn is_same(listed: &str, path: &str) -> bool {
    match (fs::canonicalize(listed), fs::canonicalize(path)) {
        (Ok(listed), Ok(path)) => listed == path,
        // Windows: the names are no files, and com3 and \\.\COM3 are COM3.
        _ => listed.eq_ignore_ascii_case(path.strip_prefix(r"\\.\").unwrap_or(path)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn port(path: &str, usb_id: Option<UsbId>) -> PortInfo {
        PortInfo {
            path: path.to_owned(),
            usb_id,
            product: None,
            manufacturer: None,
            stable_paths: Vec::new(),
        }
    }

    #[test]
    fn sensors_come_first_and_numbers_count_as_numbers() {
        let adapter = Some(UsbId { vendor: 0x0403, product: 0x6001 });
        let mut ports = [
            port("/dev/ttyS0", None),
            port("/dev/ttyUSB10", adapter),
            port("/dev/ttyUSB9", adapter),
            port("/dev/ttyACM2", Some(UsbId::URG)),
            port("/dev/ttyACM0", adapter),
        ];
        ports.sort_by_cached_key(order);
        assert_eq!(
            ports.map(|port| port.path),
            ["/dev/ttyACM2", "/dev/ttyACM0", "/dev/ttyUSB9", "/dev/ttyUSB10", "/dev/ttyS0"]
        );
    }

    #[test]
    fn only_the_urg_id_is_a_likely_sensor() {
        assert!(port("/dev/ttyACM0", Some(UsbId::URG)).is_likely_sensor());
        assert!(!port("/dev/ttyS0", None).is_likely_sensor());
        let hub = UsbId { vendor: 0x15d1, product: 0x0001 };
        assert!(!port("/dev/ttyACM0", Some(hub)).is_likely_sensor());
        assert_eq!(UsbId::URG.to_string(), "15d1:0000");
    }

    #[test]
    fn what_a_usb_device_says_of_itself_is_told() {
        let usb = tokio_serial::UsbPortInfo {
            vid: 0x15d1,
            pid: 0x0000,
            serial_number: None,
            manufacturer: Some("Hokuyo Data Flex for USB".to_owned()),
            product: Some("URG-Series USB Driver\n".to_owned()),
        };
        let port_name = "/dev/ttyACM0".to_owned();
        let port = SerialPortInfo { port_name, port_type: SerialPortType::UsbPort(usb) };
        let info = port_info(port, &BTreeMap::new());
        assert!(info.is_likely_sensor());
        let [product, maker] =
            [info.product, info.manufacturer].map(|text| text.map(|text| text.to_string()));
        assert_eq!(product.as_deref(), Some(r"URG-Series USB Driver\n"), "escaped");
        assert_eq!(maker.as_deref(), Some("Hokuyo Data Flex for USB"));
    }

    #[test]
    fn a_windows_port_is_the_same_under_all_its_names() {
        assert!(is_same("COM3", r"\\.\com3"));
        assert!(!is_same("COM3", "COM30"));
    }

    #[cfg(unix)]
    #[test]
    fn a_port_is_found_through_links_to_it_and_knows_their_names() -> std::io::Result<()> {
        let scratch = std::env::temp_dir().join(format!("tokio-scip-list-{}", std::process::id()));
        let by_path = scratch.join("by-path");
        fs::create_dir_all(&by_path)?;
        let device = scratch.join("ttyACM0");
        fs::write(&device, "")?;
        fs::write(scratch.join("ttyACM1"), "")?;
        for name in ["usbv2-0:1", "usb-0:1"] {
            std::os::unix::fs::symlink("../ttyACM0", by_path.join(name))?;
        }
        std::os::unix::fs::symlink("../gone", by_path.join("usb-0:2"))?;

        let stable = stable_paths(&by_path);
        let info = |path: &Path| {
            let port_name = path.to_string_lossy().into_owned();
            port_info(SerialPortInfo { port_name, port_type: SerialPortType::Unknown }, &stable)
        };
        let link = by_path.join("usb-0:1").to_string_lossy().into_owned();
        let other = by_path.join("usbv2-0:1").to_string_lossy().into_owned();
        assert_eq!(info(&device).stable_paths, [link.clone(), other]);
        assert!(info(&scratch.join("ttyACM1")).stable_paths.is_empty());
        assert!(is_same(&device.to_string_lossy(), &link));
        assert!(!is_same(&scratch.join("ttyACM1").to_string_lossy(), &link));

        fs::create_dir_all(scratch.join("sys/ttyS0"))?;
        fs::create_dir_all(scratch.join("sys/ttyS1"))?;
        fs::write(scratch.join("sys/ttyS0/type"), "4\n")?;
        fs::write(scratch.join("sys/ttyS1/type"), "0\n")?;
        assert!(!is_without_hardware("/dev/ttyS0", &scratch.join("sys")));
        assert!(is_without_hardware("/dev/ttyS1", &scratch.join("sys")));
        assert!(!is_without_hardware("/dev/ttyACM0", &scratch.join("sys")));
        fs::remove_dir_all(scratch)
    }
}
