//! An open session at work: requests and polls in turn.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::baud_rate;
use super::exchange::{ExchangeError, Timing};
use super::laser::{LaserRecovery, Refusal, set_laser};
use super::open::Wanted;
use super::poll_timer::PollTimer;
use super::rate_meter::Shortfall;
use super::request::{Abandoned, Request, RequestQueue, Responder};
use super::schedule::{Delivered, DuePoll, Schedules};
use super::session::{Polled, Session};
use crate::protocol::Status;
use crate::scan::{Scan, ScanMeta};
use crate::state::{ScheduleStats, Telemetry};
use crate::{Error, Window};

/// The reason for which a session is served no longer.
#[derive(Debug)]
pub(crate) enum Stop {
    /// A handle asked for it.
    Closed(Responder<()>),
    /// All handles and streams are gone.
    Abandoned,
    /// The sensor does not answer any more.
    Silent(Error),
    /// The link is lost: the port is of no use any more.
    Lost(Error),
    /// The port has ended, and no other one can follow: [`Error::Closed`], or the
    /// error with which it ended.
    Ended(Error),
}

impl Stop {
    /// Returns the error for the request that was being served.
    fn cause(&self) -> Error {
        match self {
            Self::Silent(error) | Self::Lost(error) | Self::Ended(error) => error.clone(),
            Self::Closed(_) | Self::Abandoned => Error::Closed,
        }
    }
}

impl From<Abandoned> for Stop {
    fn from(Abandoned: Abandoned) -> Self {
        Self::Abandoned
    }
}

/// Everything that serving needs besides the session.
pub(crate) struct Service<'a> {
    pub(crate) queue: &'a mut RequestQueue,
    pub(crate) schedules: &'a mut Schedules,
    pub(crate) wanted: &'a mut Wanted,
    pub(crate) telemetry: &'a Telemetry,
    pub(crate) scan_time: Duration,
    /// The time without an exchange after which a fence is raised.
    pub(crate) idle_probe: Option<Duration>,
    /// The number of times the sensor was found again before this session.
    pub(crate) reconnects: u64,
    pub(crate) laser_recovery: LaserRecovery,
    pub(crate) poll_timer: PollTimer,
}

