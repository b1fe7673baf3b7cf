//! Keeps a session open: connects, recovers or reconnects after a lost link, and restores settings.

use std::any::Any;
use std::future::{Future, poll_fn};
use std::mem::discriminant;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::Poll;

use tokio::time::Instant;

use super::backoff::Backoff;
use super::config::Config;
use super::failure::LinkError;
use super::motor_clock::MotorClock;
use super::open::Opener;
use super::ray_order::RayOrder;
use super::request::{Request, RequestQueue};
use super::schedule::Schedules;
use super::serve::{Service, Stop};
use super::session::Session;
use super::transport::Timer;
use crate::port::AnyConnect;
use crate::state::{Shared, State};
use crate::{Error, ErrorChain, ErrorKind, Operation};

/// Runs the whole driver: opens a session, serves it, and replaces it when it is lost.
pub(crate) struct Supervisor {
    /// Dropped first, so that a caller finds the cause even if the driver never ran.
    offline: OfflineQueue,
    opener: Opener,
    backoff: Backoff,
    config: Config,
    shared: Arc<Shared>,
}

/// Requests and schedules, which outlive each link.
struct OfflineQueue {
    queue: RequestQueue,
    schedules: Schedules,
    shared: Arc<Shared>,
}

impl Supervisor {
    pub(crate) fn new(
        connect: Box<dyn AnyConnect>,
        config: Config,
        queue: RequestQueue,
        shared: Arc<Shared>,
    ) -> Self {
        let opener = Opener::new(connect, config.clone(), Arc::clone(&shared));
        let schedules = Schedules::new(Arc::clone(&shared));
        let offline = OfflineQueue { queue, schedules, shared: Arc::clone(&shared) };
        Self { offline, opener, backoff: Backoff::new(config.backoff), config, shared }
    }

    /// Runs until the driver is closed or abandoned, or the link is lost permanently.
    pub(crate) async fn run(mut self: Box<Self>) -> Result<(), Error> {
        let outcome = catch_panic(pin!(self.supervise())).await;
        match outcome {
            Ok(Stop::Closed(responder)) => {
                self.end(None);
                // The driver is closed even if the caller no longer waits.
                let _ = responder.send(Ok(()));
                Ok(())
            }
            Ok(Stop::Abandoned | Stop::Link(LinkError::Ended(ErrorKind::Closed))) => {
                self.end(None);
                Ok(())
            }
            Ok(Stop::Link(failure)) => {
                let error = self.shared.link.error(failure.kind().clone());
                self.end(Some(&error));
                Err(error)
            }
            Err(payload) => {
                let message = panic_message(&*payload);
                let error = self.shared.link.error(ErrorKind::Panicked { message });
                self.end(Some(&error));
                resume_unwind(payload)
            }
        }
    }

    /// Enters the final state, and ends all streams.
    fn end(&mut self, error: Option<&Error>) {
        self.shared.enter(State::Closed { error: error.cloned() });
        self.offline.schedules.end(error);
    }

    /// Opens, serves and reopens sessions until there is a reason to end.
    async fn supervise(&mut self) -> Stop {
        // The futures for opening and recovering are boxed because they are larger than
        // the one for serving. Inline, they would hold that memory permanently.
        let mut session = match Box::pin(self.open_first()).await {
            Ok(session) => session,
            Err(stop) => return stop,
        };
        loop {
            let since = Instant::now();
            let stop = self.serve(&mut session).await;
            self.backoff.restart_if_outlasted(since.elapsed());
            let next = match stop {
                Stop::Link(LinkError::Silent(kind)) => Box::pin(self.recover(session, kind)).await,
                Stop::Link(LinkError::Lost(kind)) => Box::pin(self.reconnect(session, kind)).await,
                _ => return stop,
            };
            session = match next {
                Ok(session) => session,
                Err(stop) => return stop,
            };
        }
    }

    async fn serve(&mut self, session: &mut Session) -> Stop {
        let baud_rate = session.baud_rate();
        let serial_number = self.opener.serial_number.clone().unwrap_or_default();
        self.shared.enter(State::Connected { baud_rate, streaming: false, serial_number });
        let geometry = self.opener.geometry();
        let scan_time = geometry.revolution();
        let probe_interval = self.config.idle_probe.interval(session.can_die_silently());
        let reconnects = self.shared.counters.lock().stats.reconnects;
        let mut service = Service {
            queue: &mut self.offline.queue,
            laser: &mut self.opener.laser,
            baud_rate: &mut self.opener.baud_rate,
            schedules: &mut self.offline.schedules,
            shared: &self.shared,
            scan_time,
            geometry,
            probe_interval,
            motor_clock: session.shows_motor().then(|| MotorClock::new(scan_time)),
            ray_order: RayOrder::default(),
            reconnects,
            streamed: None,
            streaming: false,
            timer: Timer::default(),
        };
        let Err(stop) = service.run(session).await;
        if matches!(stop, Stop::Closed(_) | Stop::Abandoned) {
            Box::pin(session.stop_stream()).await;
        }
        self.offline.schedules.pause();
        self.offline.queue.lose_link();
        // What is known about the motor belongs to the session.
        self.shared.counters.lock().stats.motor = None;
        stop
    }

