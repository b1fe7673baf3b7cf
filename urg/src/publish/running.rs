//! Thread that opens an engine, watches it, reopens it if it stops working, and closes it.
//!
//! It is a thread because opening and closing block, and zenoh refuses both inside tokio's
//! current-thread runtime.

use std::net::{IpAddr, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::{self as std_mpsc, RecvTimeoutError};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use super::backoff::Backoff;
#[cfg(feature = "dds")]
use super::dds::Dds;
use super::engine::{
    Engine, EngineName, EngineSettings, Opened, OpenedEngine, Outlet, Reopen, Shared, Topic,
    Unavailable,
};
#[cfg(feature = "foxglove")]
use super::foxglove::Foxglove;
use super::names::NodeNames;
#[cfg(feature = "zenoh")]
use super::zenoh::Zenoh;
use crate::failure::Failure;
use crate::output::notice::notice;

const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Pause between two checks of an open engine.
const WATCH_INTERVAL: Duration = Duration::from_millis(500);

/// Checks until a reopened engine counts as working: one minute.
const WORKING_CHECKS: u32 = 120;

/// Maximum number of consecutive restarts. After that, only the user can help.
const MAX_RESTARTS: u32 = 5;

/// Time that an engine has to close.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(if cfg!(test) { 100 } else { 10_000 });

/// The same, if another engine may be opened meanwhile.
const OVERLAP_TIMEOUT: Duration = Duration::from_secs(2);

type Open = fn(&Arc<EngineSettings>, &Arc<[Topic]>) -> OpenedEngine;

/// Engine on its own thread. Dropping it closes the engine without waiting.
#[derive(Debug)]
pub(crate) struct RunningEngine {
    /// Dropped to stop the thread.
    stop: std_mpsc::Sender<()>,
    /// Permanent failure of the engine. Closed when the thread ends.
    failures: mpsc::Receiver<Failure>,
}

impl RunningEngine {
    /// Starts an engine with one outlet per node. The engine has to be built in.
    pub(crate) fn start(
        engine: EngineName,
        settings: EngineSettings,
    ) -> Result<(Self, Vec<Outlet>), Failure> {
        match engine {
            #[cfg(feature = "dds")]
            EngineName::Dds => start(Dds::open, settings),
            #[cfg(feature = "zenoh")]
            EngineName::Zenoh => start(Zenoh::open, settings),
            #[cfg(feature = "foxglove")]
            EngineName::Foxglove => start(Foxglove::open, settings),
            #[cfg(not(all(feature = "dds", feature = "zenoh", feature = "foxglove")))]
            other => Err(not_built_in(other)),
        }
    }

    /// Waits until the engine fails permanently. Cancel-safe.
    pub(crate) async fn failed(&mut self) -> Failure {
        // Unless the thread panics, it ends only with a failure or after `close`.
        let ended = || Failure::Failed("the engine's thread has ended".to_owned());
        self.failures.recv().await.unwrap_or_else(ended)
    }

    /// Removes the nodes from the ROS graph, and waits until the thread ends.
    pub(crate) async fn close(mut self) {
        drop(self.stop);
        while self.failures.recv().await.is_some() {}
    }
}

#[cfg(not(all(feature = "dds", feature = "zenoh", feature = "foxglove")))]
fn not_built_in(engine: EngineName) -> Failure {
    let feature = format!("{engine:?}").to_lowercase();
    Failure::Usage(format!(
        "`--engine {feature}` needs an urg that was built with the feature `{feature}`: \
         `cargo install --path urg --features {feature}`"
    ))
}

fn start(open: Open, settings: EngineSettings) -> Result<(RunningEngine, Vec<Outlet>), Failure> {
    let topics = settings.topics();
    let shared = Shared::default();
    let scans = topics.iter().filter(|topic| topic.has_scans());
    let outlets = scans.map(|topic| Outlet::new(topic.node, &shared, &topic.counts)).collect();
    let (stop, stopped) = std_mpsc::channel();
    let (fail, failures) = mpsc::channel(1);
    let mut engine = Watched {
        open,
        network: NetworkNotices::for_nodes(&settings.nodes),
        settings: Arc::new(settings),
        topics: topics.into(),
        shared,
        stop: stopped,
        restarts: 0,
        backoff: Backoff::default(),
    };
    std::thread::Builder::new()
        .name("engine".to_owned())
        .spawn(move || {
            if let Err(failure) = engine.run() {
                // The receiver is gone during shutdown.
                let _ = fail.try_send(failure);
            }
        })
        .map_err(|error| Failure::new("cannot start the engine's thread", &error))?;
    Ok((RunningEngine { stop, failures }, outlets))
}

struct Watched {
    open: Open,
    settings: Arc<EngineSettings>,
    topics: Arc<[Topic]>,
    shared: Shared,
    stop: std_mpsc::Receiver<()>,
    network: NetworkNotices,
    restarts: u32,
    backoff: Backoff,
}

impl Watched {
    /// Runs the engine until it is stopped. Reopens it after the network has changed or the
    /// engine has died. The error is permanent: reopening did not help.
    fn run(&mut self) -> Result<(), Failure> {
        while let Some((mut engine, publisher)) = self.open()? {
            *self.shared.write() = Some(publisher);
            let watched = self.watch(&mut *engine);
            *self.shared.write() = None;
            let is_closed = close(engine);
            let Err(reason) = watched else { break };
            self.count(&reason, is_closed)?;
        }
        Ok(())
    }

    /// Retries until the engine opens. `None` if it was stopped meanwhile.
    fn open(&mut self) -> Result<Option<Opened>, Failure> {
        loop {
            let opened = match missing_address(self.settings.interface) {
                Some(why) => Err(Unavailable::Now(why)),
                None => (self.open)(&self.settings, &self.topics),
            };
            match opened {
                Ok(opened) => return Ok(Some(opened)),
                Err(Unavailable::Permanently(why)) => return Err(Failure::Failed(why)),
                Err(Unavailable::Now(why)) => self
                    .network
                    .report(Some(format!("{why}; waiting for it, scans are dropped until then"))),
            }
            if self.is_stopped(RETRY_INTERVAL) {
                return Ok(None);
            }
        }
    }

    /// Checks the engine at regular intervals, until the user stops it or it has to be
    /// reopened.
    fn watch(&mut self, engine: &mut dyn Engine) -> Result<(), Reopen> {
        let mut checks = 0;
        loop {
            match engine.check() {
                Ok(unreachable) => self.network.report(unreachable),
                Err(Reopen::Wanted(_)) if !self.backoff.allows(Instant::now()) => {}
                Err(reason) => return Err(reason),
            }
            checks += 1;
            if checks == WORKING_CHECKS {
                self.restarts = 0;
            }
            if self.is_stopped(WATCH_INTERVAL) {
                return Ok(());
            }
            if missing_address(self.settings.interface).is_some() {
                return Err(Reopen::Outdated("the address of --interface is gone".to_owned()));
            }
        }
    }

    /// Counts and announces that the engine is opened again. An error if the old one hangs,
    /// because two would publish twice, or if it has died too often.
    fn count(&mut self, reason: &Reopen, is_closed: bool) -> Result<(), Failure> {
        let (Reopen::Outdated(why) | Reopen::Wanted(why) | Reopen::Dead(why)) = reason;
        if !is_closed {
            return Err(Failure::Failed(format!("{why}, and the engine cannot be closed")));
        }
        if matches!(reason, Reopen::Dead(_)) {
            if self.restarts == MAX_RESTARTS {
                return Err(Failure::Failed(format!(
                    "{why}, also after it was opened again {MAX_RESTARTS} times"
                )));
            }
            self.restarts += 1;
        }
        self.topics.iter().for_each(|topic| topic.counts.lock().restarts += 1);
        notice(format_args!("{why}: the engine is opened again"));
        Ok(())
    }

    /// Waits for at most `wait`. Returns true if the engine was stopped meanwhile.
    fn is_stopped(&self, wait: Duration) -> bool {
        !matches!(self.stop.recv_timeout(wait), Err(RecvTimeoutError::Timeout))
    }
}

/// Closes an engine on a separate thread. Returns false if it hangs, unless it may.
fn close(engine: Box<dyn Engine>) -> bool {
    let may_hang = engine.may_overlap();
    let timeout = if may_hang { OVERLAP_TIMEOUT } else { CLOSE_TIMEOUT };
    let (end, ended) = std_mpsc::channel();
    let closing = std::thread::Builder::new().name("closing".to_owned()).spawn(move || {
        engine.close();
        let _ = end.send(());
    });
    closing.is_ok() && (ended.recv_timeout(timeout) != Err(RecvTimeoutError::Timeout) || may_hang)
}

/// Checks that an interface has the address of `--interface`, and explains if not.
fn missing_address(address: Option<IpAddr>) -> Option<String> {
    let address = address?;
    // Binding a socket checks the address.
    let error = UdpSocket::bind((address, 0)).err()?;
    Some(format!("cannot use the address {address} of --interface: {error}"))
}

/// Notices for the user about the state of the network, printed only when it changes.
#[derive(Debug)]
struct NetworkNotices {
    topics: String,
    /// Why the network was away at the last notice; `None` before the first.
    away: Option<Option<String>>,
}

impl NetworkNotices {
    fn for_nodes(nodes: &[NodeNames]) -> Self {
        let topics = match nodes {
            [first, .., last] => {
                format!("{} topics, {} to {}", nodes.len(), first.topic, last.topic)
            }
            _ => nodes.iter().map(|node| node.topic.as_str()).collect(),
        };
        Self { topics, away: None }
    }

    fn report(&mut self, unreachable: Option<String>) {
        if let Some(line) = self.change(unreachable) {
            notice(line);
        }
    }

    /// Updates the state. Returns a line for the user if it changed.
    fn change(&mut self, unreachable: Option<String>) -> Option<String> {
        let before = self.away.replace(unreachable.clone());
        match (before, unreachable) {
            (Some(before), now) if before == now => None,
            (_, Some(why)) => Some(why),
            (Some(_), None) => Some("the network is back: scans are published".to_owned()),
            (None, None) => Some(format!("scans are published on {}; Ctrl-C stops", self.topics)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::engine::Publisher;
    use super::super::{Discovery, Mode, Qos};
    use super::*;

    /// Engine that is dead at once. If `hangs`, it is outdated instead, and cannot be closed.
    struct Faulty {
        hangs: bool,
    }

    impl Publisher for Faulty {
        fn publish(&self, _: usize, _: Vec<u8>) {}
    }

    impl Engine for Faulty {
        fn open(settings: &Arc<EngineSettings>, _: &Arc<[Topic]>) -> OpenedEngine {
            let hangs = settings.domain == 1;
            match settings.domain {
                2 => Err(Unavailable::Permanently("it can never open".to_owned())),
                _ => Ok((Box::new(Self { hangs }), Arc::new(Self { hangs }))),
            }
        }

        fn check(&mut self) -> Result<Option<String>, Reopen> {
            Err(match self.hangs {
                true => Reopen::Outdated("the network has changed".to_owned()),
                false => Reopen::Dead("the engine is dead".to_owned()),
            })
        }

        fn close(self: Box<Self>) {
            if self.hangs {
                std::thread::sleep(Duration::MAX);
            }
        }
    }

    #[tokio::test]
    async fn an_engine_is_opened_again_unless_that_cannot_help() {
        for (domain, restarts, line) in [
            (0, 5, "the engine is dead, also after it was opened again 5 times"),
            (1, 0, "the network has changed, and the engine cannot be closed"),
            (2, 0, "it can never open"),
        ] {
            let settings = EngineSettings {
                nodes: vec![NodeNames::default()],
                domain,
                qos: Qos::Reliable,
                depth: 1,
                transforms: Vec::new(),
                interface: None,
                discovery: Discovery::default(),
                router: String::new(),
                mode: Mode::Client,
                listen: ([127, 0, 0, 1], 0).into(),
            };
            let (mut running, outlets) = start(Faulty::open, settings).unwrap();
            assert_eq!(running.failed().await.line(), line);
            assert_eq!(outlets[0].counts().lock().restarts, restarts, "{line}");
            running.close().await;
        }
    }

    #[test]
    fn a_change_of_the_network_is_reported_once() {
        let mut network = NetworkNotices { topics: "/scan".to_owned(), away: None };
        let said =
            [None, None, Some("no router"), Some("no router"), Some("no address"), None, None]
                .map(|why| network.change(why.map(str::to_owned)));
        let expected = [
            "scans are published on /scan; Ctrl-C stops",
            "no router",
            "no address",
            "the network is back: scans are published",
        ];
        assert_eq!(said.into_iter().flatten().collect::<Vec<_>>(), expected);
    }
}
