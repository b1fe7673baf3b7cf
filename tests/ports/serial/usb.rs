//! Sensors on USB, found by their serial numbers: the system's list of ports, the search,
//! and what differs from RS-232.
//!
//! No sensor is needed. Each test runs itself once more in a mount namespace of its own, in
//! which /dev and /sys/class are empty but for what it puts there: pseudo-terminals with
//! emulated sensors behind names like /dev/ttyACM0. Where a user may not make such a
//! namespace, it prints a line that begins with `skipped:`.

use std::fs;
use std::io::Write as _;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use futures::future::join_all;
use tokio_scip::port::{Connect, Port, list};
use tokio_scip::{BaudRate, Endpoint, ErrorKind, State};
use urg_emulator::Pty;

use super::{Scratch, line};
use crate::common::{builder, open_serial, truthful};

/// Set in the namespace.
const INSIDE: &str = "SCIP_TEST_USB";

/// Namespace, for unshare(1).
const NAMESPACE: [&str; 3] = ["--user", "--map-root-user", "--mount"];

/// Exit code of the script below where it may not mount.
const NOT_ALLOWED: i32 = 77;

/// Makes the file systems, in a folder, and runs a program: FOLDER PROGRAM ARGUMENTS.
const MAKE: &str = r#"
dev=$1
shift
{
    mount -t tmpfs none /sys/class &&
        mount -t tmpfs none "$dev" &&
        mkdir "$dev/pts" &&
        mount -t devpts -o newinstance,ptmxmode=0666 none "$dev/pts" &&
        ln -s pts/ptmx "$dev/ptmx" &&
        touch "$dev/null" &&
        mount --bind /dev/null "$dev/null" &&
        mount --rbind "$dev" /dev &&
        mkdir /sys/class/tty
} || exit 77
exec "$@"
"#;

/// Returns true in the namespace. Otherwise runs the test with this name there, and fails if
/// it fails.
fn is_inside(test: &str) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let scratch = Scratch::new(test);
    let inside = Command::new("unshare")
        .args(NAMESPACE)
        .args(["sh", "-c", MAKE, "sh"])
        .arg(scratch.path(""))
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", "--nocapture", &format!("ports::serial::usb::{test}")])
        .env(INSIDE, "1")
        .output();
    match inside {
        Ok(output) if output.status.success() => {
            let text = String::from_utf8_lossy(&output.stdout);
            assert!(text.contains("1 passed"), "no such test: {text}");
        }
        Ok(output) if output.status.code() != Some(NOT_ALLOWED) && may_make_namespaces() => {
            panic!("{}", String::from_utf8_lossy(&[output.stdout, output.stderr].concat()))
        }
        _ => {
            // `eprintln!` would be captured.
            let _ = writeln!(std::io::stderr(), "skipped: mount namespaces, for {test}");
        }
    }
    false
}

fn may_make_namespaces() -> bool {
    let outcome = Command::new("unshare").args(NAMESPACE).arg("true").output();
    outcome.is_ok_and(|output| output.status.success())
}

/// Adds a port to the system's list, of a USB device or of the mainboard.
fn list_port(name: &str, usb_id: Option<&str>) {
    let class = Path::new("/sys/class");
    let interface = class.join("devices").join(name).join("1.0");
    fs::create_dir_all(&interface).unwrap();
    let device = interface.parent().unwrap();
    if let Some((vendor, product)) = usb_id.and_then(|id| id.split_once(':')) {
        fs::write(device.join("idVendor"), vendor).unwrap();
        fs::write(device.join("idProduct"), product).unwrap();
        fs::write(device.join("product"), "URG-Series USB Driver\n").unwrap();
        fs::write(device.join("manufacturer"), "Hokuyo Data Flex\x1b for USB\n").unwrap();
    }
    let subsystem = class.join(if usb_id.is_some() { "usb" } else { "pnp" });
    fs::create_dir_all(&subsystem).unwrap();
    symlink(subsystem, interface.join("subsystem")).unwrap();
    let tty = class.join("tty").join(name);
    fs::create_dir(&tty).unwrap();
    symlink(interface, tty.join("device")).unwrap();
}

/// Id of URG sensors.
const URG: &str = "15d1:0000";

/// Plugs in a sensor, at this name below /dev.
fn plug_in(name: &str, serial_number: &str) {
    list_port(name, Some(URG));
    let emulator = truthful().usb().serial_number(serial_number).build();
    let terminal = Pty::open(&emulator, Some(&Path::new("/dev").join(name))).unwrap();
    tokio::spawn(terminal.serve());
}

