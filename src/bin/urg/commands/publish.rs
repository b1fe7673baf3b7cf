//! `urg publish`: scans as ROS 2 messages on a network.

use std::net::IpAddr;

use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_scip::{Rate, Window};

use crate::args::{LinkArgs, WindowArgs};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::port::missing;
use crate::port::name::{PortArg, PortName};
use crate::port::named::NamedPort;
use crate::publish::{
    EngineName, EngineSettings, Mode, NodeNames, NodeSpec, ParameterValue, Qos, RunningEngine,
    Source,
};

/// The engine by default: the one that most of ROS 2 uses, where it is built in.
const DEFAULT_ENGINE: EngineName =
    if cfg!(feature = "ros2") { EngineName::Dds } else { EngineName::Zenoh };

/// Publish scans and diagnostics to ROS 2
///
/// Goes on until Ctrl-C, also when a sensor is unplugged and comes back, and when
/// the network does. Nothing is protected: whoever can reach the network reads the
/// scans, and can publish others in their place (see "Who can read and write" in the guide `ros2`).
#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` explains names and topics", after_long_help = HELP)]
pub(crate) struct Publish {
    /// Port of the sensor; NAME=PORT for each of several sensors
    #[arg(value_name = "PORT")]
    sensors: Vec<NamedPort>,
    /// Network to publish on
    #[arg(long, value_enum, value_name = "ENGINE", default_value_t = DEFAULT_ENGINE)]
    engine: EngineName,
    /// Topic of the scans; without the leading `/` it is in the namespace
    #[arg(long, value_name = "NAME", default_value = "/scan", help_heading = "ROS")]
    topic: String,
    /// Name of the node
    #[arg(long, value_name = "NAME", default_value = "urg_node", help_heading = "ROS")]
    node: String,
    /// Namespace of the node
    #[arg(long, value_name = "NAME", default_value = "/", help_heading = "ROS")]
    namespace: String,
    /// Frame that the angles are in
    #[arg(long, value_name = "NAME", default_value = "laser", help_heading = "ROS")]
    frame: String,
    /// ROS domain, 0 to 232 [default: that of ROS_DOMAIN_ID, else 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232),
        help_heading = "ROS")]
    domain: Option<u16>,
    /// Delivery: `sensor` serves only readers that ask for best effort
    #[arg(long, value_enum, value_name = "QOS", default_value_t = Qos::Reliable,
        help_heading = "ROS")]
    qos: Qos,
    /// Scans kept for a reader that missed them [default: 20, 5 for `sensor`]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000),
        help_heading = "ROS")]
    depth: Option<u16>,
    /// Seconds to add to each stamp, such as -0.005
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = seconds,
        allow_hyphen_values = true, help_heading = "ROS")]
    time_offset: f64,
    /// Local address to use, and no other: that of one network interface
    #[arg(long, value_name = "IP", value_parser = address, help_heading = "Network")]
    interface: Option<IpAddr>,
    /// Address of the zenoh router
    #[arg(
        long,
        value_name = "LOCATOR",
        default_value = "tcp/localhost:7447",
        help_heading = "Network"
    )]
    router: String,
    /// Way of the scans over zenoh
    #[arg(long, value_enum, value_name = "MODE", default_value_t = Mode::Client,
        help_heading = "Network")]
    mode: Mode,
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10; a
    /// recording: its own pace]
    #[arg(long, value_name = "HZ")]
    rate: Option<Rate>,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    link: LinkArgs,
}

const HELP: &str = "\
Topics:
  /scan         sensor_msgs/msg/LaserScan, stamped with the time of its first ray
  /diagnostics  diagnostic_msgs/msg/DiagnosticArray, once a second

Names: `front=PORT` is the node /front/urg_node with the topic /front/scan in the
frame front_laser. All sensors share one connection to the network, and are polled
in turn.

Examples:
  urg publish /dev/ttyACM0                  then: ros2 topic hz /scan
  urg publish front=/dev/ttyACM0 rear=serial:H0713091 --qos sensor
  urg publish serial:H0713090 --wait --engine zenoh --router tcp/10.0.0.1:7447";

/// The end of one sensor's scans.
struct Ended {
    name: String,
    outcome: Result<(), Failure>,
}

