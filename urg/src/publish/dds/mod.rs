//! DDS engine: one participant with one ROS node per sensor.
//!
//! The participant runs on its own thread, which writes queued messages. Cyclone may block on
//! a full socket, and must not delay the sensors.
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
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::JoinHandle;
use std::time::Duration;

use self::log::Log;
use self::network::Network;
use self::pulse::{Prefix, Pulse};
use self::static_peers::StaticPeers;
use self::trace::Trace;
use super::engine::{Engine, EngineSettings, OpenedEngine, Publisher, Reopen, Topic, Unavailable};
use super::names::NodeNames;
use super::send_queue::{MAX_SILENT_CHECKS, SendQueue};
use crate::output::notice::notice;

/// Time that a new participant has to announce itself.
const OPEN_TIMEOUT: Duration = Duration::from_secs(5);

/// Checks with a changed network before the participant is reopened. An address may disappear for
/// a moment when its lease is renewed.
const MAX_CHANGED_CHECKS: u32 = 2;

pub(super) struct Dds {
    settings: Arc<EngineSettings>,
    topics: Arc<[Topic]>,
    queue: Arc<SendQueue>,
    thread: JoinHandle<Result<(), Unavailable>>,
    pulse: Pulse,
    log: Log,
    trace: Trace,
    static_peers: StaticPeers,
    prefix: Prefix,
    network: Network,
    /// Why some readers get no scans until the participant is reopened.
    outdated: Option<String>,
    changed_checks: u32,
    silent_checks: u32,
}

impl Engine for Dds {
    fn open(settings: &Arc<EngineSettings>, topics: &Arc<[Topic]>) -> OpenedEngine {
        let failed = |error| format!("cannot watch DDS: {error}");
        let (pulse, address) = Pulse::bind().map_err(failed)?;
        let (log, trace) = (Log::start().map_err(failed)?, Trace::start().map_err(failed)?);
        let network = Network::current(settings.interface, &settings.discovery);
        let domain = settings.domain;
        let mut peers = settings.discovery.static_peers.clone();
        if network.asks_this_machine(&settings.discovery) {
            peers.push("127.0.0.1".to_owned());
        }
        let static_peers = StaticPeers::new(&peers, domain, settings.interface)
            .map_err(|error| format!("cannot announce scans to static peers: {error}"))?;
        let config = network.config(&settings.discovery, address, trace.path());
        // Of the discovery information, only the last matters.
        let queues = topics.iter().map(Topic::queue).chain([(1, Arc::default())]);
        let queue = Arc::new(SendQueue::new(queues));
        let (opened, is_open) = mpsc::channel();
        let (writing, written) = (Arc::clone(&queue), Arc::clone(topics));
        let thread = std::thread::Builder::new()
            .name("dds".to_owned())
            .spawn(move || {
                participant::run(domain, &config, &written, &writing, || {
                    // An error means that `open` gave up, which closes the queue.
                    let _ = opened.send(());
                })
            })
            .map_err(|error| format!("cannot start the thread of DDS: {error}"))?;
        let opened = is_open.recv_timeout(OPEN_TIMEOUT);
        let first = opened.is_ok().then(|| pulse.first(OPEN_TIMEOUT)).flatten();
        let Some(first) = first else {
            queue.close();
            // Joining a thread that hangs would hang too.
            let has_ended = opened != Err(RecvTimeoutError::Timeout);
            let why = has_ended.then(|| ended(thread)).flatten();
            let why = why.unwrap_or_else(|| "DDS does not announce itself".to_owned().into());
            return Err(match (why, log.finish()) {
                (Unavailable::Now(why), Some(line)) if line.contains("participant index") => {
                    let text = "too many participants run on this machine, end some of them or \
                                choose another --domain";
                    format!("{why}: {line}: {text}").into()
                }
                (Unavailable::Now(why), Some(line)) => format!("{why}: {line}").into(),
                (why, _) => why,
            });
        };
        network.shortage().into_iter().for_each(notice);
        static_peers.announce(&first.bytes);
        let dds = Self {
            settings: Arc::clone(settings),
            topics: Arc::clone(topics),
            queue: Arc::clone(&queue),
            thread,
            pulse,
            log,
            trace,
            static_peers,
            prefix: first.sender,
            network,
            outdated: None,
            changed_checks: 0,
            silent_checks: 0,
        };
        dds.announce(&settings.nodes);
        if let Some(transforms) = topics.iter().position(|topic| topic.is_kept) {
            // Cyclone keeps it for late readers.
            queue.publish(transforms, settings.static_transforms());
        }
        Ok((Box::new(dds), queue))
    }

    fn check(&mut self) -> Result<Option<String>, Reopen> {
        let dead = |why: &str| Err(Reopen::Dead(why.to_owned()));
        if self.thread.is_finished() {
            return dead("the thread of DDS has ended");
        }
        match self.pulse.latest() {
            Some(announcement) => {
                self.silent_checks = 0;
                self.static_peers.announce(&announcement.bytes);
            }
            None => self.silent_checks += 1,
        }
        if self.silent_checks > MAX_SILENT_CHECKS {
            return dead("DDS sends nothing any more");
        }
        if self.queue.is_stuck() {
            return dead("DDS no longer takes scans");
        }
        let network = Network::current(self.settings.interface, &self.settings.discovery);
        let is_changed = self.network.addresses != network.addresses;
        self.changed_checks = if is_changed { self.changed_checks + 1 } else { 0 };
        if self.changed_checks >= MAX_CHANGED_CHECKS {
            return Err(Reopen::Outdated("the network interfaces have changed".to_owned()));
        }
        let (is_failing, _) = (self.log.packets.check(), self.log.announcements.check());
        let deaf = || {
            let is_deaf = self.log.announcements.has_stopped() && network.is_up;
            is_deaf.then(|| "DDS cannot send, but its network interfaces are up".to_owned())
        };
        self.outdated = self.outdated.take().or(self.trace.returned());
        if let Some(why) = self.outdated.clone().or_else(deaf) {
            return Err(Reopen::Wanted(why));
        }
        // Readers on this machine still get scans: DDS has no central server.
        Ok(
            if self.network.addresses.is_empty() && self.settings.discovery.is_beyond_this_machine()
            {
                let text =
                    "this machine is in no network: until it is, only readers on it get scans";
                Some(text.to_owned())
            } else if is_failing {
                let text =
                    "DDS cannot send on some network: readers there get no scans until it can";
                Some(text.to_owned())
            } else {
                self.static_peers.missing().map(|name| {
                format!(
                    "the static peer {name} has no address: until it has one, only others get scans"
                )
            })
            },
        )
    }

    fn close(self: Box<Self>) {
        // Removes the nodes immediately; otherwise they stay until the lease expires.
        self.announce(&[]);
        self.queue.close();
        let _ = ended(self.thread);
        // Cyclone's last announcement says that the participant is gone.
        if let Some(announcement) = self.pulse.latest() {
            self.static_peers.announce(&announcement.bytes);
        }
    }
}

impl Dds {
    /// Tells ROS the nodes and their writers. Replaces an older list in the queue.
    fn announce(&self, nodes: &[NodeNames]) {
        let info = discovery_info::encode(self.prefix, nodes, &self.topics);
        self.queue.publish(self.topics.len(), info);
    }
}

/// Waits until the thread ends. Returns its error.
fn ended(thread: JoinHandle<Result<(), Unavailable>>) -> Option<Unavailable> {
    thread.join().unwrap_or_else(|_| Err("the thread of DDS has panicked".to_owned().into())).err()
}
