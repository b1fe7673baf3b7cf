//! Searches for a serial number: chooses the next port to open. The driver checks which sensor it has.

mod system_ports;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;

use std::future::Future;
use std::mem::replace;
use std::pin::Pin;
use std::time::Duration;

use tokio::time::{Instant, sleep, timeout};

pub(super) use self::system_ports::SystemPorts;
use super::ConnectHints;
use crate::{Error, ErrorChain, ErrorKind};

/// Time for which busy ports are retried. A service that opens several sensors at once tries each on
/// the others' ports. Such a port is free again as soon as the other driver has found the wrong sensor.
const BUSY_LIMIT: Duration = Duration::from_secs(2);

/// Time between two listings of the ports, to find new ones, and to retry those that were busy.
const LISTING_INTERVAL: Duration = Duration::from_millis(250);

/// Time after which a port that is still being opened is skipped. Opening takes milliseconds unless
/// a device hangs. The others must get their turn within the open timeout, by default 5 s.
const OPEN_LIMIT: Duration = Duration::from_secs(2);

/// Source of ports. Tests have one without hardware.
pub(super) trait Ports: Send + 'static {
    type Port;

    /// Lists the ports that the sensor can be on. Leaves out a port while a call hangs in the system:
    /// to open it, whose future was dropped, or to close it.
    fn candidates(&mut self) -> impl Future<Output = Result<Vec<String>, Error>> + Send;

    /// Opens a port of the latest list.
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

#[derive(Debug, Default)]
struct Pass {
    /// Ports that were opened. Others may open at the next try: the system may not have finished with a
    /// port that has just appeared.
    tried: Vec<String>,
    /// True if opening a port took too long.
    is_hung: bool,
    /// When to give up on busy ports. Kept here, for callers that drop their futures early.
    busy_until: Option<Instant>,
}

impl<P: Ports> Search<P> {
    pub(super) fn new(serial_number: String, ports: P) -> Self {
        Self { serial_number, ports, listed: Vec::new(), pass: None }
    }

    /// Returns when a port has appeared since the latest listing.
    async fn wait_for_port(&mut self) {
        loop {
            sleep(LISTING_INTERVAL).await;
            // `next_port` reports what prevents listing.
            let Ok(listed) = self.ports.candidates().await else { continue };
            let before = replace(&mut self.listed, listed);
            if self.listed.iter().any(|path| !before.contains(path)) {
                return;
            }
        }
    }

    /// Opens the next port that can be opened. Skips a port that hangs for `OPEN_LIMIT`.
    pub(super) async fn next_port(&mut self) -> Result<P::Port, Error> {
        loop {
            self.listed = self.ports.candidates().await?;
            let pass = self.pass.get_or_insert_default();
            // A port that was plugged in again, or hung, may now have the sensor.
            pass.tried.retain(|path| self.listed.contains(path));
            let (mut is_busy, mut denied) = (pass.is_hung, None);
            for path in &self.listed {
                if pass.tried.contains(path) {
                    continue;
                }
                match timeout(OPEN_LIMIT, self.ports.open(path)).await {
                    Ok(Ok(port)) => {
                        tracing::trace!(path, "checking whether the sensor is on this port");
                        pass.tried.push(path.clone());
                        pass.busy_until = None;
                        return Ok(port);
                    }
                    Ok(Err(error)) => {
                        tracing::trace!(path, error = %ErrorChain(&error), "port skipped");
                        is_busy |= matches!(error.kind(), ErrorKind::Busy { .. });
                        if matches!(error.kind(), ErrorKind::PermissionDenied { .. }) {
                            // The sensor may be on it.
                            denied = Some(error);
                        }
                    }
                    Err(_) => {
                        tracing::trace!(path, "port skipped, opening it takes too long");
                        // Its device may return.
                        (pass.is_hung, is_busy) = (true, true);
                    }
                }
            }
            let until = *pass.busy_until.get_or_insert_with(|| Instant::now() + BUSY_LIMIT);
            if !is_busy || Instant::now() >= until {
                self.pass = None;
                let (serial_number, found) = (self.serial_number.clone(), Vec::new());
                let none = ErrorKind::NoSuchSensor { serial_number, found };
                return Err(denied.unwrap_or(none.into()));
            }
            sleep(LISTING_INTERVAL).await;
        }
    }
}

impl<P: Ports> ConnectHints for Search<P> {
    /// Returns true until a call has found no candidate left.
    fn has_more(&mut self) -> bool {
        self.pass.is_some()
    }

    /// Ends the pass: the next call lists the candidates again.
    fn found(&mut self) {
        self.pass = None;
    }

    fn port_appears(&mut self) -> Option<Pin<Box<dyn Future<Output = ()> + Send + '_>>> {
        Some(Box::pin(self.wait_for_port()))
    }

    fn expected_serial_number(&mut self) -> Option<&str> {
        Some(&self.serial_number)
    }
}
