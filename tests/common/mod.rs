//! What the driver's tests share: an emulated sensor that puts the truth into
//! its data, and a check of scans against that truth.

pub(crate) mod fountain;
pub(crate) mod limit;
pub(crate) mod logs;
pub(crate) mod prompt;

use std::collections::HashMap;
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::emulator::{Builder, Emulator, Received, Values, Verdict, WorldTime};
use tokio_scip::{Connect, Error, Port, Scan, Sensor, SensorBuilder};

/// The code that carries digit `place` of a request's number, in base 4000:
/// they repeat every three steps, so that any window of three steps has all.
fn code(request: u64, step: usize) -> u16 {
    let digits = [request % 4000, request / 4000 % 4000, request / 16_000_000];
    20 + digits[step % 3] as u16
}

/// An emulated sensor whose every scan tells which `G` it answers.
pub(crate) fn truthful() -> Builder {
    limit::limit();
    Emulator::builder().log_capacity(1 << 20).world(|look: WorldTime, codes: &mut Values| {
        for (step, slot) in codes.iter_mut().enumerate() {
            *slot = code(look.request, step);
        }
    })
}

/// The number that the scan carries, if all of it carries the same.
pub(crate) fn request_of(scan: &Scan) -> Option<u64> {
    let start = usize::from(scan.window().start().number());
    let mut digits = [0; 3];
    for (step, &value) in (start..).zip(scan.values()).take(3) {
        digits[step % 3] = u64::from(value.checked_sub(20)?);
    }
    let request = digits[0] + digits[1] * 4000 + digits[2] * 16_000_000;
    let whole = (start..).zip(scan.values()).all(|(step, &value)| value == code(request, step));
    whole.then_some(request)
}

/// Whether the sensor answers the line with distances, its laser being on.
fn is_poll(line: &Received) -> bool {
    line.line.starts_with(b"G") && line.verdict == Verdict::WellFormed
}

/// Which scans are the answers to their own requests.
pub(crate) struct Truth {
    arrivals: HashMap<u64, Instant>,
    seen: std::collections::HashSet<u64>,
    last: Option<(u64, Instant, Instant)>,
}

impl Truth {
    /// Reads the sensor's log: when the `G` with each number arrived. `answered`
    /// tells which of the well-formed `G`s got distances (not those refused).
    pub(crate) fn of(log: &[Received]) -> Self {
        let scans = log.iter().filter(|line| is_poll(line));
        let arrivals = (0..).zip(scans.map(|line| line.at)).collect();
        Self { arrivals, seen: Default::default(), last: None }
    }

    /// Holds one scan of a stream against the truth.
    pub(crate) fn check(&mut self, scan: &Scan) -> Result<u64, String> {
        let request = request_of(scan).ok_or_else(|| format!("mixed data: {:?}", scan.values()))?;
        let arrived = self.arrivals.get(&request).ok_or(format!("nobody asked for {request}"))?;
        let (sent, received) = (scan.requested_at(), scan.received_at());
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

/// A builder for repeatable tests.
pub(crate) fn builder() -> SensorBuilder {
    limit::limit();
    Sensor::builder().jitter_seed(7)
}

pub(crate) const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// Opens what a closure makes.
pub(crate) struct Rigged<F>(pub(crate) F);

impl<P, F> Connect for Rigged<F>
where
    P: Port,
    F: FnMut() -> Result<P, Error> + Send + 'static,
{
    type Port = P;

    async fn connect(&mut self) -> Result<P, Error> {
        (self.0)()
    }
}