impl Publish {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        tokio::select! {
            outcome = self.publish(interrupt) => outcome,
            // An engine whose network hangs may be slow to close.
            () = interrupt.overdue() => Ok(()),
        }
    }

    async fn publish(self, interrupt: &Interrupt) -> Result<(), Failure> {
        if self.sensors.is_empty() {
            return Err(missing::failure().await);
        }
        let names = NodeNames::resolve(
            &self.sensors,
            &self.namespace,
            &self.node,
            &self.topic,
            &self.frame,
        )?;
        let mut polled = Vec::new();
        for sensor in &self.sensors {
            let (port, rate) =
                PortArg { name: Some(sensor.port.clone()) }.polled_at(self.rate).await?;
            let window = self.window.window(port.default_window())?;
            polled.push((port, rate, window));
        }
        let nodes = names
            .iter()
            .zip(&polled)
            .map(|(names, (port, rate, window))| self.node(names, port, *rate, *window))
            .collect();
        let (engine, outlets) = RunningEngine::start(self.engine, self.settings()?, nodes)?;

        let count = polled.len();
        let epoch = Instant::now();
        let (ends, mut ended) = mpsc::unbounded_channel();
        let mut tasks = JoinSet::new();
        for (place, ((names, (port, rate, window)), outlet)) in
            names.into_iter().zip(polled).zip(outlets).enumerate()
        {
            let name = format!("{port} ({})", names.topic);
            let source = Source {
                port,
                link: self.link.clone(),
                window,
                rate,
                names,
                time_offset: self.time_offset,
                outlet,
                epoch,
                turn: place as f64 / count as f64,
            };
            let ends = ends.clone();
            // It fails if nobody listens any more: the program ends.
            let done = move |outcome| drop(ends.send(Ended { name, outcome }));
            tasks.spawn(source.run(done));
        }
        let outcome = tokio::select! {
            outcome = all_ended(&mut ended, count) => outcome,
            _ = interrupt.requested() => Ok(()),
        };
        tasks.shutdown().await;
        engine.close().await;
        outcome
    }

    fn settings(&self) -> Result<EngineSettings, Failure> {
        let default_depth = match self.qos {
            Qos::Reliable => 20,
            Qos::Sensor => 5,
        };
        let domain = match self.domain {
            Some(domain) => domain,
            None => domain_of_environment()?,
        };
        if let (EngineName::Dds, Some(IpAddr::V6(address))) = (self.engine, self.interface) {
            return Err(Failure::Usage(format!(
                "--interface {address}: expected an IPv4 address, DDS uses no other here"
            )));
        }
        Ok(EngineSettings {
            domain,
            qos: self.qos,
            depth: self.depth.unwrap_or(default_depth).into(),
            interface: self.interface,
            router: self.router.clone(),
            mode: self.mode,
        })
    }

    /// Returns the node of a sensor. Its parameters are those of other laser
    /// scanners' nodes.
    fn node(&self, names: &NodeNames, port: &PortName, rate: Rate, window: Window) -> NodeSpec {
        use ParameterValue::{Float, Integer, Text};
        let rate = rate.period().map_or(0.0, |period| 1.0 / period.as_secs_f64());
        let baud_rate = self.link.baud.map_or(0, |rate| i64::from(rate.bits_per_second()));
        NodeSpec {
            namespace: names.namespace.clone(),
            name: names.node.clone(),
            scan_topic: names.topic.clone(),
            parameters: vec![
                ("serial_port", Text(port.to_string())),
                ("serial_baud", Integer(baud_rate)),
                ("frame_id", Text(names.frame.clone())),
                ("angle_min", Float(f64::from(window.start().degrees()).to_radians())),
                ("angle_max", Float(f64::from(window.end().degrees()).to_radians())),
                ("cluster", Integer(window.cluster_count().into())),
                ("rate", Float(rate)),
                ("time_offset", Float(self.time_offset)),
            ],
        }
    }
}

/// Waits until the scans of all sensors have ended. A failure is reported while the
/// others go on; that of the last one is the program's.
async fn all_ended(
    ended: &mut mpsc::UnboundedReceiver<Ended>,
    count: usize,
) -> Result<(), Failure> {
    let mut failure = Ok(());
    for left in (0..count).rev() {
        let Some(Ended { name, outcome }) = ended.recv().await else { break };
        match outcome {
            Err(error) if left > 0 => {
                notice(format_args!("{name}: {}; the others go on", error.line()));
                failure = Err(error);
            }
            Err(error) => return Err(error),
            Ok(()) => {}
        }
    }
    failure
}

/// Returns the domain that all ROS programs of this environment use.
fn domain_of_environment() -> Result<u16, Failure> {
    let Some(text) = std::env::var_os("ROS_DOMAIN_ID").filter(|text| !text.is_empty()) else {
        return Ok(0);
    };
    let domain = text.to_str().and_then(|text| text.parse().ok());
    domain
        .filter(|domain| *domain <= 232)
        .ok_or_else(|| Failure::Usage(format!("invalid ROS_DOMAIN_ID {text:?}: expected 0 to 232")))
}

fn address(text: &str) -> Result<IpAddr, &'static str> {
    text.parse().map_err(|_| "expected the address of an interface, such as 192.168.1.10")
}

fn seconds(text: &str) -> Result<f64, &'static str> {
    text.parse()
        .ok()
        .filter(|seconds: &f64| seconds.abs() <= 3600.0)
        .ok_or("expected seconds between -3600 and 3600, such as -0.005")
}
