//! Helpers of all tests of the driver: an emulated sensor that writes the number of
//! each request into its data, and a check that each scan carries its own request's.

pub(crate) mod endless_port;
pub(crate) mod faulty_link;
pub(crate) mod hooked;
pub(crate) mod instant_sensor;
pub(crate) mod limit;
pub(crate) mod logs;
pub(crate) mod random;
pub(crate) mod ready_port;
pub(crate) mod test_port;

use std::collections::HashMap;
use std::future::poll_fn;
use std::io;
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::port::{Connect, Port};
use tokio_scip::state::Freshness;
use tokio_scip::{BaudRate, Error, Scan, Sensor, SensorBuilder, Window};
use urg_emulator::{Emulator, EmulatorBuilder, Received, Values, Verdict, WorldTime};

/// Returns why the last scan of a sensor is too old.
pub(crate) fn reason(freshness: &Freshness) -> Error {
    freshness.check(Duration::ZERO).unwrap_err().source.unwrap()
}

/// Sets the baud rate of a port.
pub(crate) async fn set_baud_rate(port: &mut impl Port, baud_rate: BaudRate) -> io::Result<()> {
    poll_fn(|cx| port.poll_set_baud_rate(cx, baud_rate)).await
}

/// Returns the length of the reply to a `G` for this window, terminator included.
pub(crate) fn reply_len(window: Window) -> usize {
    let data = 2 * window.points();
    "G04472501\n0\n".len() + data + data.div_ceil(64) + 1
}

/// Returns the time that bytes take at a baud rate: ten bits each.
pub(crate) fn wire_time(baud_rate: BaudRate, bytes: usize) -> Duration {
    Duration::from_secs(10 * bytes as u64) / u32::from(baud_rate)
}

/// Returns the value at `step`: one of three digits, base 4000, of the request's number. The
/// digits repeat every three steps, so any window of three steps holds the whole number.
fn code(request: u64, step: usize) -> u32 {
    let digits = [request % 4000, request / 4000 % 4000, request / 16_000_000];
    20 + digits[step % 3] as u32
}

/// Returns an emulated sensor whose scans each carry the number of the `G` they answer.
pub(crate) fn truthful() -> EmulatorBuilder {
    limit::limit();
    Emulator::builder().log_capacity(1 << 20).world(|time: WorldTime, codes: &mut Values| {
        for (step, slot) in codes.iter_mut().enumerate() {
            *slot = code(time.request, step);
        }
    })
}

/// Returns the request's number, or `None` if the values do not all agree on one.
pub(crate) fn request_of(scan: &Scan) -> Option<u64> {
    let start = usize::from(scan.window().start());
    let mut digits = [0; 3];
    for (step, value) in (start..).zip(scan.raw_values()).take(3) {
        digits[step % 3] = u64::from(value.checked_sub(20)?);
    }
    let request = digits[0] + digits[1] * 4000 + digits[2] * 16_000_000;
    let whole = (start..).zip(scan.raw_values()).all(|(step, value)| value == code(request, step));
    whole.then_some(request)
}

/// Returns whether the sensor answers this command with distances (if its laser is on).
fn is_poll(line: &Received) -> bool {
    line.line.starts_with(b"G") && line.verdict == Verdict::WellFormed
}

/// Compares scans with the sensor's log: each must answer its own request.
pub(crate) struct Truth {
    arrivals: HashMap<u64, Instant>,
    seen: std::collections::HashSet<u64>,
    last: Option<(u64, Instant, Instant)>,
}

impl Truth {
    /// Reads from the sensor's log when each `G` arrived. Assumes that none was refused,
    /// because only answered ones have a number.
    pub(crate) fn from_log(log: &[Received]) -> Self {
        let scans = log.iter().filter(|line| is_poll(line));
        let arrivals = (0..).zip(scans.map(|line| line.at)).collect();
        Self { arrivals, seen: Default::default(), last: None }
    }

    /// Checks one scan of a stream, and returns the number of its request.
    pub(crate) fn check(&mut self, scan: &Scan) -> Result<u64, String> {
        let request = request_of(scan).ok_or_else(|| format!("mixed data: {scan:?}"))?;
        let arrived =
            self.arrivals.get(&request).ok_or(format!("{request} was never requested"))?;
        let (sent, received) = (scan.times().requested_at, scan.received_at());
        if !(sent <= *arrived && *arrived <= received) {
            return Err(format!("the answer to {request} is attached to another request"));
        }
        if !self.seen.insert(request) {
            return Err(format!("the answer to {request} came twice"));
        }
        if let Some((sequence, last_sent, last_received)) = self.last
            && !(sequence < scan.sequence() && last_sent <= sent && last_received <= received)
        {
            return Err(format!("scan {} is out of order", scan.sequence()));
        }
        self.last = Some((scan.sequence(), sent, received));
        Ok(request)
    }
}

/// Returns a builder. The driver's random choices are the same in each run, so that tests are
/// repeatable.
pub(crate) fn builder() -> SensorBuilder {
    limit::limit();
    fastrand::seed(7);
    Sensor::builder()
}

/// Opens a serial port of this machine, as the driver does.
#[cfg(all(unix, feature = "serial"))]
pub(crate) async fn open_serial(path: &str) -> Result<Box<dyn Port>, Error> {
    tokio_scip::Endpoint::Serial(path.to_owned()).into_connector().connect().await
}

pub(crate) const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// A [`Connect`] from a closure that returns a port.
pub(crate) struct ConnectFn<F>(pub(crate) F);

impl<P, F> Connect for ConnectFn<F>
where
    P: Port,
    F: FnMut() -> Result<P, Error> + Send + 'static,
{
    type Port = P;

    async fn connect(&mut self) -> Result<P, Error> {
        (self.0)()
    }
}
