//! The search for a sensor by its serial number: which port is opened next. The driver
//! checks which sensor is there.

use std::future::Future;
use std::io;
use std::time::Duration;
use std::vec;

use tokio::time::{sleep, timeout};

use super::list::{self, PortInfo};
use super::serial::{SerialOpener, SerialPort};
use crate::Error;

/// The time after which a busy port is tried once more.
///
/// A service that opens two sensors at once tries each on the other's port: a port that
/// is busy then is free again as soon as the other driver has found another sensor.
const BUSY_RETRY_DELAY: Duration = Duration::from_millis(500);

/// The time after which a port that is still being opened is skipped. Opening takes
/// milliseconds unless a device hangs; the others are to be tried within the open
/// timeout, 5 s unless set.
const OPEN_LIMIT: Duration = Duration::from_secs(2);

/// A source of ports. Tests have one without hardware.
pub(super) trait Ports: Send + 'static {
    type Port;

    /// Returns the ports that the sensor can be on.
    fn candidates(&mut self) -> impl Future<Output = Result<Vec<String>, Error>> + Send;

    fn open(&mut self, path: &str) -> impl Future<Output = Result<Self::Port, Error>> + Send;
}

/// The ports of this machine.
#[derive(Debug, Default)]
pub(super) struct SystemPorts {
    /// The port that was opened last, and its opener.
    latest: Option<(String, SerialOpener)>,
    /// Those before whose opening hangs in the system. Each port has an opener of its own,
    /// so that one that hangs keeps no other waiting.
    hanging: Vec<(String, SerialOpener)>,
}

impl Ports for SystemPorts {
    type Port = SerialPort;

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        let ports = list::list().await?;
        Ok(ports.into_iter().filter(PortInfo::is_likely_sensor).map(|port| port.path).collect())
    }

    async fn open(&mut self, path: &str) -> Result<SerialPort, Error> {
        self.hanging.extend(self.latest.take());
        self.hanging.retain(|(_, opener)| opener.is_opening());
        if self.hanging.iter().any(|(hanging, _)| hanging == path) {
            // One thread for it is enough.
            return Err(Error::Busy { port: path.to_owned() });
        }
        let (_, opener) = self.latest.insert((path.to_owned(), SerialOpener::default()));
        opener.open(path).await
    }
}

/// A search through the candidates, which opens one port a call.
#[derive(Debug)]
pub(super) struct Search<P> {
    serial_number: String,
    ports: P,
    pass: Option<Pass>,
}

#[derive(Debug)]
struct Pass {
    untried: vec::IntoIter<String>,
    busy: Vec<String>,
    /// The busy ones are tried for the second time.
    is_second_round: bool,
    /// The error of a port that the user may not open. The sensor may be there, so
    /// that it is reported in place of "no such sensor".
    denied: Option<Error>,
}

impl<P: Ports> Search<P> {
    pub(super) fn new(serial_number: String, ports: P) -> Self {
        Self { serial_number, ports, pass: None }
    }

    pub(super) fn serial_number(&self) -> &str {
        &self.serial_number
    }

    /// Returns true until a call has reported that no candidate is left.
    pub(super) fn has_more(&self) -> bool {
        self.pass.is_some()
    }

    /// Ends the pass: the next call lists the candidates again.
    pub(super) fn start_over(&mut self) {
        self.pass = None;
    }

    /// Opens the next port that can be opened. A port that hangs is skipped after
    /// `OPEN_LIMIT`, or if the future is dropped while it is being opened.
    pub(super) async fn next_port(&mut self) -> Result<P::Port, Error> {
        let pass = match &mut self.pass {
            Some(pass) => pass,
            None => {
                let untried = self.ports.candidates().await?.into_iter();
                self.pass.insert(Pass {
                    untried,
                    busy: Vec::new(),
                    is_second_round: false,
                    denied: None,
                })
            }
        };
        loop {
            while let Some(path) = pass.untried.next() {
                let limited = timeout(OPEN_LIMIT, self.ports.open(&path));
                let opened = limited.await.unwrap_or_else(|_| {
                    Err(Error::open(path.as_str(), io::ErrorKind::TimedOut.into()))
                });
                match opened {
                    Ok(port) => {
                        tracing::trace!(path, "checking whether the sensor is on this port");
                        return Ok(port);
                    }
                    Err(error) => {
                        tracing::trace!(path, error = %error.chain(), "port skipped");
                        pass.note(path, error);
                    }
                }
            }
            if pass.busy.is_empty() {
                break;
            }
            sleep(BUSY_RETRY_DELAY).await;
            pass.untried = std::mem::take(&mut pass.busy).into_iter();
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
    use tokio::task::spawn_blocking;
    use tokio::time::Instant;

    use super::*;

    /// Ports whose nth opening has the result of the nth letter of their plan: `o` opens,
    /// `b` is busy, `d` is denied, `g` is gone, `h` hangs; the last one is repeated.
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
    async fn a_pass_opens_each_port_that_can_be_opened_and_then_fails() {
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
        assert_eq!(start.elapsed(), BUSY_RETRY_DELAY);
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
    async fn a_port_whose_opening_was_dropped_is_skipped() {
        let mut search = search(&[("a", "h"), ("b", "b"), ("c", "o")]);
        assert!(search.next_port().now_or_never().is_none());
        assert_eq!(next(&mut search).await, "c");
        // Dropped while waiting for the busy one, which is still tried again.
        assert!(search.next_port().now_or_never().is_none());
        assert_eq!(next(&mut search).await, "no H0713090");
        assert_eq!(search.ports.opened, ["a", "b", "c", "b"]);
    }

    #[tokio::test(start_paused = true)]
    async fn o25_a_port_that_hangs_does_not_keep_the_others_from_being_tried() {
        let mut search = search(&[("a", "h"), ("b", "h"), ("c", "o")]);
        let start = Instant::now();
        assert_eq!(next(&mut search).await, "c");
        assert_eq!(start.elapsed(), 2 * OPEN_LIMIT);
    }

    /// The system's own ports, while the one thread for blocking calls is busy, as with a
    /// device that hangs.
    #[test]
    fn o25_a_port_whose_opening_hangs_is_busy_until_it_ends_and_no_other_one_is() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(1)
            .build()
            .unwrap();
        runtime.block_on(async {
            let (hang, end) = std::sync::mpsc::channel::<()>();
            let hanging = spawn_blocking(move || end.recv());
            let mut ports = SystemPorts::default();
            let mut open = async |path: &str| ports.open(path).await.map(drop);
            assert!(open("/dev/gone").now_or_never().is_none());
            let again = open("/dev/gone").now_or_never();
            assert!(matches!(again, Some(Err(Error::Busy { .. }))), "{again:?}");
            assert!(open("/dev/lost").now_or_never().is_none(), "another port waits for itself");
            drop(hang);
            assert!(hanging.await.unwrap().is_err());
            // The thread has begun this call after the openings, which have ended.
            spawn_blocking(|| ()).await.unwrap();
            for path in ["/dev/gone", "/dev/lost"] {
                let error = open(path).await.unwrap_err();
                assert!(matches!(error, Error::NoSuchPort { .. }), "{error}");
            }
        });
    }
}
