//! Serves an open session: requests and polls in turn.

use std::time::Duration;

use tokio::time::{Instant, sleep_until};

use super::baud_rate;
use super::failure::{ExchangeError, LinkError};
use super::laser::{LaserRecovery, Refusal, set_laser};
use super::motor_clock::{MotorClock, Revolution};
use super::open::DesiredSettings;
use super::poll_timer::PollTimer;
use super::request::{Abandoned, Request, RequestQueue, Responder};
use super::schedule::{DuePoll, Ended, Schedules};
use super::session::{Polled, Session};
use crate::scan::{Scan, ScanMeta};
use crate::state::Telemetry;
use crate::stats::{ScheduleStats, Shortfall};
use crate::{ErrorKind, Window};

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

/// Everything needed to serve, besides the session.
pub(crate) struct Service<'a> {
    pub(crate) queue: &'a mut RequestQueue,
    pub(crate) schedules: &'a mut Schedules,
    pub(crate) desired: &'a mut DesiredSettings,
    pub(crate) telemetry: &'a Telemetry,
    pub(crate) scan_time: Duration,
    /// Silence after which an idle link is probed with a fence, if it is.
    pub(crate) probe_interval: Option<Duration>,
    pub(crate) motor_clock: MotorClock,
    /// Number of times the sensor had been found again before this session.
    pub(crate) reconnects: u64,
    pub(crate) laser_recovery: LaserRecovery,
    pub(crate) poll_timer: PollTimer,
    /// True if scans are polled, as the state reports it.
    pub(crate) streaming: bool,
}

