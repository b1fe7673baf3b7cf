//! Keeps a session open: connects, and whenever the link is lost recovers or
//! reconnects, with what the service had asked for restored.

use std::future::Future;
use std::mem::discriminant;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::Config;
use super::open::Opener;
use super::request::{Promise, RequestQueue, Unlinked};
use super::schedule::Schedules;
use super::serve::{Service, Stop};
use super::session::Session;
use crate::Error;
use crate::port::Connect;
use crate::state::{State, Telemetry};

/// The whole driver.
pub(crate) struct Supervisor<C> {
    /// The first to go when a driver is dropped, even one that never ran: those
    /// who wait find out why.
    _closing: Closing,
    opener: Opener<C>,
    offline: OfflineQueue,
    backoff: Backoff,
    config: Config,
    telemetry: Arc<Telemetry>,
}

/// What is served whether there is a link or not.
struct OfflineQueue {
    queue: RequestQueue,
    schedules: Schedules,
}

/// Why a driver ends.
enum End {
    Closed(Option<Promise<()>>),
    Failed(Error),
}

impl<C: Connect> Supervisor<C> {
    pub(crate) fn new(
        connect: C,
        config: Config,
        queue: RequestQueue,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let opener = Opener::new(connect, config.clone(), Arc::clone(&telemetry));
        let schedules = Schedules::new(config.ring_depth);
        Self {
            _closing: Closing(Arc::clone(&telemetry)),
            opener,
            offline: OfflineQueue { queue, schedules },
            backoff: Backoff::new(&config),
            config,
            telemetry,
        }
    }

    /// Runs until the driver is closed, abandoned, or out of luck.
    pub(crate) async fn run(mut self) -> Result<(), Error> {
        let (error, promise) = match self.supervise().await {
            End::Closed(promise) => (None, promise),
            End::Failed(error) => (Some(error), None),
        };
        self.telemetry.enter(State::Closed { error: error.clone() });
        self.offline.schedules.end(error.as_ref());
        self.offline.queue.end(error.as_ref().unwrap_or(&Error::Closed));
        if let Some(promise) = promise {
            // Nobody waits any more: it is closed all the same.
            let _ = promise.send(Ok(()));
        }
        error.map_or(Ok(()), Err)
    }

    async fn supervise(&mut self) -> End {
        let mut session = match self.open_first().await {
            Ok(session) => session,
            Err(end) => return end,
        };
        loop {
            let since = Instant::now();
            let stop = self.serve(&mut session).await;
            self.backoff.lasted(since.elapsed());
            let next = match stop {
                Stop::Closed(promise) => return End::Closed(Some(promise)),
                Stop::Abandoned => return End::Closed(None),
                Stop::Silent(error) => self.recover(session, error).await,
                Stop::Lost(error) => self.reconnect(session, error).await,
            };
            session = match next {
                Ok(session) => session,
                Err(end) => return end,
            };
        }
    }

    async fn serve(&mut self, session: &mut Session) -> Stop {
        let baud_rate = session.baud_rate();
        self.telemetry.enter(State::Connected { baud_rate, streaming: false });
        let scan_time = self.opener.scan_time();
        let mut service = Service {
            queue: &mut self.offline.queue,
            schedules: &mut self.offline.schedules,
            wanted: self.opener.wanted(),
            telemetry: &self.telemetry,
            scan_time,
        };
        service.run(session).await
    }

    async fn open_first(&mut self) -> Result<Session, End> {
        let mut latest = None;
        loop {
            let error = match self.offline.attend(None, self.opener.open()).await? {
                Ok(session) => return Ok(session),
                Err(error) => error,
            };
            // A port that has just appeared may be nobody's for a moment, until
            // the system has set its owner: only twice is for good.
            let again = latest.replace(discriminant(&error)) == Some(discriminant(&error));
            if !self.config.wait_for_sensor || again && !error.is_transient() {
                return Err(End::Failed(error));
            }
            self.telemetry.enter(State::Connecting { error: Some(error) });
            self.offline.attend(None, sleep(self.backoff.next())).await?;
        }
    }

