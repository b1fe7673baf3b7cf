//! Scans that the sensor sends by itself (`MD`), so that none is lost between two requests.
//!
//! While a stream runs, no request goes beside it: what one does to the stream depends on the model.
//! Every scan that is wanted is cut from the stream, whose window grows to hold it.

use std::collections::VecDeque;
use std::future::poll_fn;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::time::Instant;

use super::super::super::failure::{ExchangeError, LinkError};
use super::super::super::motor_clock::Revolution;
use super::super::super::observers::ReplyObservers;
use super::super::super::schedule::StreamWish;
use super::super::super::transport::{ReceivedFrame, ReplyTimes};
use super::super::errors::{record_malformed, record_silence};
use super::super::{Acquired, Streamed};
use super::exchange::{accepted, find_own, is_like_a_stream, raw_reply, refusal, without_label};
use super::sequence::WRAP;
use super::{LIMITS, Scip2, State, acquired};
use crate::codec::Frame;
use crate::protocol::ReplyError;
use crate::protocol::scip2::{Command, Content, Reply, Request, Scan, Status, Stream};
use crate::state::Shared;
use crate::{BaudRate, Error, ErrorKind, Geometry, Window};

/// Returns true if a line carries scans that take this long, one each `period`. A fuller line hardly
/// catches up after a pause: all come late, at a pace so even that the sensor's clock seems slow.
fn is_carried(took: Duration, period: Duration) -> bool {
    took <= period * 9 / 10
}

/// Time that the reply takes on the line. Zero if the line has no baud rate, or an unknown one.
fn wire_time(request: &Request, baud_rate: Option<BaudRate>) -> Duration {
    baud_rate.map_or(Duration::ZERO, |rate| rate.wire_time(request.reply_len().unwrap_or(0)))
}

/// Scans that were asked for once, and come until the sensor is told to stop.
#[derive(Debug, Clone, Copy)]
pub(super) struct Running {
    request: Request,
    window: Window,
    pub(super) skipped: u8,
    /// When it was asked for.
    begun: Instant,
}

/// What a stream has sent, and the driver has not yet delivered: scans and errors.
pub(super) type Waiting = VecDeque<Result<Streamed, ErrorKind>>;

