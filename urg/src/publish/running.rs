//! Two threads: one runs an engine, which opens, sends and closes. The other one watches it, and
//! runs it again if it stops working. Both block, which zenoh refuses in tokio's runtime.

use std::net::{IpAddr, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::{self as std_mpsc, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use urg_recording::ros::MessageType;

use super::backoff::Backoff;
#[cfg(feature = "dds")]
use super::dds;
use super::engine::{Engine, EngineName, EngineSettings, Outlet, Reopen, Run, Shared, Unavailable};
#[cfg(feature = "foxglove")]
use super::foxglove;
use super::send_queue::SendQueue;
use super::topic::Topic;
#[cfg(feature = "zenoh")]
use super::zenoh;
use crate::failure::Failure;
use crate::output::notice::notice;

const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Pause between two checks of an open engine.
const WATCH_INTERVAL: Duration = Duration::from_millis(500);

/// Maximum number of consecutive restarts. After that, only the user can help.
const MAX_RESTARTS: u32 = 5;

/// Time after which an engine that dies has worked.
const WORKING_TIME: Duration = Duration::from_secs(60);

/// Time for an engine to open: zenoh needs up to 10 s, the system half a minute to look up a name.
const OPEN_TIMEOUT: Duration = Duration::from_secs(180);

/// Time that an engine has to send what waits, and to close.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(if cfg!(test) { 100 } else { 10_000 });

/// The same, if another engine may be opened meanwhile.
const OVERLAP_TIMEOUT: Duration = Duration::from_secs(2);

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
            EngineName::Dds => start(dds::run, settings),
            #[cfg(feature = "zenoh")]
            EngineName::Zenoh => start(zenoh::run, settings),
            #[cfg(feature = "foxglove")]
            EngineName::Foxglove => start(foxglove::run, settings),
            #[cfg(not(all(feature = "dds", feature = "zenoh", feature = "foxglove")))]
            other => {
                let feature = format!("{other:?}").to_lowercase();
                Err(Failure::Usage(format!(
                    "`--engine {feature}` needs an urg that was built with the feature \
                     `{feature}`: `cargo install --path urg --features {feature}`"
                )))
            }
        }
    }

    /// Waits until the engine fails permanently. Cancel-safe.
    pub(crate) async fn failed(&mut self) -> Failure {
        // Unless the thread panics, it ends only with a failure or after `close`.
        let ended = || Failure::Failed("the engine's thread has ended".to_owned());
        self.failures.recv().await.unwrap_or_else(ended)
    }

    /// Removes the nodes from the ROS graph. Gives up if the engine hangs.
    pub(crate) async fn close(mut self) {
        drop(self.stop);
        let ended = async { while self.failures.recv().await.is_some() {} };
        let _ = tokio::time::timeout(2 * CLOSE_TIMEOUT, ended).await;
    }
}

