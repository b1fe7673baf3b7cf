//! Scans that the sensor sends without being polled: starts them, and delivers each to the schedules
//! that are due.

use std::future::poll_fn;
use std::task::Poll;

use tokio::task::coop::consume_budget;
use tokio::time::Instant;

use super::super::failure::ExchangeError;
use super::super::schedule::DuePoll;
use super::super::session::Session;
use super::{Service, Stop, ignore_command_errors};

impl Service<'_> {
    /// Starts a stream for the schedules that are not too slow for one, if the line is not. Returns
    /// true if it serves the schedule of `poll`, or if that has failed.
    pub(super) async fn begin_stream(
        &mut self,
        session: &mut Session,
        poll: DuePoll,
    ) -> Result<bool, Stop> {
        let Some(wish) = self.schedules.stream(self.scan_time) else { return Ok(false) };
        if !session.can_stream(wish, self.scan_time) {
            return Ok(false);
        }
        if let Err(failure) = session.stream(wish).await {
            self.shared.counters.count_poll();
            self.shared.counters.fail(self.shared.link.error(failure.kind().clone()));
            let ended = self.fail(poll, failure)?;
            self.end_poll(poll, ended, 0);
            return Ok(true);
        }
        self.streamed = Some(wish.skipped);
        let is_served = self.schedules.begin_stream(poll, self.scan_time);
        self.schedules.publish(&self.shared.counters);
        Ok(is_served)
    }

    /// Polls again once nothing comes from a stream any more.
    pub(super) fn check_stream(&mut self, session: &Session) {
        if self.streamed.is_some() && !session.is_streaming() {
            self.streamed = None;
            self.schedules.end_stream();
        }
    }

    /// Delivers the next scan of the stream, or its error. Returns false if there is none now. Ends
    /// the stream if no schedule needs it, and starts it anew if none needs so many scans.
    pub(super) async fn deliver_streamed(&mut self, session: &mut Session) -> Result<bool, Stop> {
        // A sensor that sends without a pause must not keep other tasks from running.
        consume_budget().await;
        match poll_fn(|cx| Poll::Ready(session.poll_unasked(cx))).await {
            Poll::Ready(outcome) => outcome?,
            Poll::Pending => return Ok(false),
        }
        let Some(next) = session.take_streamed() else { return Ok(false) };
        if let Err(error) = &next {
            self.shared.counters.fail(self.shared.link.error(error.clone()));
        }
        for (poll, skipped) in self.schedules.take_streamed(Instant::now()) {
            self.shared.counters.count_poll();
            let ended = match &next {
                Ok(streamed) => {
                    // Sent before the stream had this window.
                    let Some(acquired) = streamed.cut(poll.window, &self.geometry) else {
                        continue;
                    };
                    let scan = self.scan_from(poll.window, acquired);
                    self.schedules.deliver(poll, scan, session.believed_baud_rate())
                }
                Err(error) => self.fail(poll, ExchangeError::Command(error.clone()))?,
            };
            self.end_poll(poll, ended, skipped);
        }
        self.schedules.drop_unread();
        let outcome = match self.schedules.stream(self.scan_time) {
            None => session.end_stream().await,
            Some(wish) if session.is_streaming() && self.streamed != Some(wish.skipped) => {
                self.streamed = Some(wish.skipped);
                session.stream(wish).await
            }
            Some(_) => Ok(()),
        };
        ignore_command_errors(outcome)?;
        Ok(true)
    }
}
