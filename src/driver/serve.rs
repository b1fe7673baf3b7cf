//! Serves an open session: requests and polls in turn.

use std::future::poll_fn;
use std::task::Poll;
use std::time::Duration;

use tokio::time::Instant;

use super::failure::{ExchangeError, LinkError};
use super::laser::Laser;
use super::motor_clock::MotorClock;
use super::ray_order::RayOrder;
use super::request::{Abandoned, Request, RequestQueue, Responder};
use super::schedule::{DuePoll, Ended, Schedules};
use super::session::{Acquired, Session};
use super::transport::Timer;
use crate::scan::{Scan, ScanMeta};
use crate::state::Telemetry;
use crate::{BaudRate, ErrorChain, ErrorKind, Geometry, Window};

/// Number of attempts at a baud rate that the sensor neither confirms nor refuses. At a baud rate
/// that the cable cannot carry, each costs the link.
const BAUD_RATE_ATTEMPTS: u8 = 3;

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
    pub(crate) telemetry: &'a Telemetry,
    pub(crate) scan_time: Duration,
    /// Silence after which an idle link is probed, if it is.
    pub(crate) probe_interval: Option<Duration>,
    /// On the sensor's own USB port.
    pub(crate) motor_clock: Option<MotorClock>,
    pub(crate) ray_order: RayOrder,
    /// Number of times the sensor had been found again before this session.
    pub(crate) reconnects: u64,
    /// True if scans are polled, as the state reports it.
    pub(crate) streaming: bool,
    /// Wakes the driver for the next poll, probe or attempt.
    pub(crate) timer: Timer,
}

