//! Publishes the scans of one sensor, and its condition once per second. Sensors are independent
//! of each other; they only take turns.

use std::time::{Duration, SystemTime};

use parking_lot::Mutex;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_recording::Event;
use urg_recording::ros;

use super::diagnostics::Condition;
use super::engine::{NodeTopic, Outlet};
use super::names::NodeNames;
use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::port::name::PortName;
use crate::port::open::{begin, opened};
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::StreamEnd;
use crate::stream::reporter::Reporter;

/// Interval of diagnostics, by ROS convention.
const DIAGNOSTICS_PERIOD: Duration = Duration::from_secs(1);

pub(crate) struct Source {
    pub(crate) port: PortName,
    pub(crate) link: LinkArgs,
    pub(crate) window: Window,
    pub(crate) rate: Rate,
    /// Number of scans to leave out after each one, instead of `rate`.
    pub(crate) skip: Option<u32>,
    pub(crate) names: NodeNames,
    /// Seconds to add to each stamp.
    pub(crate) time_offset: f64,
    pub(crate) outlet: Outlet,
    /// When the first sensor is due first.
    pub(crate) epoch: Instant,
    /// Delay of this sensor's polls after the first sensor's, as a fraction of the period, in
    /// 0..1. Spreads the scans of all sensors evenly.
    pub(crate) phase: f64,
    pub(crate) condition: Mutex<Condition>,
}

impl Source {
    pub(crate) async fn publish_scans(&self) -> Result<(), Failure> {
        let outcome = self.publish_stream().await;
        self.condition.lock().ended = Some(match &outcome {
            Ok(()) => "the recording has ended".to_owned(),
            Err(failure) => failure.line().to_owned(),
        });
        outcome
    }

    async fn publish_stream(&self) -> Result<(), Failure> {
        // The motor of an emulated sensor starts when it is opened. Like real motors, several
        // of them must not run in phase.
        tokio::time::sleep_until(self.next_due(Instant::now())).await;
        let sensor = begin(&self.port, &self.link, Delivery::Newest)?;
        self.condition.lock().sensor = Some(sensor.clone());
        opened(&self.port, &self.link, &sensor).await?;
        self.identify(&sensor).await;
        let rate = self.rate();
        tokio::time::sleep_until(self.next_due(Instant::now())).await;
        let mut feed = Feed::open(&self.port, &sensor, self.window, rate).await?;
        let mut reporter =
            Reporter::new(self.port.clone(), sensor.clone()).with_rate(self.window, rate);
        while let Some(update) = feed.next().await {
            reporter.report(&update);
            match update {
                Update::Scan(scan) => {
                    self.outlet.publish(NodeTopic::Scans, self.message(&scan));
                }
                Update::Event(Event::Reconnected) => self.identify(&sensor).await,
                Update::Error(_) | Update::Event(_) => {}
            }
        }
        reporter.finish(StreamEnd::ByItself)
    }

    /// Publishes the condition once per second, also after the scans have ended. Never completes.
    pub(crate) async fn publish_diagnostics(&self) {
        let node = self.names.full_name();
        let first = self.epoch + DIAGNOSTICS_PERIOD.mul_f64(self.phase);
        let mut ticks = tokio::time::interval_at(first, DIAGNOSTICS_PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            ticks.tick().await;
            let rate = self.rate();
            let status = self.condition.lock().status(&node, self.window, rate, &self.outlet);
            let mut message = Vec::new();
            ros::write_diagnostics(&mut message, SystemTime::now(), &[status]);
            self.outlet.publish(NodeTopic::Diagnostics, message);
        }
    }

    /// Reads the identity of the sensor. A timeout is ignored: the next reconnect tries again.
    async fn identify(&self, sensor: &Sensor) {
        if let (Ok(version), Ok(geometry)) = (sensor.version().await, sensor.geometry().await) {
            let mut condition = self.condition.lock();
            (condition.version, condition.geometry) = (Some(version), Some(geometry));
        }
    }

