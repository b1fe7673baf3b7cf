//! Scans that the sensor sends unasked: starts them, and delivers each to the schedules that are due.

use std::time::Duration;

use tokio::task::coop::consume_budget;
use tokio::time::Instant;

use super::super::failure::ExchangeError;
use super::super::motor_clock::Revolution;
use super::super::schedule::DuePoll;
use super::super::session::Session;
use super::{Service, Stop, command_error, ignore_command_errors};
use crate::{ErrorKind, Window};

impl Service<'_> {
    /// Starts a stream for the schedules that are not too slow for it, if the line is not.
    pub(super) async fn start_stream(&mut self, session: &mut Session) -> Result<(), Stop> {
        let Some(mut streams) = session.streams() else { return Ok(()) };
        // It would switch on a laser that is to be off.
        let may_start = self.queue.desired.laser != Some(false);
        let wish = self.schedules.stream(self.scan_time);
        let Some(wish) = wish.filter(|wish| may_start && streams.can_stream(*wish)) else {
            streams.allow_gap();
            return Ok(());
        };
        self.schedules.begin_stream();
        let outcome = streams.stream(wish).await;
        match outcome {
            Ok(()) => self.streamed = Some(wish.skipped),
            // They are due again later, for a stream: by `GD` they could get a scan twice.
            Err(failure) => {
                self.fail_streamed(&command_error(failure)?)?;
                self.schedules.end_stream();
            }
        }
        Ok(())
    }

    /// Takes the polls that are due for a scan of this window, or for an error, which arrived this late.
    fn take_streamed(&mut self, lateness: Duration, shown: Option<Window>) -> Vec<DuePoll> {
        let turns = u32::from(self.streamed.unwrap_or(0)) + 1;
        let now = Instant::now();
        let due = now.checked_sub(lateness).unwrap_or(now);
        self.schedules.take_streamed(due, self.scan_time * turns, shown)
    }

    /// Ends the polls of the stream that are due now with an error.
    fn fail_streamed(&mut self, error: &ErrorKind) -> Result<(), Stop> {
        self.shared.counters.fail(self.shared.link.error(error.clone()));
        for poll in self.take_streamed(Duration::ZERO, None) {
            self.shared.counters.count_poll();
            self.fail(poll, ExchangeError::Command(error.clone()), Instant::now())?;
        }
        Ok(())
    }

    /// Polls again once nothing comes from a stream any more.
    pub(super) fn check_stream(&mut self, session: &Session) {
        if self.streamed.is_some() && !session.is_streaming() {
            self.streamed = None;
            self.schedules.end_stream();
        }
    }

    /// Delivers scans and errors. Ends a stream that no schedule needs, restarts it for more or fewer.
    pub(super) async fn deliver_streamed(&mut self, session: &mut Session) -> Result<(), Stop> {
        // A sensor that sends without a pause must not keep other tasks from running.
        consume_budget().await;
        self.deliver_waiting(session)?;
        self.schedules.drop_unread();
        // Both would switch the laser on. The command that switches it off ends the stream.
        let may_change = session.is_streaming() && self.queue.desired.laser != Some(false);
        let Some(mut streams) = session.streams().filter(|_| may_change) else { return Ok(()) };
        let wish = self.schedules.stream(self.scan_time);
        // The motor may turn so fast that its scans fill the line.
        let outcome = match wish.filter(|wish| streams.can_stream(*wish)) {
            None => {
                let outcome = streams.end_stream().await;
                streams.allow_gap();
                outcome
            }
            Some(wish) if self.streamed != Some(wish.skipped) => {
                self.streamed = Some(wish.skipped);
                streams.stream(wish).await
            }
            Some(_) => Ok(()),
        };
        ignore_command_errors(outcome)
    }

    /// Delivers what is waiting, so that no newer scan is delivered before it.
    pub(super) fn deliver_waiting(&mut self, session: &mut Session) -> Result<(), Stop> {
        while let Some(next) = session.take_streamed() {
            let streamed = match next {
                Ok(streamed) => streamed,
                Err(error) => {
                    self.fail_streamed(&error)?;
                    continue;
                }
            };
            let Revolution { lateness, period, .. } = streamed.revolution();
            // The motor may turn at another speed than the sensor tells.
            let is_other = |it: &Duration| it.abs_diff(self.scan_time) > self.scan_time / 50;
            self.scan_time = period.filter(is_other).unwrap_or(self.scan_time);
            // After a pause of the host several arrive at once, and each belongs to its own poll.
            let shown = Some(streamed.window());
            for poll in self.take_streamed(lateness.unwrap_or_default(), shown) {
                self.shared.counters.count_poll();
                if let Some(acquired) = streamed.cut(poll.window, &self.geometry) {
                    self.deliver(poll, acquired, session.believed_baud_rate());
                }
            }
        }
        Ok(())
    }
}
