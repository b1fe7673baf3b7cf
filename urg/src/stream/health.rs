//! [`SensorHealth`]: whether scans arrive, and why not.

use std::fmt::Write;
use std::time::Duration;

use tokio_scip::protocol::Protocol;
use tokio_scip::{ErrorChain, Freshness, Rate, Sensor, State, Window};

use crate::failure::chain;
use crate::port::open::line_baud_rate;

/// Tolerance for a late scan, in addition to three periods.
const SCAN_GRACE: Duration = Duration::from_secs(2);

/// State of the link in one word, and the reason if no scans arrive.
#[derive(Debug)]
pub(crate) struct SensorHealth {
    pub(crate) link: &'static str,
    /// `None` while scans arrive.
    pub(crate) why: Option<String>,
}

impl SensorHealth {
    /// Judges a sensor whose `window` is polled at `rate`. `None`: it is not opened yet.
    pub(crate) fn from_sensor(sensor: Option<&Sensor>, window: Window, rate: Rate) -> Self {
        let Some(sensor) = sensor else {
            return Self { link: "waiting", why: Some("looking for the sensor".to_owned()) };
        };
        let state = sensor.watch_state().get();
        let link = match &state {
            State::Connected { .. } => "connected",
            State::Connecting { .. } => "waiting",
            State::Recovering => "recovering",
            State::Disconnected { .. } => "disconnected",
            State::Closed { .. } => "closed",
            _ => "unknown",
        };
        let why = trouble(&state).or_else(|| {
            let protocol = sensor.parameters().map_or(Protocol::Scip1, |_| Protocol::Scip2);
            let wire_time = line_baud_rate(sensor).map(|rate| window.wire_time(rate, protocol));
            let period = rate.period().unwrap_or_default().max(wire_time.unwrap_or_default());
            overdue(&sensor.freshness(), 3 * period + SCAN_GRACE)
        });
        Self { link, why }
    }
}

/// Explains why no scans arrive over a working link. Returns `None` while they do.
fn overdue(freshness: &Freshness, limit: Duration) -> Option<String> {
    let stale = freshness.check(limit).err()?;
    let mut why = match stale.age {
        Some(age) => format!("no scan for {:.1} s", age.as_secs_f64()),
        None => "no scan yet".to_owned(),
    };
    if let Some(error) = &stale.source {
        // Writing to a `String` is infallible.
        let _ = write!(why, ": {}", ErrorChain(&error));
    }
    Some(why)
}

/// Explains why no scan can arrive in this state; `None` while the sensor is connected.
/// Notices, the radar and the page share this text.
pub(crate) fn trouble(state: &State) -> Option<String> {
    Some(match state {
        State::Connected { .. } => return None,
        State::Connecting { error: Some(error) } => {
            format!("waiting for a sensor: {}", chain(error))
        }
        State::Connecting { error: None } => "looking for the sensor".to_owned(),
        State::Recovering => "the sensor is silent: looking for it at every baud rate".to_owned(),
        State::Disconnected { error, .. } | State::Closed { error: Some(error) } => chain(error),
        State::Closed { error: None } => "the driver is closed".to_owned(),
        _ => "the driver is in a state that this program does not know".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use tokio_scip::BaudRate;
    use urg_emulator::{Emulator, Firmware, Mode};

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_scan_is_overdue_after_three_periods_and_two_seconds() {
        let slow = || Emulator::builder().baud_rate(BaudRate::B19200);
        let in_scip2 = slow().firmware(Firmware::V31).mode(Mode::Scip2);
        for (builder, rate, limit) in [
            (Emulator::builder().usb(), Rate::UNLIMITED, 2000),
            (slow(), Rate::hz(0.5), 8000),
            // A scan takes 733 ms on the line, and 1,127 ms in SCIP 2.
            (slow(), Rate::hz(10.0), 4200),
            (in_scip2, Rate::UNLIMITED, 5382),
        ] {
            let sensor = Sensor::builder().connect(builder.build()).await.unwrap();
            let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
            stream.next().await.unwrap().unwrap();
            sensor.laser_off().await.unwrap();
            for (age, is_good) in [(limit - 5, true), (limit + 5, false)] {
                let left = Duration::from_millis(age) - sensor.freshness().age().unwrap();
                tokio::time::sleep(left).await;
                let why = SensorHealth::from_sensor(Some(&sensor), Window::DETECTION, rate).why;
                assert_eq!(why.is_none(), is_good, "{limit} {why:?}");
            }
        }
    }
}