impl Service<'_> {
    /// Serves until there is a reason to stop.
    pub(crate) async fn run(&mut self, session: &mut Session) -> Stop {
        self.schedules.resume(Instant::now());
        let desired = &mut self.queue.desired;
        if let Some(now) = session.baud_rate()
            && desired.baud_rate.is_none()
            && desired.attempts < BAUD_RATE_ATTEMPTS
        {
            // The sensor may have restarted while its baud rate was restored.
            desired.baud_rate = self.baud_rate.filter(|baud_rate| *baud_rate != now);
        }
        let mut latest = Turn::Poll;
        loop {
            let outcome = self.serve_next(session, &mut latest).await;
            if let Err(stop) = outcome {
                return stop;
            }
        }
    }

    /// Serves one request, setting or poll in turn, so that none starves the others, or waits for one.
    async fn serve_next(&mut self, session: &mut Session, latest: &mut Turn) -> Result<(), Stop> {
        // Only bytes from the sensor show that the link is alive: some requests are answered
        // without it.
        let now = Instant::now();
        let heard = session.heard_at();
        let probe = self.probe_interval.zip(heard).map(|(interval, heard)| heard + interval);
        // In doubt, the next command would begin with a probe anyway. Now there may be time for it.
        if session.is_in_doubt() || probe.is_some_and(|due| due <= now) {
            let outcome = Box::pin(self.probe(session)).await;
            ignore_command_errors(outcome)?;
        }
        if self.laser.retry_at().is_none() && self.laser.is_due(self.queue.desired.laser) {
            // A setting that is younger than the session comes before all polls.
            Box::pin(self.apply_laser(session)).await?;
        }
        let polling = !self.schedules.is_empty() && !self.laser.is_off();
        self.publish_streaming(polling);
        let due = self.schedules.next_due().filter(|_| polling);
        let poll_is_due = due.is_some_and(|due| due <= Instant::now());
        for _ in Turn::ALL {
            *latest = latest.next();
            let is_served = match latest {
                Turn::Request => match self.queue.pop()? {
                    Some(request) => {
                        Box::pin(self.serve_request(session, request)).await?;
                        true
                    }
                    None => false,
                },
                Turn::Setting if self.has_setting() => {
                    Box::pin(self.apply_setting(session)).await?
                }
                Turn::Poll if poll_is_due => {
                    self.poll_due(session).await?;
                    true
                }
                Turn::Setting | Turn::Poll => false,
            };
            if is_served {
                return Ok(());
            }
        }
        let wake = due.into_iter().chain(probe).chain(self.laser.retry_at()).min();
        poll_fn(|cx| {
            if let Poll::Ready(outcome) = session.poll_unasked(cx) {
                return Poll::Ready(outcome.map_err(Stop::from));
            }
            if let Poll::Ready(outcome) = self.queue.poll_ready(cx) {
                return Poll::Ready(outcome.map_err(Stop::from));
            }
            wake.map_or(Poll::Pending, |wake| self.timer.poll(cx, wake).map(Ok))
        })
        .await
    }

    async fn serve_request(&mut self, session: &mut Session, request: Request) -> Result<(), Stop> {
        self.answer(session, request).await?;
        // One of the streams may have been dropped since the last request.
        self.schedules.drop_unread();
        self.schedules.publish(self.telemetry);
        Ok(())
    }

    /// Returns true if a setting is to be applied.
    fn has_setting(&self) -> bool {
        let desired = &self.queue.desired;
        desired.baud_rate.is_some() || self.laser.is_due(desired.laser)
    }

    /// Returns true if there was a setting to apply.
    async fn apply_setting(&mut self, session: &mut Session) -> Result<bool, Stop> {
        if self.apply_laser(session).await? {
            return Ok(true);
        }
        let Some(baud_rate) = self.queue.desired.baud_rate else { return Ok(false) };
        Box::pin(self.apply_baud_rate(session, baud_rate)).await?;
        Ok(true)
    }

    async fn apply_laser(&mut self, session: &mut Session) -> Result<bool, Stop> {
        let desired = self.queue.desired.laser;
        let Some(on) = desired.filter(|_| self.laser.is_due(desired)) else { return Ok(false) };
        let outcome = Box::pin(self.switch_laser(session, on, true)).await;
        ignore_command_errors(outcome)?;
        Ok(true)
    }

    /// Probes the sensor. If it measures although its laser should be off, it was reset: switches
    /// the laser off again.
    async fn probe(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        if session.probe().await? && self.laser.is_off() {
            self.switch_laser(session, false, true).await?;
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
            Request::Scan { window, responder } => {
                let outcome = self.scan(session, window).await;
                Self::respond(responder, outcome)
            }
            Request::Subscribe { window, rate, depth, responder } => {
                // Drops the stream if no caller waits for it.
                let _ = responder.send(Ok(self.schedules.subscribe(window, rate, depth, None)));
                Ok(())
            }
            Request::Close(responder) => Err(Stop::Closed(responder)),
            Request::StreamDropped => Ok(()),
        }
    }

    /// Switches the laser. Polls only while it is not switched off.
    async fn switch_laser(
        &mut self,
        session: &mut Session,
        on: bool,
        is_retry: bool,
    ) -> Result<(), ExchangeError> {
        let was_off = self.laser.is_off();
        let outcome = match is_retry {
            true => self.laser.retry(session, on).await,
            false => self.laser.switch(session, on).await,
        };
        match self.laser.is_off() {
            is_off if is_off == was_off => {}
            true => {
                self.schedules.pause();
                self.schedules.publish(self.telemetry);
            }
            false => self.schedules.resume(Instant::now()),
        }
        outcome
    }

    /// Changes the baud rate. From now on it is restored, unless the sensor refuses it: then the
    /// one before it is.
    async fn change_baud_rate(
        &mut self,
        session: &mut Session,
        baud_rate: BaudRate,
    ) -> Result<(), ExchangeError> {
        let before = session.baud_rate();
        let mut outcome = session.set_baud_rate(baud_rate).await;
        if outcome.is_ok() {
            *self.baud_rate = Some(baud_rate);
            if self.laser.is_off() {
                // The sensor may have restarted unnoticed.
                outcome = self.switch_laser(session, false, true).await;
            }
        }
        if session.baud_rate() != before {
            self.telemetry.set_baud_rate(session.baud_rate());
        }
        outcome
    }

    /// Changes the baud rate to one that a handle asked for while there was no link. No caller
    /// waits for the outcome.
    async fn apply_baud_rate(
        &mut self,
        session: &mut Session,
        baud_rate: BaudRate,
    ) -> Result<(), Stop> {
        let outcome = self.change_baud_rate(session, baud_rate).await;
        let desired = &mut self.queue.desired;
        desired.attempts += u8::from(!is_unplugged(&outcome));
        let error = outcome.as_ref().err().map(ExchangeError::kind);
        let is_final = match error {
            Some(ErrorKind::Refused { .. } | ErrorKind::UnsupportedBaudRate { .. }) | None => true,
            // The sensor may have restarted at that moment.
            Some(_) => desired.attempts >= BAUD_RATE_ATTEMPTS,
        };
        if is_final {
            desired.baud_rate = None;
            match error {
                Some(error) => {
                    let error = ErrorChain(error);
                    tracing::warn!(%error, %baud_rate, "the baud rate is not changed");
                }
                None => desired.attempts = 0,
            }
        }
        ignore_command_errors(outcome)
    }

    async fn scan(&mut self, session: &mut Session, window: Window) -> Result<Scan, ExchangeError> {
        if self.laser.is_off() {
            return Err(ExchangeError::Command(ErrorKind::LaserOff));
        }
        let mut tries = 2;
        loop {
            tries -= 1;
            let mut acquired = session.acquire(window).await;
            if let Err(failure) = acquired {
                acquired = self.poll_again(session, window, failure).await;
            }
            match acquired {
                Err(ExchangeError::Command(
                    ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. },
                )) if tries > 0 && !self.telemetry.is_closing() => {}
                Ok(acquired) => return Ok(self.scan_from(window, acquired)),
                Err(failure) => return Err(failure),
            }
        }
    }

    async fn poll_due(&mut self, session: &mut Session) -> Result<(), Stop> {
        let Some((poll, skipped)) = self.schedules.take_due(Instant::now()) else {
            self.schedules.publish(self.telemetry);
            return Ok(());
        };
        // Earlier, the session would have to confirm the reply, which costs a revolution.
        if poll.rate.period().is_some()
            && let Some(copies_end) = session.copies_end(poll.window)
        {
            self.timer.wait(copies_end).await;
        }
        let mut acquired = session.acquire(poll.window).await;
        if let Err(failure) = acquired {
            acquired = Box::pin(self.poll_again(session, poll.window, failure)).await;
        }
        let ended = match acquired {
            Ok(acquired) => {
                let scan = self.scan_from(poll.window, acquired);
                self.schedules.deliver(poll, scan, session.believed_baud_rate())
            }
            Err(failure) => self.fail(poll, failure)?,
        };
        if ended.falls_short {
            self.warn_of_shortfall(poll);
        }
        if ended.repeats || ended.newly_missed > 0 || skipped > 0 {
            let mut stats = self.telemetry.stats();
            stats.repeats += u64::from(ended.repeats);
            stats.polls_skipped += skipped;
            stats.missed = self.schedules.missed();
        }
        self.schedules.publish(self.telemetry);
        Ok(())
    }

    #[cold]
    fn fail(&mut self, poll: DuePoll, failure: ExchangeError) -> Result<Ended, LinkError> {
        let kind = command_error(failure)?;
        Ok(self.schedules.fail(poll, &self.telemetry.error(kind)))
    }

    /// Handles the failure of a poll. If the sensor refused because its laser is off, and this
    /// driver did not switch it off, switches it on and polls once more. Otherwise records why there
    /// is no scan.
    async fn poll_again(
        &mut self,
        session: &mut Session,
        window: Window,
        failure: ExchangeError,
    ) -> Result<Acquired, ExchangeError> {
        let outcome = match failure {
            ExchangeError::Command(refusal @ ErrorKind::Refused { .. })
                if self.queue.desired.laser != Some(false) =>
            {
                self.poll_with_laser_on(session, window, refusal).await
            }
            failure => Err(failure),
        };
        if let Err(failure) = &outcome {
            self.telemetry.fail(failure.kind().clone());
        }
        outcome
    }

    async fn poll_with_laser_on(
        &mut self,
        session: &mut Session,
        window: Window,
        refusal: ErrorKind,
    ) -> Result<Acquired, ExchangeError> {
        self.laser.switch_on(session, window, refusal.clone()).await?;
        let again = session.acquire(window).await;
        match &again {
            Ok(_) => {
                tracing::info!(%refusal, "switched the laser on");
            }
            Err(ExchangeError::Command(ErrorKind::Refused { .. })) => {
                self.laser.record_refusal(window, None);
            }
            Err(_) => {}
        }
        again
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
    fn scan_from(&mut self, window: Window, acquired: Acquired) -> Scan {
        self.laser.record_scan(window);
        let Acquired { values, first, times } = acquired;
        let clock = self.motor_clock.as_mut().filter(|_| !times.is_replayed);
        let (revolution, motor) = clock.map_or_else(Default::default, |clock| {
            (clock.observe(times.requested, times.began), clock.stats())
        });
        let mut stats = self.telemetry.stats();
        stats.scanned(times.requested, times.received);
        stats.motor = motor;
        drop(stats);
        let meta = ScanMeta {
            sequence: 0,
            requested_at: times.requested,
            first_byte_at: times.began,
            received_at: times.received,
            stamp: times.stamp,
            lateness: revolution.lateness,
            postponed: Duration::ZERO,
            repeat: false,
            scan_time: revolution.period.unwrap_or(self.scan_time),
            geometry: Geometry::URG_04LX,
            reconnects: self.reconnects,
        };
        let mut scan = Scan::new(window, values, first, meta);
        self.ray_order.arrange(&mut scan);
        scan
    }

    /// Logs why a schedule falls short of its rate.
    #[cold]
    fn warn_of_shortfall(&mut self, poll: DuePoll) {
        let Some(stats) = self.schedules.stats(poll) else { return };
        let (DuePoll { window, rate }, reached) = (poll, stats.reached.unwrap_or_default());
        let explanation = stats.explanation().unwrap_or_default();
        tracing::warn!(%window, asked = %rate, reached, "{explanation}");
    }

    /// Updates the state only on a change, because a user may hold a borrow of it.
    fn publish_streaming(&mut self, now: bool) {
        if std::mem::replace(&mut self.streaming, now) != now {
            self.telemetry.set_streaming(now);
        }
    }
}

/// Returns true if the port is gone: nothing tells whether the sensor would have obeyed.
fn is_unplugged<T>(outcome: &Result<T, ExchangeError>) -> bool {
    matches!(outcome, Err(ExchangeError::Link(LinkError::Lost(_) | LinkError::Ended(_))))
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
