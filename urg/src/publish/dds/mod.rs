//! DDS engine: one participant with one ROS node per sensor.
//!
//! The participant runs on its own thread, which writes queued messages. Cyclone may block on
//! a full socket, and must not delay the sensors.
//!
//! - `participant` wraps Cyclone DDS.
//! - `discovery_info` tells ROS the writers of each node.
//! - `network` chooses interfaces, and writes Cyclone's configuration.
//! - `log` filters Cyclone's messages.
//! - `neighbours` detects other participants that return after a pause.
//! - `pulse` checks from outside whether the participant is alive.

mod discovery_info;
mod log;
mod neighbours;
mod network;
mod participant;
mod pulse;
mod rtps;

use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::JoinHandle;
use std::time::Duration;

use self::log::Log;
use self::neighbours::{Heard, Neighbours};
use self::network::Network;
use self::participant::{Setup, Write, with_writers};
use self::pulse::Pulse;
use self::rtps::Prefix;
use super::counts::ScanCounts;
use super::discovery::Discovery;
use super::engine::{
    DIAGNOSTICS_TOPIC, Engine, EngineSettings, Health, MessagePublisher, NodePublishers, NodeSpec,
    STATIC_TRANSFORMS_TOPIC,
};
use super::progress::{MAX_SILENT_LOOKS, Progress};
use super::send_queue::SendQueue;

/// Number of diagnostics kept for readers that missed some.
const DIAGNOSTICS_DEPTH: usize = 10;

/// Writers per node: scans and diagnostics.
const NODE_WRITERS: usize = 2;

/// Time that a new participant has to announce itself.
const OPEN_TIMEOUT: Duration = Duration::from_secs(5);

/// Looks between two discovery messages. A reader that forgot this participant has to find it
/// again within 5 s.
const LOOKS_PER_INFO: u32 = 8;

/// Looks at a changed network before the participant is reopened. An address may disappear for
/// a moment when its lease is renewed.
const MAX_CHANGED_LOOKS: u32 = 2;

/// Queued message.
struct DdsMessage {
    payload: Vec<u8>,
    counts: Arc<ScanCounts>,
}

/// State shared by the publishers and the thread.
struct DdsQueue {
    queue: SendQueue<DdsMessage>,
    /// Number of messages taken from the queue.
    taken: AtomicU64,
}

/// Participant with its nodes.
pub(super) struct Dds {
    link: Arc<DdsQueue>,
    thread: JoinHandle<Result<(), String>>,
    pulse: Pulse,
    log: Log,
    neighbours: Neighbours,
    prefix: Prefix,
    nodes: Vec<NodeSpec>,
    has_transforms: bool,
    interface: Option<IpAddr>,
    discovery: Discovery,
    network: Network,
    looks: u32,
    changed_looks: u32,
    silent_looks: u32,
    progress: Progress,
}

impl Engine for Dds {
    type Memory = Heard;

    fn open(
        settings: &EngineSettings,
        specs: &[NodeSpec],
        counts: &[Arc<ScanCounts>],
        heard: &Heard,
    ) -> Result<(Self, Vec<NodePublishers>), String> {
        let pulse = Pulse::bind().map_err(|error| format!("cannot watch DDS: {error}"))?;
        let log = Log::start().map_err(|error| format!("cannot watch DDS: {error}"))?;
        let network = Network::current(settings.interface, &settings.discovery);
        let neighbours = Neighbours::listen(settings.domain, network.used(), heard)
            .map_err(|error| format!("cannot listen to other participants: {error}"))?;
        let transforms = settings.static_transforms();
        let setup = Setup {
            domain: settings.domain,
            config: network.config(&settings.discovery, pulse.address()),
            scan_topics: specs.iter().map(|spec| spec.scan_topic.clone()).collect(),
            diagnostics_topic: DIAGNOSTICS_TOPIC,
            transforms_topic: transforms.is_some().then_some(STATIC_TRANSFORMS_TOPIC),
            qos: settings.qos,
            depth: settings.depth,
            diagnostics_depth: DIAGNOSTICS_DEPTH,
        };
        let depths = specs.iter().flat_map(|_| [settings.depth, DIAGNOSTICS_DEPTH]);
        // The last two topics: discovery information and static transforms.
        let queue = SendQueue::new(depths.chain([1, 1]));
        let link = Arc::new(DdsQueue { queue, taken: AtomicU64::new(0) });
        let (opened, is_open) = mpsc::channel();
        let sending = Arc::clone(&link);
        let thread = std::thread::Builder::new()
            .name("dds".to_owned())
            .spawn(move || {
                with_writers(&setup, |writers| {
                    // An error means that `open` gave up, which closes the queue.
                    let _ = opened.send(());
                    send(&sending, writers);
                })
            })
            .map_err(|error| format!("cannot start the thread of DDS: {error}"))?;
        let opened = is_open.recv_timeout(OPEN_TIMEOUT);
        let prefix = opened.is_ok().then(|| pulse.first(OPEN_TIMEOUT)).flatten();
        let Some(prefix) = prefix else {
            link.queue.close();
            // Joining a thread that hangs would hang too.
            let why = (opened != Err(RecvTimeoutError::Timeout)).then(|| ended(thread)).flatten();
            return Err(why.unwrap_or_else(|| "DDS does not announce itself".to_owned()));
        };
        let publishers = counts
            .iter()
            .zip(0_usize..)
            .map(|(counts, node)| {
                let publisher = |topic, counts| -> Box<dyn MessagePublisher> {
                    Box::new(DdsPublisher { link: Arc::clone(&link), topic, counts })
                };
                NodePublishers {
                    scans: publisher(2 * node, Arc::clone(counts)),
                    // Only scans are counted.
                    diagnostics: publisher(2 * node + 1, Arc::default()),
                }
            })
            .collect();
        let dds = Self {
            link,
            thread,
            pulse,
            log,
            neighbours,
            prefix,
            nodes: specs.to_vec(),
            has_transforms: transforms.is_some(),
            interface: settings.interface,
            discovery: settings.discovery.clone(),
            network,
            looks: 0,
            changed_looks: 0,
            silent_looks: 0,
            progress: Progress::default(),
        };
        dds.announce(&dds.nodes);
        if let Some(payload) = transforms {
            // Cyclone keeps it for late readers.
            let topic = specs.len() * NODE_WRITERS + 1;
            let _ = dds.link.queue.push(topic, DdsMessage { payload, counts: Arc::default() });
        }
        Ok((dds, publishers))
    }