fn start(run: Run, settings: EngineSettings) -> Result<(RunningEngine, Vec<Outlet>), Failure> {
    let topics = settings.topics();
    let shared = Shared::default();
    let scans = topics.iter().filter(|topic| topic.message == MessageType::LASER_SCAN);
    let outlets = scans.map(|topic| Outlet::new(topic, &shared)).collect();
    let (stop, stopped) = std_mpsc::channel();
    let (fail, failures) = mpsc::channel(1);
    let names = match &*settings.nodes {
        [first, .., last] => {
            format!("{} topics, {} to {}", settings.nodes.len(), first.topic, last.topic)
        }
        nodes => nodes.iter().map(|node| node.topic.as_str()).collect(),
    };
    let mut engine = Watched {
        run,
        names,
        away: None,
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
    run: Run,
    settings: Arc<EngineSettings>,
    topics: Arc<[Topic]>,
    shared: Shared,
    stop: std_mpsc::Receiver<()>,
    /// Names of the topics of scans, for the user.
    names: String,
    /// Why the network was away at the last notice; `None` before the first.
    away: Option<Option<String>>,
    restarts: u32,
    backoff: Backoff,
}

impl Watched {
    /// Runs the engine until it is stopped. Reopens it after the network has changed or the
    /// engine has died. The error is permanent: reopening did not help.
    fn run(&mut self) -> Result<(), Failure> {
        while let Some(mut session) = self.open()? {
            *self.shared.write() = Some(Arc::clone(&session.queue));
            let watched = self.watch(&mut session);
            *self.shared.write() = None;
            let is_closed = session.close();
            let Err(reason) = watched else { break };
            self.count(&reason, is_closed)?;
        }
        Ok(())
    }

    /// Retries until the engine opens. `None` if it was stopped meanwhile.
    fn open(&mut self) -> Result<Option<Session>, Failure> {
        loop {
            match self.session() {
                Ok(session) => return Ok(Some(session)),
                Err(Unavailable::Permanently(why)) => return Err(Failure::Failed(why)),
                Err(Unavailable::Now(why)) => {
                    let text = "waiting for it, scans are dropped until then";
                    self.report(Some(format!("{why}; {text}")));
                }
            }
            if self.is_stopped(RETRY_INTERVAL) {
                return Ok(None);
            }
        }
    }

    /// Opens the engine on a thread of its own.
    fn session(&self) -> Result<Session, Unavailable> {
        check_address(self.settings.interface)?;
        let queue = Arc::new(SendQueue::new(&self.topics));
        let (opened, events) = std_mpsc::channel();
        let (run, settings, messages) = (self.run, Arc::clone(&self.settings), Arc::clone(&queue));
        std::thread::Builder::new()
            .name("sender".to_owned())
            .spawn(move || {
                if let Err(why) = run(&settings, &messages, &opened) {
                    // The receiver is gone during shutdown.
                    let _ = opened.send(Err(why));
                }
            })
            .map_err(|error| format!("cannot start the thread that sends: {error}"))?;
        match events.recv_timeout(OPEN_TIMEOUT) {
            Ok(engine) => Ok(Session { engine: engine?, queue, events }),
            // A second engine beside one that hangs would publish twice.
            Err(_) => Err(Unavailable::Permanently("the engine does not open".to_owned())),
        }
    }

    /// Checks the engine at regular intervals, until the user stops it or it has to be reopened.
    fn watch(&mut self, session: &mut Session) -> Result<(), Reopen> {
        let working = Instant::now() + WORKING_TIME;
        loop {
            match session.check() {
                Ok(unreachable) => self.report(unreachable),
                Err(Reopen::Wanted(_)) if !self.backoff.allows(Instant::now()) => {}
                Err(reason) => return Err(reason),
            }
            if Instant::now() > working {
                self.restarts = 0;
            }
            for (index, topic) in self.topics.iter().enumerate() {
                topic.kept.iter().for_each(|message| session.queue.publish(index, message.clone()));
            }
            if self.is_stopped(WATCH_INTERVAL) {
                return Ok(());
            }
            if check_address(self.settings.interface).is_err() {
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

    /// Tells the user that the state of the network has changed.
    fn report(&mut self, unreachable: Option<String>) {
        let before = self.away.replace(unreachable.clone());
        match (before, unreachable) {
            (Some(before), now) if before == now => {}
            (_, Some(why)) => notice(why),
            (Some(_), None) => notice("the network is back: scans are published"),
            (None, None) => {
                notice(format_args!("scans are published on {}; Ctrl-C stops", self.names));
            }
        }
    }

    /// Waits for at most `wait`. Returns true if the engine was stopped meanwhile.
    fn is_stopped(&self, wait: Duration) -> bool {
        !matches!(self.stop.recv_timeout(wait), Err(RecvTimeoutError::Timeout))
    }
}

/// Open engine and its thread.
struct Session {
    engine: Box<dyn Engine>,
    queue: Arc<SendQueue>,
    /// Disconnected when the thread ends.
    events: std_mpsc::Receiver<Result<Box<dyn Engine>, Unavailable>>,
}

impl Session {
    fn check(&mut self) -> Result<Option<String>, Reopen> {
        let dead = |why: &str| Err(Reopen::Dead(why.to_owned()));
        match self.events.try_recv() {
            Err(TryRecvError::Empty) if self.queue.is_stuck() => dead("the engine sends nothing"),
            Err(TryRecvError::Empty) => self.engine.check(),
            _ => dead("the engine has ended"),
        }
    }

    /// Waits until the engine is closed. Returns false if it hangs, unless it may.
    fn close(self) -> bool {
        let may_hang = self.engine.may_overlap();
        self.queue.close();
        let timeout = if may_hang { OVERLAP_TIMEOUT } else { CLOSE_TIMEOUT };
        let end = self.events.recv_timeout(timeout);
        // Otherwise it would send later what waits now.
        self.queue.set_connected(false);
        may_hang || !matches!(end, Err(RecvTimeoutError::Timeout))
    }
}

/// Checks that an interface has the address of `--interface`.
fn check_address(address: Option<IpAddr>) -> Result<(), String> {
    let Some(address) = address else { return Ok(()) };
    // Binding a socket checks the address.
    let bound = UdpSocket::bind((address, 0)).map(drop);
    bound.map_err(|error| format!("cannot use the address {address} of --interface: {error}"))
}

#[cfg(test)]
mod tests {
    use super::super::engine::Opened;
    use super::super::{Discovery, Mode, NodeNames, Qos};
    use super::*;

    /// Engine of the domain: 0 is dead at once, 1 outdated and cannot be closed, 2 never opens.
    struct Faulty(u16);

    fn run(
        settings: &Arc<EngineSettings>,
        queue: &Arc<SendQueue>,
        opened: &Opened,
    ) -> Result<(), Unavailable> {
        if settings.domain == 2 {
            return Err(Unavailable::Permanently("it can never open".to_owned()));
        }
        opened.send(Ok(Box::new(Faulty(settings.domain)))).unwrap();
        while queue.pop().is_some() {}
        if settings.domain == 1 {
            std::thread::sleep(Duration::MAX);
        }
        Ok(())
    }

    impl Engine for Faulty {
        fn check(&mut self) -> Result<Option<String>, Reopen> {
            Err(match self.0 {
                0 => Reopen::Dead("the engine is dead".to_owned()),
                _ => Reopen::Outdated("the network has changed".to_owned()),
            })
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
            let (mut running, outlets) = start(run, settings).unwrap();
            assert_eq!(running.failed().await.line(), line);
            assert_eq!(outlets[0].counts.lock().restarts, restarts, "{line}");
            running.close().await;
        }
    }
}