impl Service<'_> {
    /// Serves until there is a reason to stop.
    pub(crate) async fn run(&mut self, session: &mut Session) -> Stop {
        self.schedules.resume(Instant::now());
        let mut request_served = false;
        loop {
            let outcome = self.serve_next(session, &mut request_served).await;
            if let Err(stop) = outcome {
                return stop;
            }
        }
    }

    /// Serves one request or one poll, or waits for either. Alternates when both are due,
    /// so that neither starves the other.
    async fn serve_next(
        &mut self,
        session: &mut Session,
        request_served: &mut bool,
    ) -> Result<(), Stop> {
        // Only bytes from the sensor show that the link is alive: some requests are answered
        // without it.
        let latest = session.transport.latest_at();
        let probe = self.probe_interval.zip(latest).map(|(interval, latest)| latest + interval);
        // Now, while nothing else is due, a fence delays no poll.
        if !session.is_settled() || probe.is_some_and(|due| due <= Instant::now()) {
            let outcome = self.resynchronise(session).await;
            ignore_command_errors(outcome)?;
        }
        let polling = !self.schedules.is_empty() && self.desired.laser != Some(false);
        self.publish_streaming(polling);
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
        let wake = due.into_iter().chain(probe).min();
        let next = self.schedules.due_after_next().filter(|_| polling);
        tokio::select! {
            biased;
            outcome = session.transport.idle() => ignore_command_errors(outcome)?,
            outcome = self.queue.ready() => outcome?,
            () = self.poll_timer.wait(wake.unwrap_or_else(Instant::now), next), if wake.is_some() => {}
        }
        Ok(())
    }

    /// Drops pending input and sends a fence. If the sensor answers with a distance although its laser should be
    /// off, it was reset: switches the laser off again.
    async fn resynchronise(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        session.discard_pending().await?;
        let status = session.fence().await?;
        if self.desired.laser == Some(false) && status.is_ok() {
            set_laser(session, false).await?;
        }
        Ok(())
    }

    async fn answer(&mut self, session: &mut Session, request: Request) -> Result<(), Stop> {
        match request {
            Request::Version(responder) => {
                // The version was read when the sensor was found.
                let known = self.telemetry.version().ok_or(ErrorKind::Closed);
                let _ = responder.send(known);
                Ok(())
            }
            Request::Laser { on, responder } => {
                // Also on failure: the driver restores the setting whenever it finds the
                // sensor again.
                self.desired.laser = Some(on);
                self.telemetry.set_laser_off(!on);
                let outcome = set_laser(session, on).await;
                if on {
                    self.schedules.resume(Instant::now());
                } else {
                    self.schedules.pause();
                    self.schedules.publish(self.telemetry);
                }
                Self::respond(responder, outcome)
            }
            Request::BaudRate { baud_rate, responder } => {
                let before = session.transport.baud_rate();
                let mut outcome = baud_rate::change(session, baud_rate).await;
                if outcome.is_ok() {
                    self.desired.baud_rate = Some(baud_rate);
                    if self.desired.laser == Some(false) {
                        // The sensor may have restarted unnoticed.
                        outcome = set_laser(session, false).await;
                    }
                }
                if session.transport.baud_rate() != before {
                    self.telemetry.set_baud_rate(session.transport.baud_rate());
                }
                Self::respond(responder, outcome)
            }
            Request::Scan { window, responder } => {
                let outcome = self.scan(session, window).await;
                Self::respond(responder, outcome)
            }
            Request::Subscribe { window, rate, depth, responder } => {
                // Drops the stream if no caller waits for it.
                let _ = responder.send(Ok(self.schedules.subscribe(window, rate, depth, None)));
                self.schedules.publish(self.telemetry);
                Ok(())
            }
            Request::Close(responder) => Err(Stop::Closed(responder)),
        }
    }

    async fn scan(&mut self, session: &mut Session, window: Window) -> Result<Scan, ExchangeError> {
        if self.desired.laser == Some(false) {
            return Err(ExchangeError::Command(ErrorKind::LaserOff));
        }
        let mut tries = 2;
        loop {
            tries -= 1;
            match self.poll(session, window).await {
                Err(ExchangeError::Command(
                    ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. },
                )) if tries > 0 && !self.telemetry.is_closing() => {}
                outcome => return outcome,
            }
        }
    }

    async fn poll_due(&mut self, session: &mut Session) -> Result<(), Stop> {
        let Some((poll, skipped)) = self.schedules.take_due(Instant::now()) else {
            self.schedules.publish(self.telemetry);
            return Ok(());
        };
        // Instead of a fence, which costs a revolution: the line is then as quiet as before a
        // poll of a slower grid.
        if poll.rate.period().is_some()
            && let Some(copies_end) = session.copies_end(poll.window)
        {
            sleep_until(copies_end).await;
        }
        let (outcome, ended) = match self.poll(session, poll.window).await {
            Ok(scan) => (Ok(()), self.schedules.deliver(poll, scan)),
            Err(failure) => match command_error(failure) {
                Ok(kind) => (Ok(()), self.schedules.fail(poll, &self.telemetry.error(kind))),
                Err(failure) => (Err(failure.into()), Ended::default()),
            },
        };
        if let Some(shortfall) = ended.shortfall
            && let Some(stats) = self.schedules.stats(poll)
        {
            warn_of(shortfall, poll, stats);
        }
        let mut stats = self.telemetry.stats();
        stats.repeats += u64::from(ended.repeats);
        stats.polls_skipped += skipped;
        stats.missed = self.schedules.missed();
        drop(stats);
        self.schedules.publish(self.telemetry);
        outcome
    }

    /// Polls, and records the scan or the reason why there is none. If the sensor refuses
    /// because its laser is off, and this driver did not switch it off, switches it on and polls
    /// once more.
    async fn poll(&mut self, session: &mut Session, window: Window) -> Result<Scan, ExchangeError> {
        let mut outcome = session.poll(window).await;
        if let Err(ExchangeError::Command(ErrorKind::Refused { command, status, .. })) = outcome {
            let refusal = Refusal { command, status };
            outcome = match self.laser_recovery.switch_on(session, refusal).await {
                Ok(()) => session.poll(window).await,
                Err(failure) => Err(failure),
            };
            if let Err(ExchangeError::Command(ErrorKind::Refused { .. })) = &outcome {
                self.laser_recovery.record_refusal();
            }
        }
        match outcome {
            Ok(polled) => {
                self.laser_recovery.record_scan();
                Ok(self.scan_from(window, polled))
            }
            Err(failure) => {
                self.telemetry.fail(failure.kind().clone());
                Err(failure)
            }
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

    /// Makes a scan of a reply, and learns from its arrival when the motor's revolutions end.
    fn scan_from(&mut self, window: Window, polled: Polled) -> Scan {
        let Polled { values, first, timing } = polled;
        let revolution = match timing.is_replayed {
            true => Revolution::default(),
            false => self.motor_clock.observe(timing.requested, timing.began),
        };
        let mut stats = self.telemetry.stats();
        stats.scanned(timing.requested, timing.received);
        stats.motor = self.motor_clock.stats();
        drop(stats);
        let meta = ScanMeta {
            sequence: 0,
            requested_at: timing.requested,
            first_byte_at: timing.began,
            received_at: timing.received,
            stamp: timing.stamp,
            lateness: revolution.lateness,
            repeat: false,
            scan_time: revolution.period.unwrap_or(self.scan_time),
            reconnects: self.reconnects,
        };
        Scan::new(window, values, first, meta)
    }

    /// Updates the state only on a change, because a user may hold a borrow of it.
    fn publish_streaming(&mut self, now: bool) {
        if std::mem::replace(&mut self.streaming, now) != now {
            self.telemetry.set_streaming(now);
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

/// Logs why a schedule falls short of its rate.
fn warn_of(
    shortfall: Shortfall,
    poll: DuePoll,
    ScheduleStats { reached, failed, .. }: ScheduleStats,
) {
    let DuePoll { window, rate } = poll;
    match shortfall {
        Shortfall::Slow => tracing::warn!(
            %window, asked = %rate, reached = reached.unwrap_or_default(),
            "the line or the sensor cannot keep up: ask for fewer scans or steps, or for a higher baud rate"
        ),
        Shortfall::Loss => tracing::warn!(
            %window, asked = %rate, reached = reached.unwrap_or_default(), failed,
            "replies are lost, malformed or refused: check the cable and the sensor's power"
        ),
    }
}
