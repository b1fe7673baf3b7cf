//! Whether the rate that was asked for is reached; if not, that is told once,
//! with what would help.

use std::fmt::Write;
use std::time::{Duration, Instant};

use tokio_scip::{BaudRate, Endpoint, Rate, Sensor, Window};

use crate::port::name::PortName;

/// Below this part of the rate asked for, it counts as not reached.
pub(crate) const ENOUGH: f64 = 0.95;

/// Longer than the driver's average remembers.
const MEMORY: Duration = Duration::from_secs(5);

/// Watches one stream's rate.
#[derive(Debug)]
pub(crate) struct RateWatch {
    window: Window,
    rate: Rate,
    /// Whether the port's own speed can be changed from here.
    settable: bool,
    /// Whether it was said, or never will be: a recording is as fast as it is.
    said: bool,
    /// Before that no rate is of the sensor and the line alone.
    steady_from: Instant,
}

impl RateWatch {
    pub(crate) fn new(port: &PortName, window: Window, rate: Rate) -> Self {
        let settable = !matches!(port, PortName::Endpoint(Endpoint::Tcp { .. }));
        let said = port.recorded().is_some();
        Self { window, rate, settable, said, steady_from: Instant::now() }
    }

    /// Takes notice that scans rest for a reason that is known: the link is lost,
    /// or the laser is off.
    pub(crate) fn interrupted(&mut self) {
        self.steady_from = Instant::now() + MEMORY;
    }

    /// Compares what is reached with what was asked for; gives, once, what to
    /// tell the user.
    pub(crate) fn look(&mut self, sensor: &Sensor) -> Option<String> {
        let period = self.rate.period().filter(|_| !self.said)?;
        if Instant::now() < self.steady_from {
            return None;
        }
        let asked = 1.0 / period.as_secs_f64();
        let stats = sensor.stats();
        let reached = stats
            .schedules
            .iter()
            .find(|schedule| schedule.window == self.window)
            .map_or(0.0, |schedule| schedule.reached);
        // Zero until there is something to average.
        (reached > 0.0 && reached < ENOUGH * asked).then(|| {
            self.said = true;
            let speed = sensor.state().borrow().baud_rate();
            self.text(asked, reached, speed)
        })
    }

    fn text(&self, asked: f64, reached: f64, speed: Option<BaudRate>) -> String {
        let mut text = format!("{reached:.1} scans a second, where {} was asked for", self.rate);
        let fits = |rate: f64, window: Window, speed: BaudRate| {
            rate * window.wire_time(speed).as_secs_f64() < ENOUGH
        };
        // What is reached already did fit: then something else is too slow.
        let line_is_slow = |speed| {
            !fits(asked, self.window, speed)
                && reached * self.window.wire_time(speed).as_secs_f64() <= 1.0
        };
        match speed {
            Some(speed) if line_is_slow(speed) => {
                let _ = write!(text, ": a scan of {} takes ", self.window);
                let millis = self.window.wire_time(speed).as_millis();
                let _ = write!(text, "{millis} ms at {speed} baud. What helps: fewer steps");
                let cluster = (2..=99).find_map(|count| {
                    let window = self.window.with_cluster_count(count).ok()?;
                    (count > self.window.cluster_count() && fits(asked, window, speed))
                        .then_some(count)
                });
                if let Some(cluster) = cluster {
                    let _ = write!(text, ", --cluster {cluster}");
                }
                let faster =
                    BaudRate::ALL.into_iter().find(|faster| fits(asked, self.window, *faster));
                match faster {
                    Some(faster) if self.settable => {
                        let _ = write!(text, ", --baud {faster}");
                    }
                    Some(faster) => {
                        let _ = write!(text, ", {faster} baud at sensor and bridge");
                    }
                    None => {}
                }
            }
            _ => text.push_str(": that is as fast as the sensor answers, once a turn of its motor"),
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(rate: Rate) -> RateWatch {
        RateWatch::new(&PortName::Emulated, Window::DETECTION, rate)
    }

    #[test]
    fn a_slow_line_is_told_with_the_options_that_would_do() {
        let text = watch(Rate::hz(10.0)).text(10.0, 1.2, Some(BaudRate::B19200));
        assert_eq!(
            text,
            "1.2 scans a second, where 10 Hz was asked for: a scan of steps 44..=725 takes 733 ms \
             at 19200 baud. What helps: fewer steps, --cluster 9, --baud 250000"
        );
        let bridge = RateWatch { settable: false, ..watch(Rate::hz(10.0)) };
        let text = bridge.text(10.0, 1.2, Some(BaudRate::B19200));
        assert!(text.ends_with("250000 baud at sensor and bridge"), "{text}");
        // Nothing that SCIP 1.1 knows carries so much.
        let text = watch(Rate::hz(1000.0)).text(1000.0, 1.2, Some(BaudRate::B19200));
        assert!(text.ends_with("What helps: fewer steps"), "{text}");
    }

    #[test]
    fn a_sensor_that_is_slower_than_its_line_is_told_as_such() {
        for speed in [None, Some(BaudRate::B750000), Some(BaudRate::B19200)] {
            let text = watch(Rate::hz(20.0)).text(20.0, 10.0, speed);
            assert!(text.ends_with("once a turn of its motor"), "{speed:?}: {text}");
        }
    }
}