    async fn open_first(&mut self) -> Result<Session, Stop> {
        let mut latest: Option<ErrorKind> = None;
        loop {
            // Streams see no error yet; the state has the reason.
            let laser = self.offline.queue.desired.laser;
            let kind = match self.offline.run(None, self.opener.open(laser)).await? {
                Ok(session) => return Ok(session),
                Err(ended @ LinkError::Ended(_)) => return Err(ended.into()),
                Err(failure) => failure.kind().clone(),
            };
            // Give up only if the error repeats: udev may not have set the owner of a new
            // port yet. The wrong sensor may still be replaced by the right one.
            let again = latest.is_some_and(|last| discriminant(&last) == discriminant(&kind));
            // A sensor that was just switched on may refuse to tell what it is.
            let may_pass = kind.is_transient()
                || matches!(kind, ErrorKind::AnotherSensor { .. })
                || matches!(kind, ErrorKind::Refused { operation: Operation::Identify, .. });
            if !self.config.wait_for_sensor || again && !may_pass {
                return Err(LinkError::Lost(kind).into());
            }
            let error = self.shared.link.error(kind.clone());
            self.shared.enter(State::Connecting { error: Some(error) });
            self.offline.run(None, self.opener.back_off(self.backoff.next())).await?;
            latest = Some(kind);
        }
    }

    /// Looks for a silent sensor on the open port. It may have been reset to another baud rate.
    async fn recover(&mut self, mut session: Session, kind: ErrorKind) -> Result<Session, Stop> {
        self.shared.enter(State::Recovering);
        let error = self.shared.link.error(kind.clone());
        let laser = self.offline.queue.desired.laser;
        let search = self.opener.find_again(&mut session, laser);
        let found = self.offline.run(Some(&error), search).await?;
        match found {
            Ok(()) => {
                self.shared.counters.lock().stats.reconnects += 1;
                Ok(session)
            }
            Err(ended @ LinkError::Ended(_)) => Err(ended.into()),
            Err(failure) => {
                let failure = failure.kind();
                tracing::debug!(error = %ErrorChain(failure), "the sensor was not found at any baud rate");
                self.reconnect(session, kind).await
            }
        }
    }

    async fn reconnect(&mut self, session: Session, cause: ErrorKind) -> Result<Session, Stop> {
        // First, because the system cannot reuse the name of a port that is still open.
        self.opener.close(session);
        let kind = match cause {
            ErrorKind::Disconnected { .. } => cause,
            _ => ErrorKind::disconnected(None),
        };
        self.shared.counters.lock().stats.disconnects += 1;
        if !self.config.reconnect {
            return Err(LinkError::Lost(kind).into());
        }
        let error = self.shared.link.error(kind);
        self.offline.schedules.fail_all(&error);
        let since = Instant::now();
        self.shared.enter(State::Disconnected { since, error: error.clone() });
        let mut latest = error;
        loop {
            self.offline.run(Some(&latest), self.opener.back_off(self.backoff.next())).await?;
            let laser = self.offline.queue.desired.laser;
            let error = match self.offline.run(Some(&latest), self.opener.open(laser)).await? {
                Ok(session) => {
                    self.shared.counters.lock().stats.reconnects += 1;
                    return Ok(session);
                }
                Err(ended @ LinkError::Ended(_)) => return Err(ended.into()),
                Err(failure) => self.shared.link.error(failure.kind().clone()),
            };
            let repeats = discriminant(error.kind()) == discriminant(latest.kind());
            if repeats && !error.is_transient() {
                // The error repeats, and waiting cannot cure it: tell the streams.
                self.offline.schedules.fail_all(&error);
            }
            self.shared.enter(State::Disconnected { since, error: error.clone() });
            latest = error;
        }
    }
}

impl OfflineQueue {
    /// Runs `work` while there is no link, and serves the requests that need none. New
    /// schedules begin with `trouble`, if any.
    async fn run<T>(
        &mut self,
        trouble: Option<&Error>,
        work: impl Future<Output = T>,
    ) -> Result<T, Stop> {
        tokio::pin!(work);
        loop {
            tokio::select! {
                biased;
                done = &mut work => return Ok(done),
                request = self.queue.next_unlinked(&self.shared.link) => match request? {
                    Request::Subscribe { window, rate, depth, responder } => {
                        let stream = self.schedules.subscribe(window, rate, depth, trouble, None);
                        // Drops the stream if no caller waits for it.
                        let _ = responder.send(Ok(stream));
                    }
                    Request::Close(responder) => return Err(Stop::Closed(responder)),
                    // Nothing is polled.
                    Request::StreamDropped => {}
                    request => self.queue.wait(request),
                }
            }
        }
    }
}

impl Drop for OfflineQueue {
    /// Enters the final state, and ends all streams with the cause, when the driver is dropped.
    /// Requests need no such end: a caller whose request is dropped looks up the cause itself.
    fn drop(&mut self) {
        if !self.shared.link.is_closed() {
            self.shared.enter(State::Closed { error: None });
        }
        self.schedules.pause();
        let cause = self.shared.link.cause();
        self.schedules.end(Some(&cause));
    }
}

/// Runs `work`, and turns its panic into an output, so that each caller gets it as the cause.
/// Never polls `work` again after a panic; whatever it borrows must tolerate that.
///
/// `std::thread::panicking` is also true while another panic drops the runtime with the driver.
fn catch_panic<T>(
    mut work: Pin<&mut impl Future<Output = T>>,
) -> impl Future<Output = Result<T, Box<dyn Any + Send>>> {
    poll_fn(move |cx| match catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(cx))) {
        Ok(outcome) => outcome.map(Ok),
        Err(payload) => Poll::Ready(Err(payload)),
    })
}

/// Extracts the message of a panic.
fn panic_message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    text.or(payload.downcast_ref::<&str>().copied()).unwrap_or("no message").to_owned()
}
