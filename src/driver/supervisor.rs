//! Keeps a session open: connects, and whenever the link is lost recovers or
//! reconnects, with what the service had asked for restored.

use std::future::Future;
use std::mem::discriminant;
use std::sync::Arc;

use tokio::time::{Instant, sleep};

use super::backoff::Backoff;
use super::config::Config;
use super::laser::LaserRecovery;
use super::open::Opener;
use super::poll_timer::PollTimer;
use super::request::{RequestQueue, Unlinked};
use super::schedule::Schedules;
use super::serve::{Service, Stop};
use super::session::Session;
use crate::Error;
use crate::observer::ReplyObserver;
use crate::port::AnyConnect;
use crate::state::{State, Telemetry};

/// The whole driver: opens a session, serves it, and replaces it when it is lost.
pub(crate) struct Supervisor {
    /// Declared first, so dropped first: who waits for a driver that is dropped, even
    /// one that never ran, gets the cause.
    _closing: Closing,
    opener: Opener,
    offline: OfflineQueue,
    backoff: Backoff,
    config: Config,
    telemetry: Arc<Telemetry>,
}

/// The requests and schedules, which are served with and without a link.
struct OfflineQueue {
    queue: RequestQueue,
    schedules: Schedules,
    telemetry: Arc<Telemetry>,
}

impl Supervisor {
    pub(crate) fn new(
        connect: Box<dyn AnyConnect>,
        config: Config,
        queue: RequestQueue,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let opener = Opener::new(connect, config.clone(), Arc::clone(&telemetry));
        let schedules = Schedules::default();
        let offline = OfflineQueue { queue, schedules, telemetry: Arc::clone(&telemetry) };
        Self {
            _closing: Closing {
                telemetry: Arc::clone(&telemetry),
                observer: config.observer.clone(),
            },
            opener,
            offline,
            backoff: Backoff::new(config.backoff, config.seed()),
            config,
            telemetry,
        }
    }

    /// Runs until the driver is closed or abandoned, or the link is lost for good.
    pub(crate) async fn run(mut self) -> Result<(), Error> {
        let (error, responder) = match self.supervise().await {
            Stop::Closed(responder) => (None, Some(responder)),
            Stop::Abandoned | Stop::Ended(Error::Closed) => (None, None),
            Stop::Silent(error) | Stop::Lost(error) | Stop::Ended(error) => (Some(error), None),
        };
        self.telemetry.enter(State::Closed { error: error.clone() });
        self.offline.schedules.end(error.as_ref());
        if let Some(responder) = responder {
            // The driver is closed even if the caller no longer waits.
            let _ = responder.send(Ok(()));
        }
        error.map_or(Ok(()), Err)
    }

    /// Returns why the driver has to end.
    async fn supervise(&mut self) -> Stop {
        // Boxed are the futures that only opening and recovering need: they are larger
        // than that of serving, which would keep their room for good.
        let mut session = match Box::pin(self.open_first()).await {
            Ok(session) => session,
            Err(stop) => return stop,
        };
        loop {
            let since = Instant::now();
            let stop = self.serve(&mut session).await;
            self.backoff.note_uptime(since.elapsed());
            let next = match stop {
                Stop::Closed(_) | Stop::Abandoned | Stop::Ended(_) => return stop,
                Stop::Silent(error) => Box::pin(self.recover(session, error)).await,
                Stop::Lost(error) => Box::pin(self.reconnect(session, error)).await,
            };
            session = match next {
                Ok(session) => session,
                Err(stop) => return stop,
            };
        }
    }

    async fn serve(&mut self, session: &mut Session) -> Stop {
        let baud_rate = session.baud_rate();
        let serial_number = self.opener.serial_number();
        self.telemetry.enter(State::Connected { baud_rate, streaming: false, serial_number });
        let scan_time = self.opener.scan_time();
        let idle_probe = self.config.idle_probe.interval(session.can_die_silently());
        let reconnects = self.telemetry.stats().reconnects;
        let mut service = Service {
            queue: &mut self.offline.queue,
            schedules: &mut self.offline.schedules,
            wanted: self.opener.wanted(),
            telemetry: &self.telemetry,
            scan_time,
            idle_probe,
            reconnects,
            laser_recovery: LaserRecovery::new(self.config.seed()),
            poll_timer: PollTimer::default(),
        };
        service.run(session).await
    }