impl Scip2<'_> {
    /// Returns true if the line carries the scans of a stream that holds this one, and the window of
    /// the one that runs. A replay is polled: each poll takes its next scan, whatever their rates are.
    pub(crate) fn can_stream(&mut self, wish: StreamWish) -> bool {
        if self.line.transport.is_replay() {
            return false;
        }
        let running = self.state.running.as_ref();
        let window = running.map_or(wish.window, |running| running.window.hull(&wish.window));
        let command = Command::Stream(Stream::new(self.state.data, window));
        let took =
            wire_time(&Request::new(command, None), self.line.transport.believed_baud_rate());
        is_carried(took, self.state.period(wish.skipped))
    }

    /// Starts a stream that holds the window, unless such a one runs.
    pub(crate) async fn stream(&mut self, wish: StreamWish) -> Result<(), ExchangeError> {
        let StreamWish { mut window, skipped } = wish;
        if let Some(running) = &self.state.running {
            if running.window.holds(&window) && running.skipped == skipped {
                return Ok(());
            }
            window = running.window.hull(&window);
        }
        if self.state.may_stream() {
            self.stop().await?;
        }
        let stream = Stream::new(self.state.data, window).skipping(skipped);
        let stream = stream.map_err(|error| Error::other(error).into_kind());
        let command = Command::Stream(stream.map_err(ExchangeError::Command)?);
        let answer = self.ask(command).await;
        // Without an answer, nothing tells whether the sensor sends one.
        self.state.has_stray_frames |= answer.is_err();
        let answer = accepted(answer?)?;
        let (request, begun) = (answer.request, answer.times.requested);
        let running = Running { request, window, skipped, begun };
        (self.state.running, self.state.keeps_laser) = (Some(running), Some(true));
        // The first answer may be lost, and a scan come in its place.
        if let Content::Scan(scan) = answer.content {
            self.state.add_scan(running, scan, answer.times, &self.line.shared);
        }
        self.expect_scan();
        Ok(())
    }

    /// Counts no scan before the next stream as lost: nobody asked for it.
    pub(crate) fn allow_gap(&mut self) {
        self.state.sequence.allow_gap();
    }

    /// Ends the stream, if one runs. The laser stays on.
    pub(crate) async fn end_stream(&mut self) -> Result<(), ExchangeError> {
        self.stop().await?;
        self.switch_on().await
    }

    /// Switches the laser on, if the sensor obeys.
    pub(super) async fn switch_on(&mut self) -> Result<(), ExchangeError> {
        self.state.keeps_laser = Some(true);
        match self.ask(Command::LaserOn).await {
            // There is no time for another command.
            Err(ExchangeError::Command(error)) if self.line.shared.is_closing() => {
                Err(LinkError::Silent(error).into())
            }
            // The next request shows whether the laser is on.
            Ok(_) | Err(ExchangeError::Command(_)) => Ok(()),
            Err(lost) => Err(lost),
        }
    }

    /// Waits for the next scan of the stream, and returns its part in the window of `wish`. It stays
    /// [waiting](State::waiting) as a whole, too.
    pub(super) async fn acquire_streamed(
        &mut self,
        wish: StreamWish,
    ) -> Result<Acquired, ExchangeError> {
        self.stream(wish).await?;
        loop {
            poll_fn(|cx| self.poll_frame(cx)).await?;
            match self.state.waiting.back() {
                Some(Err(error)) => return Err(ExchangeError::Command(error.clone())),
                // A scan that had been sent before the stream was started anew may lack the window.
                Some(Ok(scan)) => {
                    if let Some(acquired) = scan.cut(wish.window, &self.state.geometry) {
                        return Ok(acquired);
                    }
                }
                None => {}
            }
        }
    }

    /// Waits until a scan or an error of the stream is [waiting](State::waiting).
    pub(in super::super) fn poll_streamed(
        &mut self,
        cx: &mut Context<'_>,
    ) -> Poll<Result<(), LinkError>> {
        while self.state.waiting.is_empty() {
            ready!(self.poll_frame(cx))?;
        }
        Poll::Ready(Ok(()))
    }

    /// Receives a scan of the stream, or an error that ends it, and lets it wait.
    fn poll_frame(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), LinkError>> {
        let (before, baud_rate) =
            (self.state.waiting.len(), self.line.transport.believed_baud_rate());
        while let Some(running) = &self.state.running
            && self.state.waiting.len() == before
        {
            let request = running.request;
            let received = match ready!(self.line.transport.poll_unasked_frame(cx)) {
                Ok(received) => received,
                Err(failure) => {
                    match record_silence(&self.line.shared, request.command(), failure) {
                        ExchangeError::Link(failure) => return Poll::Ready(Err(failure)),
                        ExchangeError::Command(error) => self.state.break_off(error),
                    }
                    self.line.is_settled = false;
                    return Poll::Ready(Ok(()));
                }
            };
            let was_repeated = self.state.sequence.repeats;
            self.state.take_unasked(&received, baud_rate, &self.line.observers, &self.line.shared);
            drop(received);
            // What looks like a copy shows, too, that the sensor sends: its clock may stand still.
            if self.state.waiting.len() > before || self.state.sequence.repeats && !was_repeated {
                self.expect_scan();
            } else {
                self.line.transport.begin_frame()?;
            }
        }
        Poll::Ready(Ok(()))
    }

    /// Expects the next scan of the stream, if one runs, within the time that a command has.
    pub(super) fn expect_scan(&mut self) {
        let Some(running) = &self.state.running else { return };
        let latency = self.latency(running.request.command()) + self.state.period(running.skipped);
        let within: Duration = self.time_limit(&running.request, latency);
        self.line.transport.expect_unasked(&LIMITS, within);
    }
}

impl State {
    pub(super) fn is_streaming(&self) -> bool {
        self.running.is_some()
    }

    /// Returns true if the sensor sends a stream, or may do so.
    pub(in super::super) fn may_stream(&self) -> bool {
        self.is_streaming() || self.has_stray_frames
    }

    /// Returns true if a stream runs, or if something of it is waiting.
    #[cold]
    pub(in super::super) fn has_streamed(&self) -> bool {
        self.is_streaming() || !self.waiting.is_empty()
    }

    /// Number of bytes that the sensor may send before it answers.
    pub(super) fn bytes_on_the_way(&self) -> usize {
        let scan = self.running.as_ref().and_then(|running| running.request.reply_len());
        2 * scan.unwrap_or(0)
    }

    /// Records that the sensor has been told to send nothing more.
    pub(super) fn stopped(&mut self) {
        (self.running, self.has_stray_frames) = (None, false);
    }

    /// Takes a frame that answers no request. Counts it if it does not belong to the stream.
    pub(super) fn take_unasked(
        &mut self,
        received: &ReceivedFrame<'_>,
        baud_rate: Option<BaudRate>,
        observers: &ReplyObservers,
        shared: &Shared,
    ) {
        let times = received.times;
        let mut own = None;
        if let Frame::Reply(bytes) = received.frame() {
            own = self.take_streamed(bytes, &times, baud_rate, shared);
            observers.pass(|| raw_reply(bytes, own, times));
            self.has_stray_frames |= own.is_none() && is_like_a_stream(bytes);
        }
        if own.is_none() {
            shared.counters.lock().stats.bytes_skipped += received.wire_len();
        }
    }