    /// Looks for a silent sensor on the port that is open; it may have been
    /// reset, and speak at another speed.
    async fn recover(&mut self, mut session: Session, error: Error) -> Result<Session, End> {
        self.telemetry.enter(State::Recovering);
        let found = self.offline.attend(Some(&error), self.opener.find_again(&mut session)).await?;
        match found {
            Ok(()) => {
                self.telemetry.stats().reconnects += 1;
                Ok(session)
            }
            Err(cause) => {
                tracing::debug!(%cause, "not found");
                self.reconnect(session, error).await
            }
        }
    }

    async fn reconnect(&mut self, session: Session, cause: Error) -> Result<Session, End> {
        // First, or the system could not give the port the same name again.
        self.opener.close(session);
        let error = match cause {
            Error::Disconnected { .. } => cause,
            _ => Error::disconnected(None),
        };
        self.telemetry.stats().disconnects += 1;
        if !self.config.reconnect {
            return Err(End::Failed(error));
        }
        self.offline.schedules.fail_all(&error);
        self.offline.schedules.note(&mut self.telemetry.stats().schedules);
        let since = Instant::now();
        self.telemetry.enter(State::Disconnected { since, error: error.clone() });
        let mut latest = error;
        loop {
            self.offline.attend(Some(&latest), sleep(self.backoff.next())).await?;
            let error = match self.offline.attend(Some(&latest), self.opener.open()).await? {
                Ok(session) => {
                    self.telemetry.stats().reconnects += 1;
                    return Ok(session);
                }
                Err(error) => error,
            };
            if discriminant(&error) != discriminant(&latest) {
                self.telemetry.enter(State::Disconnected { since, error: error.clone() });
            } else if !error.is_transient() {
                // What does not get better by itself is told.
                self.offline.schedules.fail_all(&error);
            }
            latest = error;
        }
    }
}

impl OfflineQueue {
    /// Does `work` while there is no link, and serves what needs none.
    async fn attend<T>(
        &mut self,
        trouble: Option<&Error>,
        work: impl Future<Output = T>,
    ) -> Result<T, End> {
        tokio::pin!(work);
        loop {
            tokio::select! {
                biased;
                done = &mut work => return Ok(done),
                request = self.queue.next_unlinked() => match request {
                    Ok(Unlinked::Subscribe { window, rate, promise }) => {
                        // A stream that nobody took is a stream that was dropped.
                        let _ = promise.send(Ok(self.schedules.subscribe(window, rate, trouble)));
                    }
                    Ok(Unlinked::Close(promise)) => return Err(End::Closed(Some(promise))),
                    Err(_) => return Err(End::Closed(None)),
                }
            }
        }
    }
}

/// Sees to it that nobody waits for a driver that is gone.
struct Closing(Arc<Telemetry>);

impl Drop for Closing {
    fn drop(&mut self) {
        if !self.0.is_closed() {
            self.0.enter(State::Closed { error: None });
        }
    }
}

/// Ever longer waits, each a little off, so that many drivers that lost a bus
/// together do not come back together.
struct Backoff {
    shortest: Duration,
    longest: Duration,
    next: Duration,
    seed: u64,
}

impl Backoff {
    fn new(config: &Config) -> Self {
        let (shortest, longest) = config.backoff;
        Self { shortest, longest, next: shortest, seed: config.seed() }
    }

    /// A link was there for so long. One that comes and goes is not reopened
    /// in a hurry: only what outlasts the next wait begins anew.
    fn lasted(&mut self, up: Duration) {
        if up > self.next {
            self.next = self.shortest;
        }
    }

    fn next(&mut self) -> Duration {
        // A step of a linear congruential generator; its upper bits are good.
        self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let jitter = 1.0 + 0.1 * (self.seed >> 40) as f64 / f64::from(1 << 24);
        let wait = self.next;
        self.next = (wait * 2).min(self.longest);
        wait.mul_f64(jitter)
    }
}
