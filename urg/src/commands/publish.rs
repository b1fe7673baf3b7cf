//! `urg publish`: publishes scans as ROS 2 messages, to ROS 2 or to Foxglove.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4};
use std::ops::RangeInclusive;
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_scip::Rate;
use tokio_scip::scan::Pose;
use urg_recording::ros::Transform;

use crate::args::{LinkArgs, WindowArgs, frame_id, listen_address};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::plot::pose::{self, FARTHEST};
use crate::port::name::{PortArg, PortName, missing_port};
use crate::port::named::NamedPort;
use crate::publish::{
    Discovery, EngineName, EngineSettings, Mode, NameArgs, NodeNames, Qos, RunningEngine, Source,
};

/// Default router, as in `rmw_zenoh`.
const DEFAULT_ROUTER: &str = "tcp/localhost:7447";

/// Default engine: the most common one in ROS 2, if built in.
const DEFAULT_ENGINE: EngineName = if cfg!(feature = "dds") {
    EngineName::Dds
} else if cfg!(feature = "foxglove") && !cfg!(feature = "zenoh") {
    EngineName::Foxglove
} else {
    EngineName::Zenoh
};

/// ROS domains whose ports exist.
const DOMAINS: RangeInclusive<i64> = 0..=232;

/// Address that Foxglove connects to by default.
const DEFAULT_LISTEN: SocketAddr = SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 8765));

/// Publish scans and diagnostics to ROS 2, or to Foxglove
///
/// Runs until Ctrl-C. Unplug a sensor or lose the network: publishing resumes when it is
/// back. Nothing is protected: anyone on your network can read the scans, and publish
/// others in their place (see "Who can read and write" in `guide/publish.md`).
#[derive(Debug, clap::Args)]
#[command(
    // Launch files append their parameters.
    args_override_self = true,
    after_help = "`--help` explains names and topics",
    after_long_help = HELP
)]
pub(crate) struct Publish {
    /// Port of the sensor; for several sensors, give each as NAME=PORT
    #[arg(value_name = "PORT")]
    sensors: Vec<NamedPort>,
    /// Port of the sensor without PORT: the parameters of a launch file name it
    #[arg(long, value_name = "PORT", hide = true)]
    port: Option<NamedPort>,
    /// Network to publish on
    #[arg(long, value_enum, value_name = "ENGINE", default_value_t = DEFAULT_ENGINE)]
    engine: EngineName,
    #[command(flatten)]
    names: NameArgs,
    /// Pose of the sensor in the frame PARENT, in metres and degrees, for /tf_static; `PARENT,X,Y,Z,YAW,upside-down`
    /// if it is, and `YAW,PITCH,ROLL` if it is tilted; for several sensors, repeat the option in the same order
    #[arg(long, value_name = "PARENT,X,Y,Z,YAW", value_parser = mounting, help_heading = "ROS")]
    tf: Vec<Transform>,
    /// ROS domain, 0 to 232 [default: ROS_DOMAIN_ID, else 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(DOMAINS),
        allow_hyphen_values = true, help_heading = "ROS")]
    domain: Option<u16>,
    /// Delivery: `sensor` serves only readers that ask for best effort
    #[arg(long, value_enum, value_name = "QOS", default_value_t = Qos::Reliable,
        help_heading = "ROS")]
    qos: Qos,
    /// Scans kept for readers that missed some [default: 20, 5 for `sensor`]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000),
        help_heading = "ROS")]
    depth: Option<u16>,
    /// Seconds to add to each stamp, such as -0.005
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = seconds,
        allow_hyphen_values = true, help_heading = "ROS")]
    time_offset: f64,
    /// Use only the network interface with this address
    #[arg(long, value_name = "IP", value_parser = address, help_heading = "Network")]
    interface: Option<IpAddr>,
    /// Address of the zenoh router [default: tcp/localhost:7447]
    #[arg(long, value_name = "LOCATOR", value_parser = router, help_heading = "Network")]
    router: Option<String>,
    /// Zenoh session mode [default: client]
    #[arg(long, value_enum, value_name = "MODE", help_heading = "Network")]
    mode: Option<Mode>,
    /// Address to serve Foxglove and Lichtblick on [default: 127.0.0.1:8765]
    #[arg(long, value_name = "IP:PORT", value_parser = listen, help_heading = "Network")]
    listen: Option<SocketAddr>,
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10; a recording: its own pace]
    #[arg(long, value_name = "HZ")]
    rate: Option<Rate>,
    /// Publish each scan of the sensor (0), each second one (1) and so on, instead of --rate
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=9),
        allow_hyphen_values = true, conflicts_with = "rate")]
    skip: Option<u32>,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    link: LinkArgs,
}

