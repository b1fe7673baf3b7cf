//! One sensor on its way to the network: its scans, and once a second its
//! condition. It knows nothing of the other sensors but its turn among them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use tokio::time::{Instant, MissedTickBehavior};
use tokio_scip::{Rate, Scan, Sensor, Window, ros};

use super::diagnostics::Condition;
use super::engine::Outlet;
use super::names::NodeNames;
use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::name::PortName;
use crate::port::open::{begin, opened};
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::Ended;
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::Reporter;

/// The pause between two diagnostics, as ROS has it by convention.
const DIAGNOSTICS_PERIOD: Duration = Duration::from_secs(1);

/// A sensor that is published.
pub(crate) struct Source {
    pub(crate) port: PortName,
    pub(crate) link: LinkArgs,
    pub(crate) window: Window,
    pub(crate) rate: Rate,
    pub(crate) names: NodeNames,
    /// Seconds that are added to each stamp.
    pub(crate) time_offset: f64,
    pub(crate) outlet: Outlet,
    /// The instant of the first turn of the first sensor.
    pub(crate) epoch: Instant,
    /// Its place among the sensors, at least 0 and below 1: that part of a period it
    /// is polled later than the first, so that their scans do not meet.
    pub(crate) turn: f64,
}

impl Source {
    /// Publishes scans until there are no more. Diagnostics go on: the future does
    /// not end, the `done` callback gets the outcome.
    pub(crate) async fn run(self, done: impl FnOnce(Result<(), Failure>)) {
        let condition = Mutex::new(Condition::default());
        let source = Arc::new(self);
        let scans = async {
            let outcome = source.publish_scans(&condition).await;
            lock(&condition).ended = Some(match &outcome {
                Ok(()) => "the recording has ended".to_owned(),
                Err(failure) => failure.line().to_owned(),
            });
            done(outcome);
        };
        tokio::join!(scans, source.publish_diagnostics(&condition));
    }

    async fn publish_scans(&self, condition: &Mutex<Condition>) -> Result<(), Failure> {
        let sensor = begin(&self.port, &self.link, Delivery::Newest, Sensor::builder())?;
        lock(condition).sensor = Some(sensor.clone());
        opened(&self.port, &self.link, &sensor).await?;
        self.identify(&sensor, condition).await;
        tokio::time::sleep_until(self.next_turn(Instant::now())).await;
        let scans = sensor.scans(self.window, self.rate).await;
        let scans = scans.map_err(|error| Failure::at(&self.port.to_string(), &error))?;
        let mut feed = Feed::new(&self.port, scans);
        let mut reporter = Reporter::new(self.port.clone(), sensor.clone());
        let mut watch = RateWatch::new(&self.port, self.window, self.rate);
        while let Some(update) = feed.next().await {
            reporter.report(&update);
            match update {
                Update::Scan(scan) => {
                    lock(condition).scanned = Some(std::time::Instant::now());
                    self.outlet.publish_scan(self.message(&scan));
                    if let Some(text) = watch.scanned(&scan, &sensor) {
                        notice(format_args!("{}: {text}", self.port));
                    }
                }
                Update::Reconnected => {
                    watch.restart();
                    self.identify(&sensor, condition).await;
                }
                Update::Error(_) | Update::Missed(_) => {}
            }
        }
        reporter.finish(Ended::ByItself)
    }

    /// Publishes the condition once a second, for ever.
    async fn publish_diagnostics(&self, condition: &Mutex<Condition>) {
        let node = format!("{}/{}", self.names.namespace.trim_end_matches('/'), self.names.node);
        let first = self.epoch + DIAGNOSTICS_PERIOD.mul_f64(self.turn);
        let mut ticks = tokio::time::interval_at(first, DIAGNOSTICS_PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            ticks.tick().await;
            let status = lock(condition).status(&node, self.window, self.rate, &self.outlet);
            let mut message = Vec::new();
            ros::write_diagnostics(&mut message, SystemTime::now(), &[status]);
            self.outlet.publish_diagnostics(message);
        }
    }

    /// Remembers which sensor it is. One that does not answer is asked again after
    /// the next reconnect.
    async fn identify(&self, sensor: &Sensor, condition: &Mutex<Condition>) {
        if let Ok(version) = sensor.version().await {
            lock(condition).version = Some(version);
        }
    }

    fn message(&self, scan: &Scan) -> Vec<u8> {
        let stamp = shifted(scan.first_ray_stamp(), self.time_offset);
        let mut message = Vec::with_capacity(128 + self.names.frame.len() + 4 * scan.len());
        ros::write_scan(&mut message, scan, stamp, &self.names.frame);
        message
    }

    /// Returns the next instant of this sensor's turn. Each schedule keeps to the
    /// grid that it starts on.
    fn next_turn(&self, now: Instant) -> Instant {
        let Some(period) = self.rate.period().filter(|period| !period.is_zero()) else {
            return now;
        };
        let first = self.epoch + period.mul_f64(self.turn);
        let behind = now.saturating_duration_since(first).as_nanos();
        let periods = behind.div_ceil(period.as_nanos());
        let ahead = u64::try_from(periods * period.as_nanos()).unwrap_or(u64::MAX);
        first + Duration::from_nanos(ahead)
    }
}

/// Returns `stamp`, `offset` seconds later.
fn shifted(stamp: SystemTime, offset: f64) -> SystemTime {
    let by = Duration::try_from_secs_f64(offset.abs()).unwrap_or_default();
    let shifted = if offset < 0.0 { stamp.checked_sub(by) } else { stamp.checked_add(by) };
    shifted.unwrap_or(stamp)
}

fn lock(condition: &Mutex<Condition>) -> MutexGuard<'_, Condition> {
    // Nothing panics while it is held.
    condition.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_can_be_moved_both_ways() {
        let stamp = SystemTime::UNIX_EPOCH + Duration::from_secs(10);
        let after = |offset| shifted(stamp, offset).duration_since(SystemTime::UNIX_EPOCH).unwrap();
        assert_eq!(after(1.5), Duration::from_millis(11_500));
        assert_eq!(after(-1.5), Duration::from_millis(8_500));
        assert_eq!(after(f64::MAX), Duration::from_secs(10));
    }
}
