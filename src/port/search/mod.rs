//! Searches for a sensor by its serial number: chooses the next port to open. The driver
//! checks which sensor it has.

mod system_ports;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;

use std::future::Future;
use std::mem::replace;
use std::time::Duration;
use std::vec;

use tokio::time::{Instant, sleep, sleep_until, timeout};

pub(super) use self::system_ports::SystemPorts;
use crate::{Error, ErrorKind};

/// Delay before the busy ports are retried.
///
/// A service that opens several sensors at once tries each on the others' ports. Such a busy port
/// is free again as soon as the other driver has found that it has the wrong sensor.
const BUSY_RETRY_DELAY: Duration = Duration::from_millis(500);

/// Number of times to retry the busy ports: each time, another search may hold the wanted one.
/// Enough for five sensors. The search for a missing sensor takes 2 s if other ports stay busy.
const BUSY_RETRIES: u32 = 4;

/// Time between two listings of the ports, to find those that have appeared.
const LISTING_INTERVAL: Duration = Duration::from_millis(250);

/// Time after which a port that is still being opened is skipped. Opening takes milliseconds
/// unless a device hangs. The others must get their turn within the open timeout, by default
/// 5 s.
const OPEN_LIMIT: Duration = Duration::from_secs(2);

/// Source of ports. Tests have one without hardware.
pub(super) trait Ports: Send + 'static {
    type Port;

    /// Lists the ports that the sensor can be on.
    fn candidates(&mut self) -> impl Future<Output = Result<Vec<String>, Error>> + Send;

    fn open(&mut self, path: &str) -> impl Future<Output = Result<Self::Port, Error>> + Send;
}

/// Search through the candidates, which opens one port per call.
#[derive(Debug)]
pub(super) struct Search<P> {
    serial_number: String,
    ports: P,
    /// Ports of the latest listing.
    listed: Vec<String>,
    pass: Option<Pass>,
}

#[derive(Debug)]
struct Pass {
    untried: vec::IntoIter<String>,
    /// Ports to open again as soon as they are listed again: the system may not have finished with
    /// a port that has just appeared.
    failed: Vec<String>,
    busy: Vec<String>,
    /// When to retry the busy ports. Kept here, so that a caller that drops its futures early
    /// does not restart the delay with each call.
    busy_until: Option<Instant>,
    /// Number of times that the busy ports were retried.
    retries: u32,
    /// Error of a port that the user may not open. The sensor may be on it, so this is
    /// reported instead of "no such sensor".
    denied: Option<Error>,
}

impl<P: Ports> Search<P> {
    pub(super) fn new(serial_number: String, ports: P) -> Self {
        Self { serial_number, ports, listed: Vec::new(), pass: None }
    }

    pub(super) fn serial_number(&self) -> &str {
        &self.serial_number
    }

    /// Returns true until a call has found no candidate left.
    pub(super) fn has_more(&self) -> bool {
        self.pass.is_some()
    }

    /// Ends the pass: the next call lists the candidates again.
    pub(super) fn start_over(&mut self) {
        self.pass = None;
    }

    /// Returns when a port has appeared since the latest listing.
    pub(super) async fn port_appears(&mut self) {
        loop {
            sleep(LISTING_INTERVAL).await;
            // `next_port` reports what prevents listing.
            let Ok(listed) = self.ports.candidates().await else { continue };
            let before = replace(&mut self.listed, listed);
            if new_ports(&before, &self.listed).next().is_some() {
                return;
            }
        }
    }

    /// Opens the next port that can be opened. Skips a port that hangs for `OPEN_LIMIT`, and
    /// one that was being opened when the future was dropped.
    pub(super) async fn next_port(&mut self) -> Result<P::Port, Error> {
        let pass = match &mut self.pass {
            Some(pass) => pass,
            None => {
                self.listed = self.ports.candidates().await?;
                self.pass.insert(Pass {
                    untried: self.listed.clone().into_iter(),
                    failed: Vec::new(),
                    busy: Vec::new(),
                    busy_until: None,
                    retries: 0,
                    denied: None,
                })
            }
        };
        loop {
            while let Some(path) = pass.untried.next() {
                match timeout(OPEN_LIMIT, self.ports.open(&path)).await {
                    Ok(Ok(port)) => {
                        tracing::trace!(path, "checking whether the sensor is on this port");
                        return Ok(port);
                    }
                    Ok(Err(error)) => {
                        tracing::trace!(path, error = %error.chain(), "port skipped");
                        pass.record_failure(path, error);
                    }
                    Err(_) => tracing::trace!(path, "port skipped, opening it takes too long"),
                }
            }
            if pass.busy.is_empty() {
                break;
            }
            let until = *pass.busy_until.get_or_insert_with(|| Instant::now() + BUSY_RETRY_DELAY);
            sleep_until(until.min(Instant::now() + LISTING_INTERVAL)).await;
            let listed = self.ports.candidates().await?;
            self.listed.retain(|path| !pass.failed.contains(path));
            pass.failed.clear();
            let mut untried: Vec<_> = new_ports(&self.listed, &listed).cloned().collect();
            self.listed = listed;
            if Instant::now() >= until {
                pass.busy_until = None;
                pass.retries += 1;
                untried.append(&mut pass.busy);
            }
            pass.untried = untried.into_iter();
        }
        let denied = self.pass.take().and_then(|pass| pass.denied);
        let missing = || ErrorKind::NoSuchSensor { serial_number: self.serial_number.clone() };
        Err(denied.unwrap_or_else(|| missing().into()))
    }
}

fn new_ports<'a>(before: &'a [String], now: &'a [String]) -> impl Iterator<Item = &'a String> {
    now.iter().filter(|path| !before.contains(path))
}

impl Pass {
    fn record_failure(&mut self, path: String, error: Error) {
        match error.kind() {
            ErrorKind::Busy { .. } if self.retries < BUSY_RETRIES => self.busy.push(path),
            ErrorKind::Busy { .. } => {}
            ErrorKind::PermissionDenied { .. } => self.denied = Some(error),
            _ => self.failed.push(path),
        }
    }
}