#[tokio::test]
async fn a_sensor_is_found_by_serial_number() {
    if !is_inside("a_sensor_is_found_by_serial_number") {
        return;
    }
    plug_in("ttyACM0", "H0000001");
    plug_in("ttyACM1", "H0713090");
    let sensor = builder().open("serial:H0713090").await.unwrap();
    assert_eq!(sensor.version().await.unwrap().serial_number, "H0713090");
    let state = sensor.watch_state().get();
    assert!(matches!(state, State::Connected { baud_rate: None, .. }), "{state:?}");
    // The other one was closed again.
    let other = builder().open("/dev/ttyACM0").await.unwrap();
    assert_eq!(other.version().await.unwrap().serial_number, "H0000001");
    other.close().await;
    let error = builder().open("serial:H0000002").await.unwrap_err();
    let ErrorKind::NoSuchSensor { found, .. } = error.kind() else { panic!("{error}") };
    assert_eq!(*found, ["H0000001"], "the other port is busy");
    let told = "no sensor with serial number H0000002 on any port, only H0000001: plug it in";
    assert!(error.to_string().contains(told), "{error}");
}

#[tokio::test]
async fn simultaneous_searches_each_find_a_sensor() {
    if !is_inside("simultaneous_searches_each_find_a_sensor") {
        return;
    }
    const COUNT: usize = 4;
    for n in 0..COUNT {
        plug_in(&format!("ttyACM{n}"), &format!("H000000{n}"));
    }
    for shift in 0..COUNT {
        let open = |n| builder().open(format!("serial:H000000{}", (n + shift) % COUNT));
        for found in join_all((0..COUNT).map(open)).await {
            found.unwrap_or_else(|error| panic!("moved by {shift}: {error}")).close().await;
        }
    }
}

/// Waits until a port that was dropped is closed: on a busy machine the search takes it for a hanging one.
async fn is_closed(name: &str) {
    let path = Path::new("/dev").join(name);
    while open_serial(path.to_str().unwrap()).await.is_err() {}
}

#[tokio::test]
async fn a_search_starts_over_after_a_success() {
    if !is_inside("a_search_starts_over_after_a_success") {
        return;
    }
    for name in ["ttyACM0", "ttyACM1"] {
        plug_in(name, "H0000001");
    }
    let mut connector = Endpoint::SerialNumber("H0713090".to_owned()).into_connector();
    assert!(!connector.hints().unwrap().has_more(), "it has not begun");
    for name in ["ttyACM0", "ttyACM1"] {
        drop(connector.connect().await.unwrap());
        is_closed(name).await;
        assert!(connector.hints().unwrap().has_more());
    }
    let error = connector.connect().await.map(drop).unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::NoSuchSensor { .. }), "{error}");
    assert!(!connector.hints().unwrap().has_more());

    drop(connector.connect().await.unwrap());
    is_closed("ttyACM0").await;
    connector.hints().unwrap().found();
    assert!(!connector.hints().unwrap().has_more());
    let _first_again = connector.connect().await.unwrap();
    let error = open_serial("/dev/ttyACM0").await.err().unwrap();
    assert!(matches!(error.kind(), ErrorKind::Busy { .. }), "{error}");
}

#[tokio::test]
async fn only_an_adapter_has_a_baud_rate() {
    if !is_inside("only_an_adapter_has_a_baud_rate") {
        return;
    }
    plug_in("ttyACM0", "H0713090");
    let line = line();
    symlink(&line.path, "/dev/ttyUSB0").unwrap();
    list_port("ttyUSB0", Some("0403:6001"));
    fs::create_dir_all("/dev/serial/by-path").unwrap();
    symlink("../../ttyACM0", "/dev/serial/by-path/usb-0:1").unwrap();

    for path in ["/dev/ttyACM0", "/dev/serial/by-path/usb-0:1"] {
        let mut port = open_serial(path).await.unwrap();
        assert_eq!(
            (port.baud_rate(), port.hints().unwrap().can_die_silently()),
            (None, false),
            "{path}"
        );
    }
    let mut port = open_serial("/dev/ttyUSB0").await.unwrap();
    assert_eq!(
        (port.baud_rate(), port.hints().unwrap().can_die_silently()),
        (Some(BaudRate::B19200), true)
    );
}

