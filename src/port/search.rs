//! Searches for a sensor by its serial number: chooses the next port to open. The driver
//! checks which sensor it has.

use std::future::Future;
use std::mem::replace;
use std::time::Duration;
use std::vec;

use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::list;
use super::serial::{SerialOpener, SerialPort};
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

/// Serial ports of this machine.
#[derive(Debug, Default)]
pub(super) struct SystemPorts {
    /// Last opened port, and its opener.
    latest: Option<(String, SerialOpener)>,
    /// Earlier ports whose opening hangs in the system. Each port has its own opener, so that
    /// a hanging one blocks no other.
    hanging: Vec<(String, SerialOpener)>,
}

impl Ports for SystemPorts {
    type Port = SerialPort;

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        let ports = list::list().await?;
        Ok(ports.into_iter().filter(|port| port.likely_sensor).map(|port| port.path).collect())
    }

    async fn open(&mut self, path: &str) -> Result<SerialPort, Error> {
        self.hanging.extend(self.latest.take());
        self.hanging.retain_mut(|(_, opener)| opener.is_opening());
        if self.hanging.iter().any(|(hanging, _)| hanging == path) {
            // One thread for it is enough.
            return Err(ErrorKind::Busy { port: path.to_owned() }.into());
        }
        let (_, opener) = self.latest.insert((path.to_owned(), SerialOpener::default()));
        opener.open(path).await
    }
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

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::io;
    use std::sync::{Arc, Mutex};

    use super::*;
    use futures::FutureExt;
    use futures::future::join_all;

    /// Ports whose nth opening has the result of the nth letter of their plan: `o` opens, `b`
    /// is busy, `d` is denied, `e` fails, `g` is gone, `h` hangs. The last letter repeats.
    struct Fake {
        /// When the last port appears.
        appears: Instant,
        listed: Vec<(&'static str, &'static str)>,
        opened: Vec<String>,
        listings: usize,
    }

    impl Ports for Fake {
        type Port = String;

        async fn candidates(&mut self) -> Result<Vec<String>, Error> {
            self.listings += 1;
            let mut listed: Vec<_> =
                self.listed.iter().map(|(path, _)| (*path).to_owned()).collect();
            if Instant::now() < self.appears {
                listed.pop();
            }
            Ok(listed)
        }

        async fn open(&mut self, path: &str) -> Result<String, Error> {
            let tries = self.opened.iter().filter(|opened| *opened == path).count();
            self.opened.push(path.to_owned());
            let plan = self.listed.iter().find(|(listed, _)| *listed == path);
            let plan = plan.map_or("g", |(_, plan)| plan);
            let port = path.to_owned();
            match plan.chars().nth(tries).or(plan.chars().last()) {
                Some('o') => Ok(port),
                Some('b') => Err(ErrorKind::Busy { port }.into()),
                Some('d') => Err(ErrorKind::PermissionDenied { port, group: None }.into()),
                Some('e') => Err(Error::open(port, io::ErrorKind::PermissionDenied.into())),
                Some('h') => std::future::pending().await,
                _ => Err(ErrorKind::NoSuchPort { port }.into()),
            }
        }
    }

    /// Ports that several searches share. Each port is busy while a search holds it.
    struct SharedPorts {
        count: usize,
        held: Arc<Mutex<HashSet<String>>>,
    }

    struct Held(String, Arc<Mutex<HashSet<String>>>);

    impl Drop for Held {
        fn drop(&mut self) {
            self.1.lock().unwrap().remove(&self.0);
        }
    }

    impl Ports for SharedPorts {
        type Port = Held;

        async fn candidates(&mut self) -> Result<Vec<String>, Error> {
            Ok((0..self.count).map(|number| number.to_string()).collect())
        }

        async fn open(&mut self, path: &str) -> Result<Held, Error> {
            let port = path.to_owned();
            match self.held.lock().unwrap().insert(port.clone()) {
                true => Ok(Held(port, Arc::clone(&self.held))),
                false => Err(ErrorKind::Busy { port }.into()),
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn simultaneous_searches_each_find_a_sensor() {
        for (count, shift) in (2..=5).flat_map(|count| (0..count).map(move |shift| (count, shift)))
        {
            let held = Arc::default();
            let searches = (0..count).map(|sensor| {
                let own = ((sensor + shift) % count).to_string();
                let ports = SharedPorts { count, held: Arc::clone(&held) };
                let mut search = Search::new(own.clone(), ports);
                async move {
                    loop {
                        let port = search.next_port().await?;
                        // Asks the sensor for its serial number.
                        sleep(Duration::from_millis(400)).await;
                        if port.0 == own {
                            return Ok::<_, Error>(port);
                        }
                    }
                }
            });
            let found = join_all(searches).await;
            assert!(found.iter().all(Result::is_ok), "{count} sensors, moved by {shift}");
        }
    }

    fn search(listed: &[(&'static str, &'static str)]) -> Search<Fake> {
        let (listed, appears) = (listed.to_vec(), Instant::now());
        let fake = Fake { listed, opened: Vec::new(), listings: 0, appears };
        Search::new("H0713090".to_owned(), fake)
    }

    async fn next(search: &mut Search<Fake>) -> String {
        match search.next_port().await {
            Ok(port) => port,
            Err(error) => match error.kind() {
                ErrorKind::NoSuchSensor { serial_number } => format!("no {serial_number}"),
                _ => error.to_string(),
            },
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_pass_opens_each_port_once() {
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
    async fn a_busy_port_is_retried_when_the_others_are_through() {
        let mut search = search(&[("a", "bo"), ("b", "o"), ("c", "b")]);
        let start = Instant::now();
        assert_eq!(next(&mut search).await, "b");
        assert_eq!(start.elapsed(), Duration::ZERO, "others come first");
        assert_eq!(next(&mut search).await, "a");
        assert_eq!(start.elapsed(), BUSY_RETRY_DELAY);
        assert_eq!(next(&mut search).await, "no H0713090");
        assert_eq!(start.elapsed(), BUSY_RETRIES * BUSY_RETRY_DELAY);
        assert_eq!(search.ports.opened, ["a", "b", "c", "a", "c", "c", "c", "c"]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_busy_port_is_retried_after_dropped_calls() {
        let mut search = search(&[("a", "bo")]);
        let call = Duration::from_millis(20);
        let mut calls = 1;
        while timeout(call, search.next_port()).await.is_err() {
            calls += 1;
            assert!(call * calls <= BUSY_RETRY_DELAY + call, "the delay begins again and again");
        }
        assert_eq!(search.ports.opened, ["a", "a"]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_port_that_appears_is_opened_soon() {
        let busy = ["a", "b", "c", "d", "e", "f", "g", "h", "i", "j"].map(|path| (path, "b"));
        let pass = BUSY_RETRIES * BUSY_RETRY_DELAY;
        for (plan, limit) in [("o", LISTING_INTERVAL), ("eo", 2 * LISTING_INTERVAL)] {
            let last = (pass - limit).as_millis() as u64;
            for after in (0..=last).step_by(10).map(Duration::from_millis) {
                let mut search = search(&[&busy[..], &[("new", plan)]].concat());
                search.ports.appears += after;
                let start = Instant::now();
                assert_eq!(next(&mut search).await, "new");
                assert!(start.elapsed() <= after + limit, "{after:?}: {:?}", start.elapsed());
                assert!(search.ports.listings <= 9, "{} listings", search.ports.listings);
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn between_passes_only_a_new_port_is_told() {
        let mut search = search(&[("a", "e"), ("b", "e"), ("new", "o")]);
        search.ports.appears += Duration::from_secs(10);
        assert_eq!(next(&mut search).await, "no H0713090");
        // Dropped and called again, as by a driver that backs off.
        while timeout(Duration::from_secs(1), search.port_appears()).await.is_err() {
            assert_eq!(next(&mut search).await, "no H0713090");
        }
        assert!(search.ports.appears.elapsed() <= LISTING_INTERVAL);
        assert_eq!(next(&mut search).await, "new");
        let appears = search.port_appears();
        assert!(timeout(Duration::from_secs(10), appears).await.is_err(), "nothing is new");
    }

    #[tokio::test(start_paused = true)]
    async fn a_forbidden_port_is_named_in_the_end() {
        let mut search = search(&[("a", "d"), ("b", "o")]);
        assert_eq!(next(&mut search).await, "b");
        let error = search.next_port().await.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::PermissionDenied { port, .. } if port == "a"));
        assert!(!search.has_more());
    }

    #[tokio::test(start_paused = true)]
    async fn a_port_whose_opening_was_dropped_is_skipped() {
        let mut search = search(&[("a", "h"), ("b", "b"), ("c", "o")]);
        assert!(search.next_port().now_or_never().is_none());
        assert_eq!(next(&mut search).await, "c");
        // Dropped while it waited for the busy port, which is still retried.
        assert!(search.next_port().now_or_never().is_none());
        assert_eq!(next(&mut search).await, "no H0713090");
        assert_eq!(search.ports.opened, ["a", "b", "c", "b", "b", "b", "b"]);
    }

    #[tokio::test(start_paused = true)]
    async fn o25_a_hanging_port_spares_the_others() {
        let mut search = search(&[("a", "h"), ("b", "h"), ("c", "o")]);
        let start = Instant::now();
        assert_eq!(next(&mut search).await, "c");
        assert_eq!(start.elapsed(), 2 * OPEN_LIMIT);
    }

    #[tokio::test]
    async fn o25_a_hanging_port_blocks_no_other() {
        let (hang, opener) = SerialOpener::hanging();
        let mut ports = SystemPorts {
            latest: Some(("/dev/gone".to_owned(), opener)),
            ..SystemPorts::default()
        };
        let mut open = async |path: &str| ports.open(path).await.map(drop).unwrap_err();
        for _ in 0..2 {
            let error = open("/dev/gone").await;
            assert!(
                matches!(error.kind(), ErrorKind::Busy { .. }),
                "one thread is enough: {error}"
            );
            let error = open("/dev/lost").await;
            assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error}");
        }
        drop(hang);
        let error = open("/dev/gone").await;
        assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error}");
    }
}