    /// Lets a scan of the stream wait, and returns its request. Returns `None` if the frame is none.
    fn take_streamed(
        &mut self,
        frame: &[u8],
        times: &ReplyTimes,
        baud_rate: Option<BaudRate>,
        shared: &Shared,
    ) -> Option<(Request, ReplyTimes)> {
        let running = self.running?;
        let request = running.request;
        let Some((own, times)) = find_own(&request, frame, times, baud_rate) else {
            let error = without_label(&request, frame)?;
            self.add_malformed(&request, error, frame.len(), shared);
            return Some((request, *times));
        };
        let (rest, frame) = frame.split_at(frame.len() - own.len());
        if rest.starts_with(request.bytes())
            && let Err(error) = Reply::parse(&request, rest)
        {
            self.add_malformed(&request, error, rest.len(), shared);
        }
        match Reply::parse(&request, frame) {
            Ok(Reply { content: Content::Scan(scan), .. }) => {
                self.add_scan(running, scan, times, shared);
                // In small steps: one packet may come late. No line faster than RS-232 is ever full.
                let took = times.received.duration_since(times.began);
                let [known, least] =
                    [baud_rate, Some(BaudRate::B750000)].map(|rate| wire_time(&request, rate));
                let took = if took < least { known } else { took.max(known) };
                let step = self.period(running.skipped) / 16;
                self.took = took.clamp(self.took.saturating_sub(step), self.took + step);
            }
            // The answer to the command, once more.
            Ok(Reply { status, .. }) if status.is_ok() => {}
            Ok(Reply { status, .. }) => {
                shared.counters.lock().stats.refused += 1;
                let error = refusal(request.command(), status);
                if is_pause(status) {
                    self.waiting.push_back(Err(error));
                } else {
                    self.break_off(error);
                }
            }
            Err(error) => self.add_malformed(&request, error, frame.len(), shared),
        }
        Some((request, times))
    }

    /// Time of a revolution, measured or told.
    fn revolution(&self) -> Duration {
        self.clock.stats().map_or(self.geometry.revolution(), |motor| motor.revolution)
    }

    /// Time from one scan of a stream to the next, if the sensor leaves out `skipped` in between.
    fn period(&self, skipped: u8) -> Duration {
        self.revolution() * (u32::from(skipped) + 1)
    }

    /// Lets a scan wait, unless it is a copy of the latest one, or comes after a newer one.
    fn add_scan(&mut self, running: Running, scan: Scan, times: ReplyTimes, shared: &Shared) {
        let revolution = self.revolution();
        let Some(lost) = self.sequence.add(scan.stamp, &times, revolution, running.skipped) else {
            tracing::trace!("the line has delivered a scan twice, or an old one");
            return;
        };
        shared.counters.lock().stats.lost += lost;
        let (window, stamp) = (running.window, scan.stamp);
        let mut acquired = acquired(scan, times);
        if let Some(told) = acquired.told.as_deref_mut().filter(|_| !times.is_replayed) {
            let (stamp, turns) = (stamp.since_zero(), u32::from(running.skipped) + 1);
            let revolution = self.clock.observe(stamp, WRAP, times.began, running.begun, turns);
            // The motor may turn faster than the sensor tells, and the line may be slower than known.
            if is_carried(self.took, self.period(running.skipped)) {
                (told.revolution, told.motor) = (revolution, self.clock.stats());
            }
        }
        self.waiting.push_back(Ok(Streamed { window, acquired }));
    }

    fn add_malformed(&mut self, request: &Request, error: ReplyError, len: usize, shared: &Shared) {
        // The two LFs at its end do not count for the frame.
        let error = record_malformed(shared, request.command(), error, len as u64 + 2);
        self.waiting.push_back(Err(error.kind().clone()));
    }

    /// Gives the stream up. The sensor may still send it.
    fn break_off(&mut self, error: ErrorKind) {
        (self.running, self.has_stray_frames) = (None, true);
        self.waiting.push_back(Err(error));
    }
}

/// Returns true if the stream continues after this status: the sensor sends one while it checks for
/// an error, and one when it has found none (p. 11).
fn is_pause(status: Status) -> bool {
    matches!(status.characters(), [b'2'..=b'4', _] | [b'9', b'8'])
}

impl Streamed {
    /// What the sensor's clock tells of its revolution.
    pub(crate) fn revolution(&self) -> Revolution {
        self.acquired.told.as_ref().map(|told| told.revolution).unwrap_or_default()
    }

    /// Window of all points that the sensor sent.
    pub(crate) fn window(&self) -> Window {
        self.window
    }

    /// Part of the scan in `window`, if it holds that.
    pub(crate) fn cut(&self, window: Window, geometry: &Geometry) -> Option<Acquired> {
        if !self.window.holds(&window) {
            return None;
        }
        let Acquired { values, told, times, .. } = &self.acquired;
        let first = usize::from(window.start() - self.window.start());
        let clusters = usize::from(window.cluster_count());
        let (values, first) = if window == self.window {
            (values.clone(), 0)
        } else if clusters == 1 {
            (values.clone(), first)
        } else {
            (values.clustered(first, window.steps(), clusters, geometry), 0)
        };
        Some(Acquired { values, first, told: told.clone(), times: *times })
    }
}
