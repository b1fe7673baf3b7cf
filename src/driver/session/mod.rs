//! [`Session`]: one open port, and what the driver wants of the sensor behind it.
//!
//! This is the line between what the driver means and what a protocol says. Above it, the driver
//! has these intentions. Each returns an outcome that the protocol has confirmed:
//!
//! | intention | confirmed |
//! |---|---|
//! | [`find`](Session::find) | the sensor answers at the port's baud rate, in this protocol |
//! | [`identify`](Session::identify) | a flipped bit has not changed the identity |
//! | [`set_laser`](Session::set_laser) | the sensor measures, or refuses to |
//! | [`set_baud_rate`](Session::set_baud_rate) | the sensor answers at the new baud rate |
//! | [`probe`](Session::probe) | the sensor answers, and no older reply can follow |
//! | [`acquire`](Session::acquire) | the values answer this request |
//! | [`state`](Session::state) | the reply answers this request |
//!
//! Below it, a protocol knows its commands, tells replies apart, and judges bytes that come unasked.

mod baud_rate;
mod errors;
mod identity;
mod line;
mod scip1;
mod scip2;

use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::Instant;

use self::errors::{not_confirmed, on_behalf_of};
use self::line::Line;
use self::scip1::{Answer, EchoKind, Scip1, UniqueRequests, Widened, accepted};
use self::scip2::Scip2;
use super::config::{Config, Wanted};
use super::failure::{ExchangeError, LinkError};
use super::motor_clock::Revolution;
use super::rarely::rarely;
use super::transport::{ReplyTimes, Transport};
use crate::port::Port;
use crate::protocol::scip2::{Command as Scip2Command, State, Status};
use crate::protocol::{Command, Protocol, Text};
use crate::scan::Values;
use crate::state::{Shared, VersionReply};
use crate::stats::MotorStats;
use crate::{BaudRate, ErrorKind, Geometry, Window};

/// Values of a window.
#[derive(Debug)]
pub(crate) struct Acquired {
    pub(crate) values: Values,
    /// Index of the window's first value: the protocol may have asked for values around the window.
    pub(crate) first: usize,
    /// What the sensor has told of its clock.
    pub(crate) told: Option<Box<Told>>,
    pub(crate) times: ReplyTimes,
}

/// Clock of a sensor, and what it shows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Told {
    /// Milliseconds when the sensor measured step 0.
    pub(crate) clock: u32,
    /// What is known of the revolution, from the scans of a stream.
    pub(crate) revolution: Revolution,
    pub(crate) motor: Option<MotorStats>,
}

/// Scan of a stream, with all points that the sensor sent.
#[derive(Debug)]
pub(crate) struct Streamed {
    window: Window,
    acquired: Acquired,
}

/// Identity of a sensor.
#[derive(Debug)]
pub(crate) struct Identity {
    pub(crate) reply: VersionReply,
    /// True if the serial number is not empty, and was known or is the same in two replies.
    pub(crate) is_serial_number_confirmed: bool,
    /// What it measures, if that was known or is the same in two replies.
    pub(crate) geometry: Option<Geometry>,
}

/// What a session leaves for the next one.
#[derive(Debug)]
pub(crate) struct Leftovers {
    /// The next session may read replies to these: the system keeps bytes while a port is closed.
    unique_requests: UniqueRequests,
    /// True if the sensor may hold part of a command. An LF ends it, and can cost a revolution.
    interrupted: bool,
}

impl Leftovers {
    /// Before the first session, an earlier program may have left replies to anything.
    pub(crate) fn unknown() -> Self {
        Self { unique_requests: UniqueRequests::random(), interrupted: false }
    }
}

/// Open port, and the protocol that the sensor speaks.
pub(crate) struct Session {
    wanted: Wanted,
    scip1: Scip1,
    /// `Some` while the sensor speaks SCIP 2.
    scip2: Option<Box<scip2::State>>,
}

impl Session {
    pub(crate) fn new(
        port: Box<dyn Port>,
        config: &Config,
        before: Leftovers,
        shared: Arc<Shared>,
    ) -> Self {
        let Leftovers { unique_requests, interrupted } = before;
        shared.counters.lock().stats.baud_rate_disproved = false;
        // Another program may have left a stream of scans, which the system has kept.
        let transport = Transport::new(port, &scip2::LIMITS, interrupted);
        let line = Line {
            transport,
            // The last user of the port may have left bytes behind.
            is_settled: false,
            reply_latency: config.reply_latency,
            observers: Arc::clone(&config.observers),
            shared,
        };
        let scip1 = Scip1 { line, unique_requests };
        Self { wanted: config.wanted, scip1, scip2: None }
    }