    async fn open_first(&mut self) -> Result<Session, Stop> {
        let mut latest: Option<Error> = None;
        loop {
            let error = match self.offline.attend(latest.as_ref(), self.opener.open()).await? {
                Ok(session) => return Ok(session),
                Err(error) => error,
            };
            // udev may not have set the owner of a port yet: fails only if the
            // error repeats. Another sensor may be replaced by the right one.
            let again = latest.is_some_and(|last| discriminant(&last) == discriminant(&error));
            let may_pass = error.is_transient() || matches!(error, Error::AnotherSensor { .. });
            if !self.config.wait_for_sensor || again && !may_pass {
                return Err(Stop::Lost(error));
            }
            self.telemetry.enter(State::Connecting { error: Some(error.clone()) });
            self.offline.attend(Some(&error), sleep(self.backoff.next())).await?;
            latest = Some(error);
        }
    }

    /// Looks for a silent sensor on the port that is open; it may have been
    /// reset, and speak at another speed.
    async fn recover(&mut self, mut session: Session, error: Error) -> Result<Session, Stop> {
        self.telemetry.enter(State::Recovering);
        let found = self.offline.attend(Some(&error), self.opener.find_again(&mut session)).await?;
        match found {
            Ok(()) => {
                self.telemetry.stats().reconnects += 1;
                Ok(session)
            }
            Err(cause) => {
                tracing::debug!(error = %cause.chain(), "the sensor was not found at any baud rate");
                self.reconnect(session, error).await
            }
        }
    }

    async fn reconnect(&mut self, session: Session, cause: Error) -> Result<Session, Stop> {
        // First: the system cannot reuse the name of a port that is still open.
        self.opener.close(session);
        let error = match cause {
            Error::Disconnected { .. } => cause,
            _ => Error::disconnected(None),
        };
        let error = error.named(self.telemetry.name());
        self.telemetry.stats().disconnects += 1;
        if !self.config.reconnect {
            return Err(Stop::Lost(error));
        }
        self.offline.schedules.fail_all(&error);
        self.offline.schedules.note(&self.telemetry);
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
                // An error that repeats and cannot pass by itself is reported.
                self.offline.schedules.fail_all(&error);
            }
            latest = error;
        }
    }
}

impl OfflineQueue {
    /// Runs `work` while there is no link, and serves the requests that need none.
    async fn attend<T>(
        &mut self,
        trouble: Option<&Error>,
        work: impl Future<Output = T>,
    ) -> Result<T, Stop> {
        tokio::pin!(work);
        loop {
            tokio::select! {
                biased;
                done = &mut work => return Ok(done),
                request = self.queue.next_unlinked() => match request {
                    Ok(Unlinked::Subscribe { window, rate, depth, responder }) => {
                        let stream = self.schedules.subscribe(window, rate, depth, trouble);
                        // If nobody waits for it, this drops the stream.
                        let _ = responder.send(Ok(stream));
                    }
                    Ok(Unlinked::Close(responder)) => return Err(Stop::Closed(responder)),
                    Err(_) => return Err(Stop::Abandoned),
                }
            }
        }
    }
}

impl Drop for OfflineQueue {
    /// Ends all streams with the cause, when the driver is dropped. Requests need none:
    /// whoever waits for the answer to one that is dropped looks for the cause.
    fn drop(&mut self) {
        let cause = self.telemetry.cause();
        self.schedules.end(Some(&cause));
    }
}

/// Enters the last state when a driver is dropped, so that nobody waits for another.
struct Closing {
    telemetry: Arc<Telemetry>,
    observer: ReplyObserver,
}

impl Drop for Closing {
    fn drop(&mut self) {
        if self.telemetry.is_closed() {
            return;
        }
        let error = std::thread::panicking().then(|| {
            let elsewhere = || "its message is on standard error".to_owned();
            Error::Panicked { message: self.observer.panic_message().unwrap_or_else(elsewhere) }
        });
        self.telemetry.enter(State::Closed { error });
    }
}