    /// Rate of the polls. With `skip` it depends on the motor of the sensor.
    fn rate(&self) -> Rate {
        match (self.skip, self.condition.lock().geometry) {
            (Some(0), _) => Rate::UNLIMITED,
            (Some(skip), Some(geometry)) => Rate::every(geometry.revolution() * (skip + 1)),
            (Some(_) | None, _) => self.rate,
        }
    }

    fn message(&self, scan: &Scan) -> Vec<u8> {
        let (stamp, offset) = (scan.first_ray_stamp(), self.time_offset);
        let by = Duration::try_from_secs_f64(offset.abs()).unwrap_or_default();
        let moved = if offset < 0.0 { stamp.checked_sub(by) } else { stamp.checked_add(by) };
        let numbers = scan.len() + scan.intensities().unwrap_or_default().len();
        let mut message = Vec::with_capacity(128 + self.names.frame.len() + 4 * numbers);
        ros::write_scan(&mut message, scan, moved.unwrap_or(stamp), &self.names.frame);
        message
    }

    /// Computes when this sensor is due next. A schedule that starts then keeps to the grid.
    fn next_due(&self, now: Instant) -> Instant {
        let Some(period) = self.rate().period().filter(|period| !period.is_zero()) else {
            return now;
        };
        let first = self.epoch + period.mul_f64(self.phase);
        let behind = now.saturating_duration_since(first).as_nanos();
        let periods = behind.div_ceil(period.as_nanos());
        let ahead = u64::try_from(periods * period.as_nanos()).unwrap_or(u64::MAX);
        first + Duration::from_nanos(ahead)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use urg_recording::ros::MessageType;

    use super::*;
    use crate::publish::engine::Shared;
    use crate::publish::send_queue::SendQueue;
    use crate::publish::topic::Topic;

    #[tokio::test(start_paused = true)]
    async fn scans_and_diagnostics_of_several_sensors_are_spread_over_their_periods() {
        const COUNT: u32 = 10;
        let scans_and_diagnostics = [MessageType::LASER_SCAN, MessageType::DIAGNOSTIC_ARRAY];
        let topics: Arc<[Topic]> = (0..COUNT as usize)
            .flat_map(|node| scans_and_diagnostics.map(|kind| Topic::new(node, "/t", kind, 1)))
            .collect();
        let queue = Arc::new(SendQueue::new(&topics));
        // Each message is dropped and counted.
        queue.set_connected(false);
        let shared = Shared::default();
        *shared.write() = Some(queue);
        let epoch = Instant::now();
        for (place, scans) in topics.iter().step_by(2).enumerate() {
            let source = Source {
                port: "emulated".parse().unwrap(),
                link: LinkArgs::default(),
                window: Window::DETECTION,
                rate: Rate::hz(10.0),
                skip: None,
                names: NodeNames::default(),
                time_offset: 0.0,
                outlet: Outlet::new(scans, &shared),
                epoch,
                phase: place as f64 / f64::from(COUNT),
                condition: Mutex::default(),
            };
            tokio::spawn(async move {
                tokio::join!(source.publish_scans(), source.publish_diagnostics())
            });
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
        let mut counted: Vec<_> = topics.iter().map(|it| it.counts.lock().dropped).collect();
        let mut instants = [Vec::new(), Vec::new()];
        while epoch.elapsed() < Duration::from_secs(5) {
            tokio::time::sleep(Duration::from_millis(1)).await;
            for (number, topic) in topics.iter().enumerate() {
                let now = topic.counts.lock().dropped;
                let new = now - std::mem::replace(&mut counted[number], now);
                (0..new).for_each(|_| instants[number % 2].push(epoch.elapsed().as_secs_f64()));
            }
        }
        for (period, instants) in [0.1, 1.0].into_iter().zip(instants) {
            assert!(instants.len() >= (2.5 / period) as usize * COUNT as usize, "{instants:?}");
            for pair in instants.windows(2) {
                let (gap, even) = (pair[1] - pair[0], period / f64::from(COUNT));
                assert!((gap - even).abs() < 0.003, "{gap} s between two of {COUNT} sensors");
            }
        }
    }
}