    fn look(&mut self) -> Health {
        self.looks += 1;
        if self.looks.is_multiple_of(LOOKS_PER_INFO) {
            self.announce(&self.nodes);
        }
        if self.thread.is_finished() {
            return Health::Dead("the thread of DDS has ended".to_owned());
        }
        self.silent_looks = if self.pulse.beats() { 0 } else { self.silent_looks + 1 };
        if self.silent_looks > MAX_SILENT_LOOKS {
            return Health::Dead("DDS sends nothing any more".to_owned());
        }
        let taken = self.link.taken.load(Ordering::Relaxed);
        if self.progress.is_stuck(taken, !self.link.queue.is_empty()) {
            return Health::Dead("DDS no longer takes scans".to_owned());
        }
        let network = Network::current(self.interface, &self.discovery);
        self.changed_looks =
            if self.network.differs(&network) { self.changed_looks + 1 } else { 0 };
        if self.neighbours.is_one_back() || self.changed_looks >= MAX_CHANGED_LOOKS {
            return Health::Outdated;
        }
        // Readers on this machine still get scans: DDS has no central server.
        if self.network.is_absent() && self.discovery.is_beyond_this_machine() {
            return Health::Unreachable(
                "this machine is in no network: until it is, only readers on it get scans"
                    .to_owned(),
            );
        }
        if self.log.is_failing() {
            return Health::Unreachable(
                "DDS cannot send on some network: readers there get no scans until it can"
                    .to_owned(),
            );
        }
        Health::Works
    }

    fn close(self) {
        // Removes the nodes immediately; otherwise they stay until the lease expires.
        self.announce(&[]);
        self.link.queue.close();
        let _ = ended(self.thread);
    }
}

impl Dds {
    fn announce(&self, nodes: &[NodeSpec]) {
        let payload = discovery_info::encode(self.prefix, nodes, NODE_WRITERS, self.has_transforms);
        let topic = self.nodes.len() * NODE_WRITERS;
        // May replace an older list in the queue.
        let _ = self.link.queue.push(topic, DdsMessage { payload, counts: Arc::default() });
    }
}

/// Waits until the thread ends. Returns its error.
fn ended(thread: JoinHandle<Result<(), String>>) -> Option<String> {
    match thread.join() {
        Ok(Ok(())) => None,
        Ok(Err(why)) => Some(why),
        Err(_) => Some("the thread of DDS has panicked".to_owned()),
    }
}

fn send(link: &DdsQueue, writers: &[Box<dyn Write + '_>]) {
    while let Some((topic, DdsMessage { payload, counts })) = link.queue.pop() {
        if let Some(writer) = writers.get(topic) {
            match writer.write(payload) {
                Ok(()) => counts.add_published(),
                Err(_) => counts.add_dropped(),
            }
            counts.set_readers(writer.readers());
        }
        link.taken.fetch_add(1, Ordering::Relaxed);
    }
}

struct DdsPublisher {
    link: Arc<DdsQueue>,
    /// Index of the topic in the queue and among the writers.
    topic: usize,
    counts: Arc<ScanCounts>,
}

impl MessagePublisher for DdsPublisher {
    fn publish(&self, payload: Vec<u8>) {
        let counts = Arc::clone(&self.counts);
        if let Some(dropped) = self.link.queue.push(self.topic, DdsMessage { payload, counts }) {
            dropped.counts.add_dropped();
        }
    }
}
