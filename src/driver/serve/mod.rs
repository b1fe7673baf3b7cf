//! Serves an open session: requests, settings and polls in turn.

mod polls;
mod settings;
mod streamed;

use std::convert::Infallible;
use std::future::poll_fn;
use std::task::Poll;
use std::time::Duration;

use tokio::time::Instant;

use self::settings::is_unplugged;
use super::failure::{ExchangeError, LinkError};
use super::laser::Laser;
use super::motor_clock::MotorClock;
use super::rarely::rarely;
use super::ray_order::RayOrder;
use super::request::{Abandoned, Request, RequestQueue, Responder};
use super::schedule::Schedules;
use super::session::Session;
use super::transport::Timer;
use crate::state::{Shared, State};
use crate::{BaudRate, ErrorKind, Geometry};

/// Why a session is no longer served.
#[derive(Debug)]
pub(crate) enum Stop {
    /// A handle asked to close the driver.
    Closed(Responder<()>),
    /// All handles and streams are gone.
    Abandoned,
    /// The link failed.
    Link(LinkError),
}

impl From<LinkError> for Stop {
    fn from(failure: LinkError) -> Self {
        Self::Link(failure)
    }
}

impl From<Abandoned> for Stop {
    fn from(Abandoned: Abandoned) -> Self {
        Self::Abandoned
    }
}

/// What is served next, one after another.
#[derive(Debug, Clone, Copy)]
enum Turn {
    Request,
    Setting,
    Poll,
}

impl Turn {
    const ALL: [Self; 3] = [Self::Request, Self::Setting, Self::Poll];

    fn next(self) -> Self {
        match self {
            Self::Request => Self::Setting,
            Self::Setting => Self::Poll,
            Self::Poll => Self::Request,
        }
    }
}

/// Everything needed to serve, besides the session.
pub(crate) struct Service<'a> {
    pub(crate) queue: &'a mut RequestQueue,
    pub(crate) schedules: &'a mut Schedules,
    pub(crate) laser: &'a mut Laser,
    /// Baud rate to restore.
    pub(crate) baud_rate: &'a mut Option<BaudRate>,
    pub(crate) shared: &'a Shared,
    pub(crate) scan_time: Duration,
    pub(crate) geometry: Geometry,
    /// Silence after which an idle link is probed, if it is.
    pub(crate) probe_interval: Option<Duration>,
    /// On the sensor's own USB port.
    pub(crate) motor_clock: Option<MotorClock>,
    pub(crate) ray_order: RayOrder,
    /// Number of times the sensor had been found again before this session.
    pub(crate) reconnects: u64,
    /// Number of scans left out after each one, while scans come that are not polled.
    pub(crate) streamed: Option<u8>,
    /// True if scans are polled, as the state reports it.
    pub(crate) streaming: bool,
    /// Wakes the driver for the next poll, probe or attempt.
    pub(crate) timer: Timer,
}

