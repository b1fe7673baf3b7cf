//! DDS engine: one participant with one ROS node per sensor.
//!
//! - `participant` wraps Cyclone DDS.
//! - `discovery_info` tells ROS the writers of each node.
//! - `network` chooses interfaces, and writes Cyclone's configuration.
//! - `log` filters Cyclone's messages.
//! - `pulse` checks from outside whether the participant is alive.
//! - `trace` detects participants that were forgotten and are back.
//! - `static_peers` repeats the participant's announcements to hosts beyond multicast.

mod discovery_info;
mod log;
mod network;
mod participant;
mod pulse;
mod static_peers;
mod trace;

use std::sync::Arc;
use std::time::Duration;

use self::log::{Log, Unsent};
use self::network::Network;
use self::pulse::Pulse;
use self::static_peers::StaticPeers;
use self::trace::Trace;
use super::engine::{Engine, EngineSettings, Opened, Reopen, Unavailable};
use super::send_queue::{MAX_SILENT_CHECKS, SendQueue};
use crate::output::notice::notice;

/// Time that a new participant has to announce itself.
const ANNOUNCE_TIMEOUT: Duration = Duration::from_secs(5);

/// Checks with a changed network before the participant is reopened. An address may disappear for
/// a moment when its lease is renewed.
const MAX_CHANGED_CHECKS: u32 = 2;

pub(super) fn run(
    settings: &Arc<EngineSettings>,
    queue: &Arc<SendQueue>,
    opened: &Opened,
) -> Result<(), Unavailable> {
    let failed = |error| format!("cannot watch DDS: {error}");
    let EngineSettings { discovery, domain, interface, .. } = &**settings;
    let network = Network::current(*interface, discovery);
    let mut peers = discovery.static_peers.clone();
    if network.asks_this_machine(discovery) {
        peers.push("127.0.0.1".to_owned());
    }
    let static_peers = StaticPeers::new(&peers, *domain, *interface)
        .map_err(|error| format!("cannot announce scans to static peers: {error}"))?;
    let (pulse, address) = Pulse::bind(static_peers).map_err(failed)?;
    let (pulse, trace) = (Arc::new(pulse), Trace::start().map_err(failed)?);
    let config = network.config(discovery, address, trace.path());
    let (log, unsent) = Log::start().map_err(failed)?;
    let ended = participant::run(settings, &config, queue, || {
        let first = pulse.first(ANNOUNCE_TIMEOUT).ok_or("DDS does not announce itself")?;
        network.shortage().into_iter().for_each(notice);
        let (settings, pulse) = (Arc::clone(settings), Arc::clone(&pulse));
        let (changed_checks, silent_checks) = (0, 0);
        let dds = Dds { settings, pulse, trace, network, unsent, changed_checks, silent_checks };
        // An error means that the program ends.
        let _ = opened.send(Ok(Box::new(dds)));
        Ok(first)
    });
    // Cyclone's last announcement says that the participant is gone.
    pulse.relay();
    ended.map_err(|error| match (error, log.finish()) {
        (Unavailable::Now(why), Some(line)) if line.contains("participant index") => {
            let text = "too many participants run on this machine, end some of them or choose \
                        another --domain";
            format!("{why}: {line}: {text}").into()
        }
        (Unavailable::Now(why), Some(line)) => format!("{why}: {line}").into(),
        (error, _) => error,
    })
}

struct Dds {
    settings: Arc<EngineSettings>,
    pulse: Arc<Pulse>,
    trace: Trace,
    network: Network,
    /// Unsent packets and unsent announcements.
    unsent: [Unsent; 2],
    changed_checks: u32,
    silent_checks: u32,
}

impl Engine for Dds {
    fn check(&mut self) -> Result<Option<String>, Reopen> {
        let is_silent = self.pulse.relay().is_none();
        self.silent_checks = if is_silent { self.silent_checks + 1 } else { 0 };
        if self.silent_checks > MAX_SILENT_CHECKS {
            return Err(Reopen::Dead("DDS sends nothing any more".to_owned()));
        }
        let network = Network::current(self.settings.interface, &self.settings.discovery);
        let is_changed = self.network.addresses != network.addresses;
        self.changed_checks = if is_changed { self.changed_checks + 1 } else { 0 };
        if self.changed_checks >= MAX_CHANGED_CHECKS {
            return Err(Reopen::Outdated("the network interfaces have changed".to_owned()));
        }
        let [(is_failing, _), (_, has_stopped)] = self.unsent.each_mut().map(Unsent::check);
        if let Some(why) = self.trace.returned() {
            return Err(Reopen::Wanted(why));
        }
        if has_stopped && network.is_up {
            let why = "DDS cannot send, but its network interfaces are up";
            return Err(Reopen::Wanted(why.to_owned()));
        }
        // Readers on this machine still get scans: DDS has no central server.
        let is_alone = self.network.addresses.is_empty();
        let text = if is_alone && self.settings.discovery.is_beyond_this_machine() {
            "this machine is in no network: until it is, only readers on it get scans"
        } else if is_failing {
            "DDS cannot send on some network: readers there get no scans until it can"
        } else {
            let text = "has no address: until it has one, only others get scans";
            let missing = self.pulse.static_peers.missing();
            return Ok(missing.map(|name| format!("the static peer {name} {text}")));
        };
        Ok(Some(text.to_owned()))
    }
}