impl Service<'_> {
    /// Serves until there is a reason to stop.
    pub(crate) async fn run(&mut self, session: &mut Session) -> Stop {
        self.schedules.resume(Instant::now());
        let mut request_served = false;
        loop {
            let outcome = self.turn(session, &mut request_served).await;
            if let Err(stop) = outcome {
                return stop;
            }
        }
    }

    /// Serves one request or one poll, or waits for either. They alternate when both
    /// are due, so that neither can starve the other.
    async fn turn(&mut self, session: &mut Session, request_served: &mut bool) -> Result<(), Stop> {
        // A fence now, while nothing else is due, does not delay the next poll.
        if session.is_dirty() {
            let outcome = self.resynchronise(session).await;
            self.ignore_command_errors(outcome)?;
        }
        let polling = !self.schedules.is_empty() && self.wanted.laser != Some(false);
        self.telemetry.set_streaming(polling);
        let due = self.schedules.next_due().filter(|_| polling);
        let poll_is_due = due.is_some_and(|due| due <= Instant::now());
        if !(*request_served && poll_is_due)
            && let Some(request) = self.queue.pop()?
        {
            *request_served = true;
            return self.answer(session, request).await;
        }
        *request_served = false;
        if poll_is_due {
            return self.poll_due(session).await;
        }
        let probe = self.idle_probe.map(|interval| Instant::now() + interval);
        let wake = due.into_iter().chain(probe).min();
        let next = self.schedules.due_after_next().filter(|_| polling);
        tokio::select! {
            biased;
            outcome = session.idle() => self.ignore_command_errors(outcome)?,
            outcome = self.queue.ready() => outcome?,
            () = self.poll_timer.wait(wake.unwrap_or_else(Instant::now), next), if wake.is_some() => {
                if wake == probe {
                    // The fence is raised at the next turn.
                    session.mark_dirty();
                }
            }
        }
        Ok(())
    }

    /// Raises a fence. If it is answered with a distance while the laser should
    /// be off, the sensor was reset: its laser is switched off again.
    async fn resynchronise(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        let status = session.settle().await?;
        if self.wanted.laser == Some(false) && status.is_some_and(Status::is_ok) {
            set_laser(session, false).await?;
        }
        Ok(())
    }

    async fn answer(&mut self, session: &mut Session, request: Request) -> Result<(), Stop> {
        match request {
            Request::Version(responder) => {
                // It was read when the sensor was found.
                let known = self.telemetry.version().ok_or(Error::Closed);
                let _ = responder.send(known);
                Ok(())
            }
            Request::Laser { on, responder } => {
                // Also if it fails: what was asked for is restored whenever the
                // sensor is found again.
                self.wanted.laser = Some(on);
                let outcome = set_laser(session, on).await;
                if on {
                    self.schedules.resume(Instant::now());
                } else {
                    self.telemetry.stats().failed(&Error::LaserOff);
                }
                self.respond(responder, outcome)
            }
            Request::BaudRate { baud_rate, responder } => {
                let mut outcome = baud_rate::change(session, baud_rate).await;
                if outcome.is_ok() {
                    self.wanted.baud_rate = Some(baud_rate);
                    if self.wanted.laser == Some(false) {
                        // The sensor may have restarted unseen.
                        outcome = set_laser(session, false).await;
                    }
                }
                self.telemetry.set_baud_rate(session.baud_rate());
                self.respond(responder, outcome)
            }
            Request::Scan { window, responder } => {
                let outcome = self.scan(session, window).await;
                self.respond(responder, outcome)
            }
            Request::Subscribe { window, rate, depth, responder } => {
                // If nobody waits for it, this drops the stream.
                let _ = responder.send(Ok(self.schedules.subscribe(window, rate, depth, None)));
                self.note_schedules();
                Ok(())
            }
            Request::Close(responder) => Err(Stop::Closed(responder)),
        }
    }

    async fn scan(&mut self, session: &mut Session, window: Window) -> Result<Scan, ExchangeError> {
        if self.wanted.laser == Some(false) {
            return Err(ExchangeError::Command(Error::LaserOff));
        }
        let mut tries = 2;
        loop {
            tries -= 1;
            let mut values = Arc::default();
            match self.poll(session, window, &mut values).await {
                Ok(Polled { timing, first }) => {
                    return Ok(Scan::new(window, values, first, self.meta(timing)));
                }
                Err(ExchangeError::Command(Error::Timeout { .. } | Error::Malformed { .. }))
                    if tries > 0 && !self.telemetry.is_closing() => {}
                Err(failure) => return Err(failure),
            }
        }
    }

    async fn poll_due(&mut self, session: &mut Session) -> Result<(), Stop> {
        let Some((poll, skipped)) = self.schedules.take_due(Instant::now()) else {
            self.note_schedules();
            return Ok(());
        };
        let mut values = self.schedules.take_spare(poll);
        let (outcome, delivered) = match self.poll(session, poll.window, &mut values).await {
            Ok(Polled { timing, first }) => {
                let meta = self.meta(timing);
                (Ok(()), self.schedules.deliver(poll, values, first, meta))
            }
            Err(failure) => match self.command_error(failure) {
                Ok(error) => (Ok(()), self.schedules.fail(poll, &error)),
                Err(stop) => (Err(stop), Delivered::default()),
            },
        };
        if let Some(shortfall) = delivered.shortfall
            && let Some(stats) = self.schedules.stats(poll)
        {
            warn_of(shortfall, poll, stats);
        }
        let mut stats = self.telemetry.stats();
        stats.repeats += u64::from(delivered.repeat);
        stats.polls_skipped += skipped;
        stats.missed = self.schedules.missed();
        drop(stats);
        self.note_schedules();
        outcome
    }

    /// Polls, and records why there is no scan.
    async fn poll(
        &mut self,
        session: &mut Session,
        window: Window,
        values: &mut Arc<[u16]>,
    ) -> Result<Polled, ExchangeError> {
        let outcome = self.poll_with_laser(session, window, values).await;
        if let Err(failure) = &outcome {
            self.telemetry.stats().failed(failure.error());
        }
        outcome
    }

    /// Polls; if the sensor refuses, once more after switching the laser on: it is
    /// off, and nobody here switched it off.
    async fn poll_with_laser(
        &mut self,
        session: &mut Session,
        window: Window,
        values: &mut Arc<[u16]>,
    ) -> Result<Polled, ExchangeError> {
        let refusal = match session.poll(window, values).await {
            Err(ExchangeError::Command(Error::Refused { command, status })) => {
                Refusal { command, status }
            }
            outcome => {
                if outcome.is_ok() {
                    self.laser_recovery.note_scan();
                }
                return outcome;
            }
        };
        self.laser_recovery.switch_on(session, refusal).await?;
        let outcome = session.poll(window, values).await;
        if let Err(ExchangeError::Command(Error::Refused { .. })) = &outcome {
            self.laser_recovery.note_refusal();
        }
        outcome
    }

    /// Answers a request; a failure of the line is also a reason to stop.
    fn respond<T>(
        &self,
        responder: Responder<T>,
        outcome: Result<T, ExchangeError>,
    ) -> Result<(), Stop> {
        let (answer, stop) = match outcome {
            Ok(answer) => (Ok(answer), Ok(())),
            Err(failure) => match self.command_error(failure) {
                Ok(error) => (Err(error), Ok(())),
                Err(stop) => (Err(stop.cause()), Err(stop)),
            },
        };
        // If nobody waits for the answer, it is dropped.
        let _ = responder.send(answer);
        stop
    }

    fn meta(&self, timing: Timing) -> ScanMeta {
        ScanMeta {
            sequence: 0,
            requested_at: timing.requested,
            received_at: timing.received,
            stamp: timing.stamp,
            repeat: false,
            scan_time: self.scan_time,
            reconnects: self.reconnects,
        }
    }

    fn note_schedules(&mut self) {
        self.schedules.note(self.telemetry);
    }

    /// Returns the error if only the command failed, or else the reason to stop.
    fn command_error(&self, failure: ExchangeError) -> Result<Error, Stop> {
        let name = self.telemetry.name();
        match failure {
            ExchangeError::Command(error) => Ok(error.named(name)),
            ExchangeError::Silent(error) => Err(Stop::Silent(error.named(name))),
            ExchangeError::Lost(error) => Err(Stop::Lost(error.named(name))),
            ExchangeError::Ended(error) => Err(Stop::Ended(error.named(name))),
        }
    }

    fn ignore_command_errors(&self, outcome: Result<(), ExchangeError>) -> Result<(), Stop> {
        outcome.or_else(|failure| self.command_error(failure).map(drop))
    }
}

/// Logs why the rate of a schedule is not reached.
fn warn_of(
    shortfall: Shortfall,
    poll: DuePoll,
    ScheduleStats { reached, failed, .. }: ScheduleStats,
) {
    let DuePoll { window, rate } = poll;
    match shortfall {
        Shortfall::Slow => tracing::warn!(
            %window, asked = %rate, reached,
            "the line or the sensor cannot keep up: ask for fewer scans or steps, or for a higher baud rate"
        ),
        Shortfall::Loss => tracing::warn!(
            %window, asked = %rate, reached, failed,
            "replies are lost, malformed or refused: check the cable and the sensor's power"
        ),
    }
}