impl Service<'_> {
    /// Serves until there is a reason to stop. Requests, settings and polls take turns: none starves.
    pub(crate) async fn run(&mut self, session: &mut Session) -> Result<Infallible, Stop> {
        self.schedules.end_stream();
        self.schedules.resolve(&self.geometry);
        self.schedules.resume(Instant::now());
        self.check_baud_rate(session.baud_rate());
        let mut latest = Turn::Poll;
        'turns: loop {
            // Only bytes from the sensor show that the link is alive: some requests work without it.
            let now = Instant::now();
            let heard = session.heard_at();
            // A stream shows it by itself, and a probe would end it.
            let interval = self.probe_interval.filter(|_| !session.is_streaming());
            let probe = interval.zip(heard).map(|(interval, heard)| heard + interval);
            // The next command would begin with a probe anyway. Now there may be time for it.
            if session.needs_probe() || probe.is_some_and(|due| due <= now) {
                let outcome = rarely(|| self.probe(session)).await;
                ignore_command_errors(outcome)?;
            }
            let has_setting = self.has_setting();
            if has_setting && self.laser.retry_at.is_none() {
                // A setting that is younger than the session comes before all polls.
                rarely(|| self.apply_laser(session)).await?;
            }
            self.check_stream(session);
            let polling = !self.schedules.is_empty() && !self.laser.is_off;
            self.publish_streaming(polling, session);
            let due = self.schedules.next_due().filter(|_| polling);
            let poll_is_due = due.is_some_and(|due| due <= now);
            for _ in Turn::ALL {
                latest = latest.next();
                let is_served = match latest {
                    Turn::Request => match self.queue.pop()? {
                        Some(request) => rarely(|| self.serve(session, *request)).await?,
                        None => false,
                    },
                    Turn::Setting if has_setting => rarely(|| self.apply_setting(session)).await?,
                    Turn::Poll if poll_is_due || session.is_streaming() => {
                        self.poll_due(session, now).await?
                    }
                    Turn::Setting | Turn::Poll => false,
                };
                if is_served {
                    continue 'turns;
                }
            }
            let wake = [due, probe, self.laser.retry_at].into_iter().flatten().min();
            poll_fn(|cx| {
                if let Poll::Ready(outcome) = session.poll_unasked(cx) {
                    return Poll::Ready(outcome.map_err(Stop::from));
                }
                if let Poll::Ready(outcome) = self.queue.poll_ready(cx) {
                    return Poll::Ready(outcome.map_err(Stop::from));
                }
                wake.map_or(Poll::Pending, |wake| self.timer.poll(cx, wake).map(Ok))
            })
            .await?;
        }
    }

    /// Probes the sensor. If a reset has switched its laser on, which should be off, switches it off.
    async fn probe(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        if session.probe().await? && self.laser.is_off {
            self.switch_laser(session, false, true).await?;
        }
        Ok(())
    }

    /// Delivers the scans that came before a request, answers it, and returns true: there was work.
    async fn serve(&mut self, session: &mut Session, request: Request) -> Result<bool, Stop> {
        self.deliver_waiting(session)?;
        self.answer(session, request).await?;
        // A stream may have been dropped since the last request.
        self.schedules.drop_unread();
        if self.schedules.stream(self.scan_time).is_none() {
            session.streams().iter_mut().for_each(|it| it.allow_gap());
        }
        Ok(true)
    }

    async fn answer(&mut self, session: &mut Session, request: Request) -> Result<(), Stop> {
        match request {
            Request::Link(responder) => Self::respond(responder, Ok(())),
            Request::State(responder) => {
                let outcome = Box::pin(session.state()).await;
                Self::respond(responder, outcome)
            }
            Request::Laser { on, responder } => {
                let outcome = self.switch_laser(session, on, false).await;
                Self::respond(responder, outcome)
            }
            Request::BaudRate { baud_rate, responder } => {
                let outcome = self.change_baud_rate(session, baud_rate).await;
                let desired = &mut self.queue.desired.baud_rate;
                *desired =
                    desired.filter(|desired| *desired != baud_rate || is_unplugged(&outcome));
                Self::respond(responder, outcome)
            }
            Request::Reboot(responder) => {
                let outcome = Box::pin(session.reboot()).await;
                let restarts = outcome.is_ok();
                if restarts {
                    // Before the caller can wait for the sensor to be connected again.
                    self.shared.enter(State::Recovering);
                }
                Self::respond(responder, outcome)?;
                // Looks for it, and gives it the desired settings again.
                let silent = LinkError::Silent(ErrorKind::disconnected(None));
                if restarts { Err(silent.into()) } else { Ok(()) }
            }
            Request::Scan { window, responder } => {
                let outcome = self.scan(session, window).await;
                Self::respond(responder, outcome)
            }
            Request::Subscribe { window, rate, depth, responder } => {
                // Drops the stream if no caller waits for it.
                let geometry = Some(&self.geometry);
                let stream = self.schedules.subscribe(window, rate, depth, None, geometry);
                let _ = responder.send(Ok(stream));
                Ok(())
            }
            Request::Close(responder) => Err(Stop::Closed(responder)),
            Request::StreamDropped => Ok(()),
        }
    }

    /// Answers a request. Also returns a reason to stop if the line failed.
    fn respond<T>(responder: Responder<T>, outcome: Result<T, ExchangeError>) -> Result<(), Stop> {
        let (answer, stop) = match outcome {
            Ok(answer) => (Ok(answer), Ok(())),
            Err(failure) => match command_error(failure) {
                Ok(kind) => (Err(kind), Ok(())),
                Err(failure) => (Err(failure.kind().clone()), Err(failure.into())),
            },
        };
        // Drops the answer if no caller waits for it.
        let _ = responder.send(answer);
        stop
    }

    /// Updates the state only on a change: a user may hold a borrow of it. No scan is lost across one.
    fn publish_streaming(&mut self, now: bool, session: &mut Session) {
        if std::mem::replace(&mut self.streaming, now) != now {
            self.shared.link.set_streaming(now);
            session.streams().iter_mut().for_each(|streams| streams.allow_gap());
        }
    }
}

/// Separates the error of a command from the failure of the link.
fn command_error(failure: ExchangeError) -> Result<ErrorKind, LinkError> {
    match failure {
        ExchangeError::Command(kind) => Ok(kind),
        ExchangeError::Link(failure) => Err(failure),
    }
}

fn ignore_command_errors(outcome: Result<(), ExchangeError>) -> Result<(), Stop> {
    outcome.or_else(|failure| Ok(command_error(failure).map(drop)?))
}
