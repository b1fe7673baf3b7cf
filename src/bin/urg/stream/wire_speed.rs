//! Evidence against a baud rate: a reply that arrived in less time than its
//! bytes take at it. Pseudo-terminals and some adapters ignore the baud rate that
//! they are set to, and a sensor is then found at the first one that is tried.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{BaudRate, RawReply, Scan};

/// The part of the wire time that a reply needs at least: a clock may be off by some
/// percent, and then a reply seems faster.
const TOLERANCE: f64 = 0.9;

/// Returns the explanation of a baud rate that was disproved.
pub(crate) fn explanation(baud_rate: BaudRate) -> String {
    format!(
        "replies come faster than {baud_rate} baud can carry: this port ignores the baud rate, \
         as pseudo-terminals and USB do"
    )
}

/// Returns whether `scan` came faster than a line at `baud_rate` carries it.
pub(crate) fn outruns(scan: &Scan, baud_rate: BaudRate) -> bool {
    let elapsed = scan.received_at().saturating_duration_since(scan.requested_at());
    is_too_fast(elapsed, scan.window().wire_time(baud_rate))
}

fn is_too_fast(elapsed: Duration, wire_time: Duration) -> bool {
    elapsed < wire_time.mul_f64(TOLERANCE)
}

/// The fastest reply since the link was opened, for commands that take no scan.
#[derive(Debug, Clone, Default)]
pub(crate) struct FastestReply(Arc<Mutex<Times>>);

#[derive(Debug, Default)]
struct Times {
    /// The time when the previous reply was read: the command was sent after it.
    previous: Option<Instant>,
    /// The most bytes in the least time, as seconds a byte.
    seconds_per_byte: Option<f64>,
}

impl FastestReply {
    /// Returns an observer for `SensorBuilder::on_reply`.
    pub(crate) fn observer(&self) -> impl Fn(RawReply<'_>) + Send + Sync + 'static {
        let times = Arc::clone(&self.0);
        move |reply| {
            // Nothing panics while it is held.
            let mut times = times.lock().unwrap_or_else(PoisonError::into_inner);
            let previous = times.previous.replace(reply.received_at);
            // Frames that answer no command may have waited in the system's buffer.
            if let (Some(previous), Some(_)) = (previous, reply.command) {
                let elapsed = reply.received_at.saturating_duration_since(previous);
                let each = elapsed.as_secs_f64() / (reply.bytes.len() + 2) as f64;
                times.seconds_per_byte =
                    Some(times.seconds_per_byte.map_or(each, |fastest| fastest.min(each)));
            }
        }
    }

    /// Returns whether a reply came faster than a line at `baud_rate` carries it.
    pub(crate) fn outruns(&self, baud_rate: BaudRate) -> bool {
        let times = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // A byte takes ten bits: a start bit, eight of data, a stop bit.
        let byte = 10.0 / f64::from(baud_rate.bits_per_second());
        times.seconds_per_byte.is_some_and(|seconds| seconds < TOLERANCE * byte)
    }
}

#[cfg(test)]
mod tests {
    use tokio_scip::emulator::{Emulator, Pace};
    use tokio_scip::{Sensor, Window};

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_real_line_is_never_outrun_and_its_rate_is_the_fastest_that_is_not() {
        for baud_rate in BaudRate::ALL {
            let fastest = FastestReply::default();
            let emulator = Emulator::builder().baud_rate(baud_rate).pace(Pace::AtOnce).build();
            let builder = Sensor::builder().on_reply(fastest.observer());
            let sensor = builder.connect(emulator).await.unwrap();
            let scan = sensor.scan(Window::DETECTION).await.unwrap();
            assert!(!outruns(&scan, baud_rate) && !fastest.outruns(baud_rate), "{baud_rate}");
            for slower in BaudRate::ALL.into_iter().filter(|rate| *rate < baud_rate) {
                assert!(outruns(&scan, slower), "{baud_rate} against {slower}");
            }
            if baud_rate >= BaudRate::B115200 {
                assert!(fastest.outruns(BaudRate::B19200), "{baud_rate}");
            }
        }
    }
}