#[tokio::test]
async fn a_driver_that_misreports_gets_no_high_baud_rate() {
    if !is_inside("a_driver_that_misreports_gets_no_high_baud_rate") {
        return;
    }
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let terminal = Pty::open(&emulator, Some(Path::new("/dev/ttyUSB0"))).unwrap();
    let name = fs::canonicalize("/dev/ttyUSB0").unwrap();
    let device = Path::new("/sys/class/tty").join(name.file_name().unwrap()).join("device");
    fs::create_dir_all(&device).unwrap();
    tokio::spawn(terminal.serve());
    for (driver, is_refused) in
        [("mos7840", true), ("ti_usb_3410_5052_1", true), ("ftdi_sio", false)]
    {
        let link = device.join("driver");
        let _ = fs::remove_file(&link);
        symlink(Path::new("../drivers").join(driver), link).unwrap();
        let sensor = builder().open("/dev/ttyUSB0").await.unwrap();
        sensor.set_baud_rate(BaudRate::B115200).await.unwrap();
        let outcome = sensor.set_baud_rate(BaudRate::B250000).await;
        let baud_rate = if let Err(error) = &outcome {
            assert!(
                matches!(error.kind(), ErrorKind::UnsupportedBaudRate { source: Some(_), .. }),
                "{error:?}"
            );
            let remedy = format!("driver {driver} sets another baud rate than it reports: use");
            assert!(format!("{error:?}").contains(&remedy), "{error:?}");
            BaudRate::B115200
        } else {
            BaudRate::B250000
        };
        assert_eq!(outcome.is_err(), is_refused, "{driver}");
        // It stayed with the sensor.
        assert_eq!(sensor.version().await.unwrap().serial_number, "H0713090");
        let state = sensor.watch_state().get();
        assert!(
            matches!(state, State::Connected { baud_rate: Some(now), .. } if now == baud_rate),
            "{state:?}"
        );
        sensor.close().await;
    }
}

#[tokio::test]
async fn the_list_has_sensors_first_and_no_name_without_hardware() {
    if !is_inside("the_list_has_sensors_first_and_no_name_without_hardware") {
        return;
    }
    assert_eq!(list().await.unwrap(), []);
    let adapter = "0403:6001";
    let ports = [
        ("ttyS0", None),
        ("ttyS1", None),
        ("ttyUSB9", Some(adapter)),
        ("ttyUSB10", Some(adapter)),
        ("ttyACM0", Some(adapter)),
        ("ttyACM2", Some(URG)),
    ];
    for (name, usb_id) in ports {
        list_port(name, usb_id);
        fs::write(Path::new("/dev").join(name), "").unwrap();
    }
    // A UART of the mainboard, and a name that the kernel has reserved.
    fs::write("/sys/class/tty/ttyS0/type", "4\n").unwrap();
    fs::write("/sys/class/tty/ttyS1/type", "0\n").unwrap();
    fs::create_dir_all("/dev/serial/by-path").unwrap();
    let links =
        ["usb-0:1", "usb-1:1", "usbv2-0:1"].map(|link| format!("/dev/serial/by-path/{link}"));
    for link in [1, 2, 0] {
        symlink("../../ttyACM2", &links[link]).unwrap();
    }
    symlink("../../gone", "/dev/serial/by-path/usb-0:2").unwrap();

    let ports = list().await.unwrap();
    let names: Vec<_> = ports.iter().map(|port| port.path.as_str()).collect();
    let in_order = ["ttyACM2", "ttyACM0", "ttyUSB9", "ttyUSB10", "ttyS0"];
    assert_eq!(names, in_order.map(|name| format!("/dev/{name}")));
    let ids: Vec<_> = ports.iter().map(|port| port.usb_id.as_deref()).collect();
    assert_eq!(ids, [Some(URG), Some(adapter), Some(adapter), Some(adapter), None]);
    let [product, maker] = [&ports[0].product, &ports[0].manufacturer]
        .map(|text| text.as_ref().map(ToString::to_string));
    assert_eq!(product.as_deref(), Some("URG-Series USB Driver"));
    assert_eq!(maker.as_deref(), Some(r"Hokuyo Data Flex\x1b for USB"), "escaped");
    assert_eq!(ports[0].stable_paths, links);
    assert!(ports[0].likely_sensor && ports[1..].iter().all(|port| !port.likely_sensor));
    assert!(ports[1..].iter().all(|port| port.stable_paths.is_empty()));

    fs::remove_dir_all("/sys/class/tty").unwrap();
    assert_eq!(list().await.unwrap(), [], "a container without the folder");
}
