//! Looking for a sensor by its serial number: which port is tried next. What a
//! port leads to is the driver's to find out.

use std::collections::VecDeque;
use std::future::Future;
use std::time::Duration;

use tokio::task::spawn_blocking;
use tokio::time::sleep;

use super::list;
use super::serial::{Opener, SerialPort, open_error};
use crate::Error;

/// How long a busy port is left alone before it is tried once more.
///
/// A service that opens two sensors at once looks for each on the other's port:
/// what is busy then is free again as soon as the other handle has seen that it
/// is not its own.
const BUSY_WAIT: Duration = Duration::from_millis(500);

/// Where ports come from; tests have ones without hardware.
pub(super) trait Ports: Send + 'static {
    type Port;

    /// The ports on which the sensor can be.
    fn candidates(&mut self) -> impl Future<Output = Result<Vec<String>, Error>> + Send;

    fn open(&mut self, path: &str) -> impl Future<Output = Result<Self::Port, Error>> + Send;
}

/// This machine's ports.
#[derive(Debug, Default)]
pub(super) struct SystemPorts {
    opener: Opener,
}

impl Ports for SystemPorts {
    type Port = SerialPort;

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        match spawn_blocking(list::likely_sensors).await {
            Ok(ports) => ports,
            Err(panicked_or_cancelled) => {
                Err(open_error("the list of serial ports", panicked_or_cancelled.into()))
            }
        }
    }

    async fn open(&mut self, path: &str) -> Result<SerialPort, Error> {
        self.opener.open(path).await
    }
}

/// Passes over the candidates, one port a call.
#[derive(Debug)]
pub(super) struct Search<P> {
    serial_number: String,
    ports: P,
    pass: Option<Pass>,
}

#[derive(Debug)]
struct Pass {
    untried: VecDeque<String>,
    busy: Vec<String>,
    /// The busy ones are being tried for the second time.
    is_second_round: bool,
    /// The sensor may be behind a port that may not be opened. That is worth
    /// more to the user than that it was not found.
    denied: Option<Error>,
}

impl<P: Ports> Search<P> {
    pub(super) fn new(serial_number: String, ports: P) -> Self {
        Self { serial_number, ports, pass: None }
    }

    pub(super) fn serial_number(&self) -> &str {
        &self.serial_number
    }

    /// Whether a pass has not ended yet.
    pub(super) fn has_more(&self) -> bool {
        self.pass.is_some()
    }

    /// Ends the pass: the next port is looked for from the beginning.
    pub(super) fn start_over(&mut self) {
        self.pass = None;
    }

    /// The next port that opens. A call whose future is dropped while a port
    /// is being opened passes over it, so that one that hangs cannot keep the
    /// others from being tried.
    pub(super) async fn next_port(&mut self) -> Result<P::Port, Error> {
        let pass = match &mut self.pass {
            Some(pass) => pass,
            None => {
                let untried = self.ports.candidates().await?.into();
                self.pass.insert(Pass {
                    untried,
                    busy: Vec::new(),
                    is_second_round: false,
                    denied: None,
                })
            }
        };
        loop {
            while let Some(path) = pass.untried.pop_front() {
                match self.ports.open(&path).await {
                    Ok(port) => {
                        tracing::debug!(path, "looking for the sensor");
                        return Ok(port);
                    }
                    Err(error) => {
                        tracing::debug!(path, %error, "passed over");
                        pass.note(path, error);
                    }
                }
            }
            if pass.busy.is_empty() {
                break;
            }
            sleep(BUSY_WAIT).await;
            pass.untried = std::mem::take(&mut pass.busy).into();
            pass.is_second_round = true;
        }
        let denied = self.pass.take().and_then(|pass| pass.denied);
        Err(denied
            .unwrap_or_else(|| Error::NoSuchSensor { serial_number: self.serial_number.clone() }))
    }
}

