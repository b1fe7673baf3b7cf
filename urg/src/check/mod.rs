//! `urg check`: a self-test of a sensor. `steps` defines the steps, `measured` judges the
//! stream of scans, and `finding` is the result of a step.

mod finding;
mod measured;
mod steps;

use std::time::{Duration, Instant};

use self::finding::{Finding, Verdict};
use crate::args::{LinkArgs, duration};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::stdout::print;
use crate::port::name::PortArg;
use crate::port::open::open;
use crate::recording::span::{RangeArgs, TopicArgs};

const DEFAULT_DURATION: Duration = Duration::from_secs(5);

/// Test a sensor, with a verdict for each step
///
/// Finds the sensor, asks for its identity, switches its laser off and on, and streams scans for some seconds. The
/// laser is on afterwards. A step is ok, weak (it works, but not as well as it should) or FAILED. The exit code is 0
/// unless a step has failed. A recording is tested for gaps, a lost link, damage, messages that are left out, changes
/// of the clock, jumps of the sensor's clock, times that do not advance, and scans of several sensors.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  urg check /dev/ttyACM0
  urg check /dev/ttyUSB0 --baud 115200 --duration 60s && echo good")]
pub(crate) struct Check {
    #[command(flatten)]
    port: PortArg,
    /// Duration of the stream of scans: 10s, 500ms, 5m, 1h [default: 5s]
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    duration: Option<Duration>,
    #[command(flatten)]
    topic: TopicArgs,
    #[command(flatten)]
    link: LinkArgs,
}

impl Check {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        tokio::select! {
            outcome = self.check() => outcome,
            // Without a verdict, the sensor must not count as good.
            _ = interrupt.requested() => Err(Failure::Failed("interrupted before the end of the test".to_owned())),
        }
    }

    async fn check(&self) -> Result<(), Failure> {
        let mut port = self.port.required().await?;
        port.choose(RangeArgs::default(), &self.topic)?;
        let mut report = CheckReport(Vec::new());
        if let Some(recorded) = port.recorded() {
            if self.duration.is_some() || self.link.baud.is_some() {
                let text = format!("--duration and --baud are for a sensor: {port} is a recording");
                return Err(Failure::Usage(text));
            }
            for step in steps::recording(recorded.contents().await?, recorded.topic()) {
                report.add(step).await?;
            }
            return report.end(&port.to_string()).await;
        }
        let (begin, duration) = (Instant::now(), self.duration.unwrap_or(DEFAULT_DURATION));
        match open(&port, &self.link, Delivery::Newest).await {
            Ok(sensor) => {
                report.add(steps::link(&port, &sensor, begin.elapsed()).await).await?;
                report.add(steps::version(&sensor).await).await?;
                report.add(steps::laser(&sensor).await).await?;
                for step in steps::scans(&sensor, port.default_window(), duration).await {
                    report.add(step).await?;
                }
            }
            Err(Failure::Failed(line)) => report.add(Finding::failed("link", line)).await?,
            Err(other) => return Err(other),
        }
        report.end(&port.to_string()).await
    }
}

/// Findings, written one by one as the steps finish.
struct CheckReport(Vec<Finding>);

impl CheckReport {
    async fn add(&mut self, step: Finding) -> Result<(), Failure> {
        print(format!("{step}\n")).await?;
        self.0.push(step);
        Ok(())
    }

    async fn end(self, port: &str) -> Result<(), Failure> {
        let of = |verdict| {
            let steps = self.0.iter().filter(|step| step.verdict == verdict);
            steps.map(|step| step.name.replace('_', " ")).collect::<Vec<_>>().join(", ")
        };
        let (failed, weak) = (of(Verdict::Failed), of(Verdict::Weak));
        let line = match (failed.as_str(), weak.as_str()) {
            ("", "") => "all is well".to_owned(),
            ("", weak) => format!("it works; weak: {weak}"),
            (failed, _) => return Err(Failure::Failed(format!("{port} has FAILED: {failed}"))),
        };
        print(format!("\n{line}\n")).await
    }
}
