//! Polls: takes the one that is due, and makes a scan of its reply.

use std::future::poll_fn;
use std::task::Poll;
use std::time::Duration;

use tokio::time::Instant;

use super::super::failure::{ExchangeError, LinkError};
use super::super::rarely::rarely;
use super::super::schedule::DuePoll;
use super::super::session::{Acquired, Session};
use super::{Service, Stop, command_error};
use crate::scan::{Scan, ScanMeta};
use crate::{BaudRate, Error, ErrorKind, Window};

impl Service<'_> {
    pub(super) async fn scan(
        &mut self,
        session: &mut Session,
        window: Window,
    ) -> Result<Scan, ExchangeError> {
        if self.laser.is_off {
            return Err(ExchangeError::Command(ErrorKind::LaserOff));
        }
        let Ok(window) = window.resolve(&self.geometry) else {
            return Err(self.unmeasured(window));
        };
        let mut tries = 2;
        loop {
            tries -= 1;
            let mut acquired = session.acquire(window).await;
            if let Err(failure) = acquired {
                acquired = self.poll_again(session, window, failure).await;
            }
            match acquired {
                Err(failure)
                    if failure.is_lost_reply() && tries > 0 && !self.shared.is_closing() => {}
                Ok(acquired) => return Ok(self.scan_from(window, acquired)),
                Err(failure) => return Err(failure),
            }
        }
    }

    /// Returns false if there was nothing to do.
    pub(super) async fn poll_due(
        &mut self,
        session: &mut Session,
        now: Instant,
    ) -> Result<bool, Stop> {
        if session.streams().is_some() {
            // Without a box: after each scan nothing more has come.
            if session.is_streaming()
                && let Poll::Ready(outcome) =
                    poll_fn(|cx| Poll::Ready(session.poll_streamed(cx))).await
            {
                outcome?;
                rarely(|| self.deliver_streamed(session)).await?;
                return Ok(true);
            }
            if !self.schedules.is_due() {
                return Ok(false);
            }
            rarely(|| self.start_stream(session)).await?;
        }
        let Some(poll) = self.schedules.take_due(now) else { return Ok(true) };
        let window = poll.window;
        if !poll.is_measured {
            self.fail(poll, self.unmeasured(window), now)?;
            return Ok(true);
        }
        // Earlier, the session would have to confirm the reply, which costs a revolution.
        if poll.rate.period().is_some()
            && let Some(copies_end) = session.copies_end(window)
        {
            rarely(|| self.timer.wait(copies_end)).await;
        }
        let mut acquired = session.acquire(window).await;
        if let Err(failure) = acquired {
            acquired = rarely(|| self.poll_again(session, window, failure)).await;
        }
        match acquired {
            Ok(acquired) => self.deliver(poll, acquired, session.believed_baud_rate()),
            Err(failure) => self.fail(poll, failure, now)?,
        }
        Ok(true)
    }

    /// Delivers a scan to the schedule of `poll`.
    pub(super) fn deliver(
        &mut self,
        poll: DuePoll,
        acquired: Acquired,
        baud_rate: Option<BaudRate>,
    ) {
        let scan = self.scan_from(poll.window, acquired);
        self.schedules.deliver(poll, scan, baud_rate);
    }

    /// Ends a poll that has failed. At [`Rate::UNLIMITED`](crate::Rate::UNLIMITED) the next one is due a
    /// revolution after this one `began`: a refusal comes at once, and so may a damaged reply.
    #[cold]
    pub(super) fn fail(
        &mut self,
        poll: DuePoll,
        failure: ExchangeError,
        began: Instant,
    ) -> Result<(), LinkError> {
        let again = Instant::now().max(began + self.scan_time);
        let error = self.shared.link.error(command_error(failure)?);
        self.schedules.fail(poll, &error, again);
        Ok(())
    }

    /// Error for a window that this sensor cannot measure.
    #[cold]
    fn unmeasured(&self, window: Window) -> ExchangeError {
        let outcome = window.resolve(&self.geometry).map(drop).map_err(Error::other);
        let kind = outcome.err().map_or(ErrorKind::Closed, Error::into_kind);
        self.shared.counters.fail(self.shared.link.error(kind.clone()));
        ExchangeError::Command(kind)
    }

    /// Handles the failure of a poll. If the sensor's laser is off, and this driver did not switch it
    /// off, switches it on and polls once more. Otherwise records why there is no scan.
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
            let error = self.shared.link.error(failure.kind().clone());
            self.shared.counters.fail(error);
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

    /// Makes a scan of a reply, and learns from its arrival when the motor's revolutions end.
    pub(super) fn scan_from(&mut self, window: Window, acquired: Acquired) -> Scan {
        self.laser.record_scan(window);
        let Acquired { values, first, told, times } = acquired;
        let clock = self.motor_clock.as_mut().filter(|_| !times.is_replayed);
        let (revolution, motor) = match (&told, clock) {
            (Some(told), _) => (told.revolution, told.motor),
            (None, Some(clock)) => (clock.observe(times.requested, times.began), clock.stats()),
            (None, None) => Default::default(),
        };
        self.shared.counters.count_scan(times.requested, times.received, motor);
        let meta = ScanMeta {
            sequence: 0,
            requested_at: times.requested,
            first_byte_at: times.began,
            received_at: times.received,
            stamp: times.stamp,
            lateness: revolution.lateness.filter(|_| !revolution.is_doubted),
            postponed: Duration::ZERO,
            repeat: false,
            scan_time: revolution.period.unwrap_or(self.scan_time),
            geometry: self.geometry,
            sensor_clock: told.map(|told| told.clock),
            reconnects: self.reconnects,
        };
        let mut scan = Scan::new(window, values, first, meta);
        // A replay has stamps of another time than its polls.
        if !times.is_replayed {
            self.ray_order.arrange(&mut scan);
        }
        scan
    }
}