impl Pass {
    fn note(&mut self, path: String, error: Error) {
        match error {
            Error::Busy { .. } if !self.is_second_round => self.busy.push(path),
            Error::PermissionDenied { .. } => self.denied = Some(error),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;
    use tokio::time::Instant;

    use super::*;

    /// Ports that open as the nth letter of their plan says: `o` opens, `b` is
    /// busy, `d` is denied, `g` is gone, `h` hangs; the last one goes on.
    struct Fake {
        listed: Vec<(&'static str, &'static str)>,
        opened: Vec<String>,
        listings: usize,
    }

    impl Ports for Fake {
        type Port = String;

        async fn candidates(&mut self) -> Result<Vec<String>, Error> {
            self.listings += 1;
            Ok(self.listed.iter().map(|(path, _)| (*path).to_owned()).collect())
        }

        async fn open(&mut self, path: &str) -> Result<String, Error> {
            let tries = self.opened.iter().filter(|opened| *opened == path).count();
            self.opened.push(path.to_owned());
            let plan = self.listed.iter().find(|(listed, _)| *listed == path);
            let plan = plan.map_or("g", |(_, plan)| plan);
            let port = path.to_owned();
            match plan.chars().nth(tries).or(plan.chars().last()) {
                Some('o') => Ok(port),
                Some('b') => Err(Error::Busy { port }),
                Some('d') => Err(Error::PermissionDenied { port, group: None }),
                Some('h') => std::future::pending().await,
                _ => Err(Error::NoSuchPort { port }),
            }
        }
    }

    fn search(listed: &[(&'static str, &'static str)]) -> Search<Fake> {
        let fake = Fake { listed: listed.to_vec(), opened: Vec::new(), listings: 0 };
        Search::new("H0713090".to_owned(), fake)
    }

    async fn next(search: &mut Search<Fake>) -> String {
        match search.next_port().await {
            Ok(port) => port,
            Err(Error::NoSuchSensor { serial_number }) => format!("no {serial_number}"),
            Err(error) => error.to_string(),
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_pass_gives_each_port_that_opens_and_then_says_that_none_is_left() {
        let mut search = search(&[("a", "o"), ("b", "g"), ("c", "o")]);
        assert!(!search.has_more(), "no pass has begun");
        assert_eq!(next(&mut search).await, "a");
        assert!(search.has_more());
        assert_eq!(next(&mut search).await, "c");
        assert!(search.has_more(), "the next call says at once that none is left");
        assert_eq!(next(&mut search).await, "no H0713090");
        assert!(!search.has_more());
    }

    #[tokio::test(start_paused = true)]
    async fn the_next_pass_lists_the_ports_anew() {
        let mut search = search(&[]);
        assert_eq!(next(&mut search).await, "no H0713090");
        search.ports.listed = vec![("a", "o")];
        assert_eq!(next(&mut search).await, "a");
        assert_eq!(search.ports.listings, 2);
    }

    #[tokio::test(start_paused = true)]
    async fn after_the_sensor_was_found_the_search_starts_over() {
        let mut search = search(&[("a", "o"), ("b", "o")]);
        assert_eq!(next(&mut search).await, "a");
        search.start_over();
        assert!(!search.has_more());
        assert_eq!(next(&mut search).await, "a");
    }

    #[tokio::test(start_paused = true)]
    async fn a_busy_port_is_tried_once_more_when_the_others_are_through() {
        let mut search = search(&[("a", "bo"), ("b", "o"), ("c", "b")]);
        let start = Instant::now();
        assert_eq!(next(&mut search).await, "b");
        assert_eq!(start.elapsed(), Duration::ZERO, "others come first");
        assert_eq!(next(&mut search).await, "a");
        assert_eq!(start.elapsed(), BUSY_WAIT);
        assert_eq!(next(&mut search).await, "no H0713090");
        assert_eq!(search.ports.opened, ["a", "b", "c", "a", "c"]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_port_that_may_not_be_opened_is_named_when_the_sensor_is_not_elsewhere() {
        let mut search = search(&[("a", "d"), ("b", "o")]);
        assert_eq!(next(&mut search).await, "b");
        assert!(
            matches!(search.next_port().await, Err(Error::PermissionDenied { port, .. }) if port == "a")
        );
        assert!(!search.has_more());
    }

    #[tokio::test(start_paused = true)]
    async fn a_port_whose_opening_was_given_up_is_passed_over() {
        let mut search = search(&[("a", "h"), ("b", "b"), ("c", "o")]);
        assert!(search.next_port().now_or_never().is_none());
        assert_eq!(next(&mut search).await, "c");
        // Given up while waiting for the busy one: it is still tried again.
        assert!(search.next_port().now_or_never().is_none());
        assert_eq!(next(&mut search).await, "no H0713090");
        assert_eq!(search.ports.opened, ["a", "b", "c", "b"]);
    }
}