const HELP: &str = "\
Topics:
  scan          sensor_msgs/msg/LaserScan, stamped with the time of its first ray
  /diagnostics  diagnostic_msgs/msg/DiagnosticArray, once a second
  /tf_static    tf2_msgs/msg/TFMessage, with --tf, twice a second

Names: `--namespace robot` moves the node and `scan`: /robot/scan. `front=PORT` is the
node /front/urg_node with the topic /front/scan in the frame front_laser. All sensors
share one connection to the network, and are polled in turn.

Examples:
  urg publish /dev/ttyACM0                  then: ros2 topic hz /scan
  urg publish front=/dev/ttyACM0 rear=serial:H0713091 --qos sensor
  urg publish emulated --tf base_link,0.2,0,0.1,0
  urg publish emulated --ros-args -r __node:=front -r scan:=front/scan -p depth:=5
  urg publish emulated --engine foxglove    then: open ws://localhost:8765 in Lichtblick
  urg publish serial:H0713090 --wait --engine zenoh --router tcp/10.0.0.1:7447";

impl Publish {
    /// Returns the nodes, or none if a name is invalid.
    pub(crate) fn nodes(&self) -> Vec<NodeNames> {
        // Without a sensor yet: the parameters of the node may name its port.
        let sensors = match &*self.sensors() {
            [] => vec![NamedPort::from(PortName::Emulated(Pose::default()))],
            sensors => sensors.to_vec(),
        };
        self.names.resolve(&sensors).unwrap_or_default()
    }

    fn sensors(&self) -> Vec<NamedPort> {
        match &*self.sensors {
            [] => self.port.iter().cloned().collect(),
            sensors => sensors.to_vec(),
        }
    }

    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let sensors = self.sensors();
        if sensors.is_empty() {
            return Err(missing_port().await);
        }
        if !self.sensors.is_empty() && self.port.is_some() {
            notice("the port of the parameters changes nothing: the command line has one");
        }
        let names = self.names.resolve(&sensors)?;
        let mut polled = Vec::new();
        for sensor in &sensors {
            if self.skip.is_some() && sensor.port.recorded().is_some() {
                let text = format!("--skip is for a sensor: {} is a recording", sensor.port);
                return Err(Failure::Usage(text));
            }
            let port = PortArg { name: Some(sensor.port.clone()) };
            let (port, rate) = interrupt.unless(port.polled_at(self.rate)).await?;
            let window = self.window.window(port.default_window())?;
            polled.push((port, rate, window));
        }
        let settings = self.settings(names.clone())?;
        let (mut engine, outlets) = RunningEngine::start(self.engine, settings)?;

        let count = polled.len();
        let epoch = Instant::now();
        let (mut scans, mut diagnostics) = (JoinSet::new(), JoinSet::new());
        for (place, ((names, (port, rate, window)), outlet)) in
            names.into_iter().zip(polled).zip(outlets).enumerate()
        {
            let name = format!("{port} ({})", names.topic);
            let source = Arc::new(Source {
                port,
                link: self.link.clone(),
                window,
                rate,
                skip: self.skip,
                names,
                time_offset: self.time_offset,
                outlet,
                epoch,
                phase: place as f64 / count as f64,
                condition: Mutex::default(),
            });
            let scanned = Arc::clone(&source);
            scans.spawn(async move { (name, scanned.publish_scans().await) });
            diagnostics.spawn(async move { source.publish_diagnostics().await });
        }
        let outcome = tokio::select! {
            outcome = all_ended(&mut scans) => outcome,
            failure = engine.failed() => Err(failure),
            _ = interrupt.requested() => Ok(()),
        };
        scans.shutdown().await;
        diagnostics.shutdown().await;
        engine.close().await;
        outcome
    }

    fn settings(&self, nodes: Vec<NodeNames>) -> Result<EngineSettings, Failure> {
        let default_depth = if self.qos == Qos::Sensor { 5 } else { 20 };
        let domain = self.domain.map_or_else(domain_of_environment, Ok)?;
        if let (EngineName::Dds, Some(IpAddr::V6(address))) = (self.engine, self.interface) {
            return Err(Failure::Usage(format!(
                "--interface {address}: expected an IPv4 address, DDS uses no other here"
            )));
        }
        self.check_engine()?;
        if !self.tf.is_empty() && self.tf.len() != nodes.len() {
            return Err(Failure::Usage(format!(
                "--tf: expected one for each of {} sensors, found {}",
                nodes.len(),
                self.tf.len()
            )));
        }
        let child = |(tf, names): (&Transform, &NodeNames)| Transform {
            child: names.frame.clone(),
            ..tf.clone()
        };
        let transforms: Vec<_> = self.tf.iter().zip(&nodes).map(child).collect();
        if let Some(tf) = transforms.iter().find(|tf| tf.parent == tf.child) {
            return Err(Failure::Usage(format!(
                "--tf: the parent `{}` is the frame of the sensor itself: expected another \
                 frame, such as base_link",
                tf.parent
            )));
        }
        Ok(EngineSettings {
            transforms,
            nodes,
            domain,
            qos: self.qos,
            depth: self.depth.unwrap_or(default_depth).into(),
            interface: self.interface,
            discovery: Discovery::from_environment()?,
            router: self.router.clone().unwrap_or_else(|| DEFAULT_ROUTER.to_owned()),
            mode: self.mode.unwrap_or(Mode::Client),
            listen: self.listen.unwrap_or(DEFAULT_LISTEN),
        })
    }

    /// Refuses options of another engine.
    fn check_engine(&self) -> Result<(), Failure> {
        let engine = format!("{:?}", self.engine).to_lowercase();
        for (option, is_given, engines) in [
            ("--router", self.router.is_some(), &["zenoh"][..]),
            ("--mode", self.mode.is_some(), &["zenoh"]),
            ("--listen", self.listen.is_some(), &["foxglove"]),
            ("--domain", self.domain.is_some(), &["dds", "zenoh"]),
            ("--interface", self.interface.is_some(), &["dds", "zenoh"]),
        ] {
            if is_given && !engines.contains(&&*engine) {
                return Err(Failure::Usage(format!(
                    "{option} is for {}: add `--engine {}`, or leave it out",
                    engines.join(" and "),
                    engines.join("` or `--engine "),
                )));
            }
        }
        Ok(())
    }
}