    /// Closes the port.
    pub(crate) fn close(self) -> Leftovers {
        let interrupted = self.scip1.line.transport.interrupted;
        Leftovers { unique_requests: self.scip1.unique_requests, interrupted }
    }

    /// `Some` while the sensor speaks SCIP 2.
    fn scip2(&mut self) -> Option<Scip2<'_>> {
        let line = &mut self.scip1.line;
        self.scip2.as_mut().map(|state| Scip2 { line, state })
    }

    /// Returns true if a [`probe`](Self::probe) must come first, as far as known without reading.
    pub(crate) fn needs_probe(&self) -> bool {
        (!self.scip1.line.is_settled || !self.scip1.line.transport.pending().is_empty())
            && !self.is_streaming()
    }

    /// Waits for bytes that no command asks for. A scan of a stream can be
    /// [taken](Self::take_streamed) then; otherwise the session [needs a probe](Self::needs_probe).
    pub(crate) fn poll_unasked(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), LinkError>> {
        if self.is_streaming() {
            return self.poll_streamed(cx);
        }
        self.scip1.line.transport.poll_idle(cx)
    }

    /// Waits for what a stream sends.
    #[cold]
    pub(crate) fn poll_streamed(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), LinkError>> {
        self.scip2().map_or(Poll::Pending, |mut scip2| scip2.poll_streamed(cx))
    }

    /// Streams of the sensor, if the protocol has them: scans that it sends without being asked again.
    pub(crate) fn streams(&mut self) -> Option<Scip2<'_>> {
        self.scip2()
    }

    /// Returns true while the sensor does, or something that it sent is not yet taken.
    pub(crate) fn is_streaming(&self) -> bool {
        self.scip2.as_ref().is_some_and(|state| state.has_streamed())
    }

    /// Takes the next scan of the stream, or an error in its place.
    pub(crate) fn take_streamed(&mut self) -> Option<Result<Streamed, ErrorKind>> {
        self.scip2.as_mut()?.waiting.pop_front()
    }

    /// Ends the stream, if the sensor answers at once, because the driver ends.
    pub(crate) async fn stop_stream(&mut self) {
        if self.scip2.as_ref().is_some_and(|state| state.may_stream())
            && let Some(mut scip2) = self.scip2()
        {
            let _ = scip2.stop().await;
        }
    }

    pub(crate) fn heard_at(&self) -> Option<Instant> {
        self.scip1.line.transport.latest_at
    }

    pub(crate) fn can_die_silently(&mut self) -> bool {
        self.scip1.line.transport.can_die_silently()
    }

    pub(crate) fn delivers_intact(&mut self) -> bool {
        self.scip1.line.transport.delivers_intact()
    }

    /// Returns true if a reply begins when a revolution of the motor ends, and arrives without a
    /// delay of the line: then the arrivals show the motor.
    pub(crate) fn shows_motor(&mut self) -> bool {
        self.scip2.is_none() && self.delivers_intact()
    }

    /// Baud rate of the port, unless it has none.
    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.scip1.line.transport.baud_rate()
    }

    /// Baud rate of the line, unless it has none or a reply has disproved it.
    pub(crate) fn believed_baud_rate(&self) -> Option<BaudRate> {
        self.scip1.line.transport.believed_baud_rate()
    }

    /// Returns true if the sensor can be searched for at several baud rates.
    pub(crate) fn is_searchable(&self) -> bool {
        self.scip1.line.is_searchable()
    }

    /// Drops pending input, and asks until there is an answer. Returns true if the sensor
    /// measures: it refuses to while its laser is off.
    pub(crate) async fn probe(&mut self) -> Result<bool, ExchangeError> {
        match self.scip2() {
            Some(mut scip2) => {
                scip2.stop_stray().await?;
                scip2.probe().await.map(Status::is_ok)
            }
            None => self.scip1.probe().await,
        }
    }

    /// Asks for the values of `window`, whose steps are the sensor's.
    pub(crate) async fn acquire(&mut self, window: Window) -> Result<Acquired, ExchangeError> {
        if let Some(mut scip2) = self.scip2() {
            return rarely(|| scip2.acquire(window)).await;
        }
        // Here, and not in a future of its own, which would cost each scan of SCIP 1.1 more.
        let scip1 = &mut self.scip1;
        // First, so that the fence's `clear` cannot forget this request.
        if !scip1.is_quiet()? {
            scip1.settle().await.map_err(on_behalf_of(Command::Distances(window)))?;
        }
        let Widened { asked, first, repeats } = match scip1.choose(window) {
            Some(widened) => widened,
            None => rarely(|| scip1.choose_after_fence(window)).await?,
        };
        scip1.line.shared.counters.count_poll();
        let echo = if repeats { EchoKind::Repeated } else { EchoKind::Unique };
        let command = Command::Distances(asked);
        let Answer { reply, times } = accepted(&command, scip1.exchange(command, echo).await?)?;
        Ok(Acquired { values: Values::Short(reply.into_values()), first, told: None, times })
    }

    /// Returns when [`acquire`](Self::acquire) of this window needs no further command to rule out a
    /// copy of the latest reply, or `None` if it needs none now.
    pub(crate) fn copies_end(&mut self, window: Window) -> Option<Instant> {
        if self.scip2.is_some() { None } else { self.scip1.copies_end(window) }
    }

    /// Asks the sensor for its state, where the protocol has it.
    pub(crate) async fn state(&mut self) -> Result<Option<State>, ExchangeError> {
        match self.scip2() {
            Some(mut scip2) => scip2.state().await.map(Some),
            None => Ok(None),
        }
    }

    /// Restarts the sensor. Returns once it must be silent, or the port has ended.
    pub(crate) async fn reboot(&mut self) -> Result<(), ExchangeError> {
        match self.scip2() {
            Some(mut scip2) => scip2.reboot().await,
            None => Err(ExchangeError::Command(ErrorKind::UnsupportedReboot)),
        }
    }

    /// Switches the laser, and checks whether the sensor measures.
    ///
    /// # Errors
    ///
    /// [`NotConfirmed`](ErrorKind::NotConfirmed) if it stays as it is. [`Refused`](ErrorKind::Refused)
    /// if the sensor refuses both the command and to measure: the laser may be on or off.
    pub(crate) async fn set_laser(&mut self, on: bool) -> Result<(), ExchangeError> {
        match self.scip2() {
            Some(mut scip2) => scip2.set_laser(on).await,
            None => self.scip1.set_laser(on).await,
        }
    }

    /// Begins with a sensor that has answered in SCIP 1.1.
    async fn begin_in_scip1(&mut self) -> Result<(), ExchangeError> {
        if self.wanted.protocol != Some(Protocol::Scip2) {
            return Ok(());
        }
        let state = self.scip2.insert(Box::new(scip2::State::new(self.wanted.intensities)));
        let outcome = Scip2 { line: &mut self.scip1.line, state }.enter().await;
        if outcome.is_err() {
            self.scip2 = None;
        }
        outcome
    }

    /// Begins with a sensor that has answered in SCIP 2, which `error` says.
    async fn begin_in_scip2(&mut self, error: ErrorKind) -> Result<(), ExchangeError> {
        if self.wanted.protocol == Some(Protocol::Scip1) {
            return Err(LinkError::Silent(error).into());
        }
        let state = self.scip2.insert(Box::new(scip2::State::new(self.wanted.intensities)));
        Scip2 { line: &mut self.scip1.line, state }.stop().await
    }

    /// Sends one command that every sensor answers.
    async fn probe_once(&mut self, latency: Duration) -> Result<(), ExchangeError> {
        match self.scip2() {
            Some(mut scip2) => scip2.probe_once(latency).await.map(drop),
            None => self.scip1.fence_once(latency).await.map(drop),
        }
    }

    /// Confirms that the sensor is at this baud rate, which is the port's.
    async fn confirm_baud_rate(&mut self, baud_rate: BaudRate) -> Result<(), ExchangeError> {
        let asked = Command::BaudRate(baud_rate);
        match self.scip2() {
            Some(mut scip2) => scip2.probe().await.map(drop),
            None => self.scip1.fence().await.map(drop),
        }
        .map_err(on_behalf_of(asked))
    }

    /// Sends the command for a baud rate, and returns the status if the sensor obeys.
    async fn send_baud_rate(&mut self, baud_rate: BaudRate) -> Result<Text, ExchangeError> {
        match self.scip2() {
            Some(mut scip2) => scip2.send_baud_rate(baud_rate).await,
            None => self.scip1.send_baud_rate(baud_rate).await,
        }
    }

    /// Sends the command for a baud rate on a port without one. Over USB a sensor of SCIP 1.1 accepts
    /// it without effect (C-42-3320-A p. 5); one of SCIP 2 may refuse it.
    async fn send_baud_rate_over_usb(&mut self, baud_rate: BaudRate) -> Result<(), ExchangeError> {
        match self.scip2 {
            Some(_) => self.confirm_baud_rate(baud_rate).await,
            None => self.scip1.send_baud_rate_twice(baud_rate).await,
        }
    }

    fn baud_rate_not_confirmed(&self, baud_rate: BaudRate, status: Option<Text>) -> ErrorKind {
        match &self.scip2 {
            Some(_) => not_confirmed(&Scip2Command::BaudRate(baud_rate), status, None),
            None => not_confirmed(&Command::BaudRate(baud_rate), status, None),
        }
    }
}
