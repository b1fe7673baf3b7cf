//! The thread that opens an engine, however long that takes, watches whether it
//! reaches the network, and closes it in good order.
//!
//! A thread, because opening and closing block, and because zenoh refuses both in
//! a tokio runtime of one thread.

use std::net::{IpAddr, UdpSocket};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use tokio::sync::oneshot;

use super::counts::ScanCounts;
#[cfg(feature = "ros2")]
use super::dds::Dds;
use super::engine::{Engine, EngineName, EngineSettings, NodeSpec, Outlet, Shared};
#[cfg(feature = "zenoh")]
use super::zenoh::Zenoh;
use crate::failure::Failure;
use crate::output::notice::notice;

/// The pause between two attempts to open an engine.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// The pause between two looks at an open engine.
const WATCH_INTERVAL: Duration = Duration::from_millis(500);

/// An engine on its thread. Dropping it closes the engine without waiting.
#[derive(Debug)]
pub(crate) struct RunningEngine {
    /// Its end asks the thread to end.
    stop: mpsc::Sender<()>,
    ended: oneshot::Receiver<()>,
}

impl RunningEngine {
    /// Starts an engine, and returns an outlet for each node. Fails if this
    /// program was built without it.
    pub(crate) fn start(
        engine: EngineName,
        settings: EngineSettings,
        nodes: Vec<NodeSpec>,
    ) -> Result<(Self, Vec<Outlet>), Failure> {
        match engine {
            #[cfg(feature = "ros2")]
            EngineName::Dds => start::<Dds>(settings, nodes),
            #[cfg(feature = "zenoh")]
            EngineName::Zenoh => start::<Zenoh>(settings, nodes),
            #[cfg(not(feature = "ros2"))]
            EngineName::Dds => Err(not_built_in("dds", "ros2")),
            #[cfg(not(feature = "zenoh"))]
            EngineName::Zenoh => Err(not_built_in("zenoh", "zenoh")),
        }
    }

    /// Takes the nodes out of the graph, and waits for that.
    pub(crate) async fn close(self) {
        drop(self.stop);
        // An error, too, means that the thread has ended.
        let _ = self.ended.await;
    }
}

#[cfg(not(all(feature = "ros2", feature = "zenoh")))]
fn not_built_in(engine: &str, feature: &str) -> Failure {
    Failure::Usage(format!(
        "`--engine {engine}` needs an urg that was built with the feature `{feature}`: \
         `cargo install tokio-scip --features {feature}`"
    ))
}

fn start<E: Engine>(
    settings: EngineSettings,
    nodes: Vec<NodeSpec>,
) -> Result<(RunningEngine, Vec<Outlet>), Failure> {
    let publishers = Shared::default();
    let counts: Vec<Arc<ScanCounts>> = nodes.iter().map(|_| Arc::default()).collect();
    let outlets = counts.iter().enumerate();
    let outlets =
        outlets.map(|(node, counts)| Outlet::new(node, &publishers, Arc::clone(counts))).collect();
    let (stop, stopped) = mpsc::channel();
    let (end, ended) = oneshot::channel();
    std::thread::Builder::new()
        .name("engine".to_owned())
        .spawn(move || {
            run::<E>(&settings, &nodes, &counts, &publishers, &stopped);
            let _ = end.send(());
        })
        .map_err(|error| Failure::of("cannot start the engine's thread", &error))?;
    Ok((RunningEngine { stop, ended }, outlets))
}

/// Runs an engine until it is stopped. One that needs another look at the network is
/// closed and opened again.
fn run<E: Engine>(
    settings: &EngineSettings,
    nodes: &[NodeSpec],
    counts: &[Arc<ScanCounts>],
    shared: &Shared,
    stop: &mpsc::Receiver<()>,
) {
    let stopped = |wait| !matches!(stop.recv_timeout(wait), Err(RecvTimeoutError::Timeout));
    let set = |publishers| {
        *shared.write().unwrap_or_else(PoisonError::into_inner) = publishers;
    };
    let mut network = Network::of(nodes);
    loop {
        let (mut engine, publishers) = loop {
            let opened = match missing_address(settings.interface) {
                Some(why) => Err(why),
                None => E::open(settings, nodes, counts),
            };
            match opened {
                Ok(opened) => break opened,
                Err(why) => network
                    .report(Some(format!("{why}; waiting for it, scans are dropped until then"))),
            }
            if stopped(RETRY_INTERVAL) {
                return;
            }
        };
        set(Some(publishers));
        let is_stopped = loop {
            network.report(engine.unreachable());
            if stopped(WATCH_INTERVAL) {
                break true;
            }
            if engine.is_outdated() || missing_address(settings.interface).is_some() {
                break false;
            }
        };
        set(None);
        engine.close();
        if is_stopped {
            return;
        }
    }
}

/// Returns why the only address that may be used cannot be: no interface has it (yet).
fn missing_address(address: Option<IpAddr>) -> Option<String> {
    let address = address?;
    // The system checks the address when a socket is bound to it.
    let error = UdpSocket::bind((address, 0)).err()?;
    Some(format!("cannot use the address {address} of --interface: {error}"))
}

/// Reports once that scans are published, or not, and each change of that.
#[derive(Debug)]
struct Network {
    topics: String,
    /// `None` before the first report.
    away: Option<bool>,
}

impl Network {
    fn of(nodes: &[NodeSpec]) -> Self {
        let topics = match nodes {
            [first, .., last] => {
                format!("{} topics, {} to {}", nodes.len(), first.scan_topic, last.scan_topic)
            }
            _ => nodes.iter().map(|node| node.scan_topic.as_str()).collect(),
        };
        Self { topics, away: None }
    }

    fn report(&mut self, unreachable: Option<String>) {
        if let Some(line) = self.change(unreachable) {
            notice(line);
        }
    }

    /// Returns the line for the user, if there is something new.
    fn change(&mut self, unreachable: Option<String>) -> Option<String> {
        let before = self.away.replace(unreachable.is_some());
        match (before, unreachable) {
            (Some(true), Some(_)) | (Some(false), None) => None,
            (_, Some(why)) => Some(why),
            (Some(true), None) => Some("the network is back: scans are published".to_owned()),
            (None, None) => Some(format!("scans are published on {}; Ctrl-C stops", self.topics)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_of_the_network_is_reported_once() {
        let mut network = Network { topics: "/scan".to_owned(), away: None };
        let said = [None, None, Some("no router"), Some("no router"), None, None]
            .map(|why| network.change(why.map(str::to_owned)));
        let expected = [
            "scans are published on /scan; Ctrl-C stops",
            "no router",
            "the network is back: scans are published",
        ];
        assert_eq!(said.into_iter().flatten().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn an_address_that_no_interface_has_is_waited_for() {
        assert_eq!(missing_address(None), None);
        assert_eq!(missing_address(Some("127.0.0.1".parse().unwrap())), None);
        // For documentation only (RFC 5737): no interface has it.
        let missing = missing_address(Some("192.0.2.1".parse().unwrap())).unwrap();
        assert!(missing.contains("192.0.2.1") && missing.contains("--interface"), "{missing}");
    }
}