/// Waits until the scans of all sensors have ended: for each its name, and how it ended. While
/// others continue, an error is only printed. The last error ends the program.
async fn all_ended(scans: &mut JoinSet<(String, Result<(), Failure>)>) -> Result<(), Failure> {
    let mut failure = Ok(());
    while let Some(ended) = scans.join_next().await {
        let (name, outcome) =
            ended.map_err(|error| Failure::new("publishing has failed", &error))?;
        if let Err(error) = outcome {
            if !scans.is_empty() {
                notice(format_args!("{name}: {}; the others continue", error.line()));
            }
            failure = Err(error);
        }
    }
    failure
}

fn domain_of_environment() -> Result<u16, Failure> {
    let Some(text) = std::env::var_os("ROS_DOMAIN_ID").filter(|text| !text.is_empty()) else {
        return Ok(0);
    };
    let domain = text.to_str().and_then(|text| text.parse().ok());
    domain.filter(|domain| DOMAINS.contains(&i64::from(*domain))).ok_or_else(|| {
        let expected = format!("expected {} to {}", DOMAINS.start(), DOMAINS.end());
        Failure::Usage(format!("invalid ROS_DOMAIN_ID {text:?}: {expected}"))
    })
}

fn address(text: &str) -> Result<IpAddr, &'static str> {
    text.parse().map_err(|_| "expected the address of an interface, such as 192.168.1.10")
}

fn listen(text: &str) -> Result<SocketAddr, &'static str> {
    let address = listen_address(text).ok().and_then(|address| address.parse().ok());
    address.ok_or(
        "expected a port number such as 8765, or an address and a port, such as 0.0.0.0:8765",
    )
}

/// Checks a locator: this build of zenoh has TCP only.
fn router(text: &str) -> Result<String, String> {
    let expected = "expected tcp/HOST:PORT, such as tcp/192.168.1.10:7447";
    let (scheme, address) = text.split_once('/').ok_or(expected)?;
    if scheme != "tcp" {
        return Err(format!("`{scheme}` is not built in; {expected}"));
    }
    // Link settings may follow the address.
    let address = address.split(['#', '?']).next().unwrap_or_default();
    let (host, port) = address.rsplit_once(':').ok_or(expected)?;
    let is_host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).map_or_else(
        || !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || "-._".contains(c)),
        |host| host.parse::<Ipv6Addr>().is_ok(),
    );
    let is_port = port.parse::<u16>().is_ok_and(|port| port > 0);
    if is_host && is_port { Ok(text.to_owned()) } else { Err(expected.to_owned()) }
}

fn seconds(text: &str) -> Result<f64, &'static str> {
    text.parse()
        .ok()
        .filter(|seconds: &f64| seconds.abs() <= 3600.0)
        .ok_or("expected seconds between -3600 and 3600, such as -0.005")
}

