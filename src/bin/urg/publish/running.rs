//! The thread that opens an engine, however long that takes, watches whether it
//! reaches the network, and closes it in good order.
//!
//! A thread, because opening and closing block, and because zenoh refuses both in
//! a tokio runtime of one thread.

use std::net::{IpAddr, UdpSocket};
use std::sync::PoisonError;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use tokio::sync::oneshot;

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
    let outlets = (0..nodes.len()).map(|node| Outlet::new(node, &publishers)).collect();
    let (stop, stopped) = mpsc::channel();
    let (end, ended) = oneshot::channel();
    std::thread::Builder::new()
        .name("engine".to_owned())
        .spawn(move || {
            run::<E>(&settings, &nodes, &publishers, &stopped);
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
    shared: &Shared,
    stop: &mpsc::Receiver<()>,
) {
    let stopped = |wait| !matches!(stop.recv_timeout(wait), Err(RecvTimeoutError::Timeout));
    let set = |publishers| {
        *shared.write().unwrap_or_else(PoisonError::into_inner) = publishers;
    };
    let mut network = Network::default();
    loop {
        let (engine, publishers) = loop {
            let opened = match missing_address(settings.interface) {
                Some(why) => Err(why),
                None => E::open(settings, nodes),
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

/// Reports the loss of the network once, and its return.
#[derive(Debug, Default)]
struct Network {
    away: bool,
}

impl Network {
    fn report(&mut self, unreachable: Option<String>) {
        let away = unreachable.is_some();
        match (self.away, unreachable) {
            (false, Some(why)) => notice(why),
            (true, None) => notice("the network is back: scans are published"),
            (true, Some(_)) | (false, None) => {}
        }
        self.away = away;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_no_interface_has_is_waited_for() {
        assert_eq!(missing_address(None), None);
        assert_eq!(missing_address(Some("127.0.0.1".parse().unwrap())), None);
        // For documentation only (RFC 5737): no interface has it.
        let missing = missing_address(Some("192.0.2.1".parse().unwrap())).unwrap();
        assert!(missing.contains("192.0.2.1") && missing.contains("--interface"), "{missing}");
    }
}