/// Parses `--tf`: `PARENT,X,Y,Z,YAW`: metres forward, left and up, and degrees counter-clockwise, with
/// more for a sensor that is not upright. The child, the frame of the sensor, is not known yet.
fn mounting(text: &str) -> Result<Transform, String> {
    let (parent, numbers) = text.split_once(',').unwrap_or((text, ""));
    let is_frame = frame_id(parent).is_ok();
    match pose::distances_and_angles(numbers).filter(|_| is_frame) {
        Some((translation, rotation)) => {
            Ok(Transform { parent: parent.to_owned(), child: String::new(), translation, rotation })
        }
        None => Err(format!(
            "expected PARENT,X,Y,Z,YAW in metres and degrees, such as base_link,0.2,0,0.1,90, \
             at most {FARTHEST} m and 360°, and `,upside-down` or `,PITCH,ROLL` after it for a \
             sensor that is not upright"
        )),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use tokio_scip::Window;

    use super::*;
    use crate::publish::ros_args;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        publish: Publish,
    }

    /// Starts the node with a file of parameters, as a launch file does.
    fn launched(parameters: &str, more: &[&str]) -> Result<Publish, String> {
        let yaml = tempfile::NamedTempFile::new().unwrap();
        let text = format!("urg_node2: {{ros__parameters: {{{parameters}}}}}");
        std::fs::write(yaml.path(), text).unwrap();
        let path = yaml.path().to_str().unwrap();
        let names = ["urg", "--ros-args", "-r", "__node:=urg_node2", "-r", "scan:=scan_1st"];
        let file = ["--params-file", path];
        let arguments = names.iter().chain(&file).chain(more);
        let nodes = |line: &[std::ffi::OsString]| {
            Line::try_parse_from(line).map(|line| line.publish.nodes()).unwrap_or_default()
        };
        let line = ros_args::as_options(arguments.map(Into::into).collect(), nodes);
        let line = line.map_err(|failure| failure.line().to_owned())?;
        let line = Line::try_parse_from(line).map_err(|error| error.to_string())?;
        Ok(line.publish)
    }

    fn ports(publish: &Publish) -> Vec<String> {
        publish.sensors().iter().map(|sensor| sensor.port.to_string()).collect()
    }

    #[test]
    fn a_file_of_urg_node2_names_sensor_window_and_rate() {
        let ethernet = "ip_address: '192.168.0.10', ip_port: 10940, frame_id: 'laser_1st', \
                        calibrate_time: false, synchronize_time: false, publish_intensity: false, \
                        publish_multiecho: false, error_limit: 4, error_reset_period: 5.0, \
                        diagnostics_tolerance: 0.05, diagnostics_window_time: 5.0, \
                        time_offset: 0.0, angle_min: -3.14, angle_max: 3.14, skip: 0, cluster: 1";
        let publish = launched(ethernet, &[]).unwrap();
        assert_eq!(ports(&publish), ["tcp://192.168.0.10:10940"]);
        assert_eq!((publish.skip, publish.link.intensity), (Some(0), false));
        assert_eq!(publish.window.window(Window::DETECTION).unwrap(), Window::DETECTION);
        let names = publish.names.resolve(&publish.sensors()).unwrap().remove(0);
        assert_eq!(
            (names.full_name(), names.topic, names.frame),
            ("/urg_node2".into(), "/scan_1st".into(), "laser_1st".into())
        );
        let serial = "serial_port: '/dev/ttyACM0', serial_baud: 115200, angle_min: -1.570797, \
                      angle_max: 1.570797, skip: 3, cluster: 2, publish_intensity: true";
        let publish = launched(serial, &[]).unwrap();
        assert_eq!(ports(&publish), ["/dev/ttyACM0"]);
        assert_eq!((publish.skip, publish.link.baud), (Some(3), "115200".parse().ok()));
        assert!(publish.link.intensity);
        let window = publish.window.window(Window::DETECTION).unwrap();
        assert_eq!((window.start(), window.end(), window.cluster_count()), (128, 640, 2));
    }

    #[test]
    fn a_port_on_the_command_line_comes_first() {
        let publish = launched("ip_address: '10.0.0.1'", &["--", "emulated"]).unwrap();
        assert_eq!(ports(&publish), ["emulated"]);
    }

    #[test]
    fn a_parameter_that_no_sensor_has_is_refused() {
        for (parameters, expected) in [
            ("skip: 10", "10 is not in 0..=9"),
            ("cluster: 0", "0 is not in 1..=99"),
            ("ip_address: '10.0.0.1', ip_port: 0", "1 to 65535"),
            ("angle_min: left", "expected radians for angle_min"),
            ("angle_max: [1]", "expected one value for angle_max"),
            ("skip: 0, rate: 10", "cannot be used with"),
        ] {
            let error = launched(parameters, &[]).err().unwrap();
            assert!(error.contains(expected), "{parameters}: {error}");
        }
    }
}
