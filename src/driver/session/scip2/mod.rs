//! SCIP 2: each request has a label of its own, which its reply echoes. A frame with another is older,
//! such as an answer that a UST repeats after the next request (acfr/snark 325b2fa1): it is dropped. A
//! sensor that echoes no label is asked without.
//!
//! The driver asks for the newest scan each time (`GD`), or once for every scan (`MD`, in `stream`).
//! `exchange` sends one request and waits for its reply.

mod exchange;
mod sequence;
mod stream;

use std::time::Duration;

use self::exchange::{Answer, accepted, refusal, text};
use self::sequence::Sequence;
use self::stream::{Running, Waiting};
use super::super::failure::{ExchangeError, LinkError};
use super::super::motor_clock::Revolution;
use super::super::schedule::StreamWish;
use super::super::sensor_clock::SensorClock;
use super::super::transport::{Expected, Limits, ReplyTimes};
use super::errors::{malformed, no_reply, not_confirmed, on_behalf_of};
use super::line::{Line, TRIES_AT_A_BAUD_RATE};
use super::{Acquired, Told};
use crate::codec::Frame;
use crate::protocol::scip2::{self, Command, Content, Data, Label, Request, Scan, Stamp, Status};
use crate::protocol::{MalformedError, Protocol, Text};
use crate::scan::Values;
use crate::state::{ParametersReply, VersionReply};
use crate::{BaudRate, ErrorKind, Geometry, Window};

/// Longest reply: `ME` of a UST-10LX-H01's 2,161 steps has 13,399 bytes. Another program may have left a
/// stream of these, 40 a second.
pub(super) const LIMITS: Limits = Limits { frame: 16 * 1024, frames: 256, bytes: 1024 * 1024 };
/// How long to wait until a sensor restarts: urg_stamped's urg_sim answers for another second.
const RESTART: Duration = Duration::from_millis(1500);
/// Command that makes a URG-04LX leave SCIP 1.1. It has no label, and is answered in SCIP 1.1.
const ENTER: &[u8] = b"SCIP2.0";
/// Number of answers to it that are read, at most.
const ENTRIES: usize = 4;

/// What is known of the sensor in SCIP 2.
#[derive(Debug)]
pub(super) struct State {
    /// Number of the latest label.
    label: u64,
    /// True if the sensor repeats labels, once it has answered.
    has_labels: Option<bool>,
    /// True if the sensor may send a stream that another program has left.
    has_stray_frames: bool,
    /// Whether the laser is to be on, also once a stray stream was stopped. `None` until it is switched.
    keeps_laser: Option<bool>,
    /// Smallest selection that the sensor measures.
    one_step: Option<Window>,
    geometry: Geometry,
    wants_intensities: bool,
    /// What to ask for.
    data: Data,
    /// Stream that the sensor sends.
    running: Option<Running>,
    /// What the stream has sent, and the driver has not yet delivered.
    pub(super) waiting: Waiting,
    clock: SensorClock,
    sequence: Sequence,
    /// Typical time that a scan of a stream takes to arrive.
    took: Duration,
}

impl State {
    pub(super) fn new(wants_intensities: bool) -> Self {
        Self {
            // Random, so that no reply to an earlier process matches a request.
            label: fastrand::u64(..),
            has_labels: None,
            has_stray_frames: false,
            keeps_laser: None,
            one_step: None,
            geometry: Geometry::URG_04LX,
            wants_intensities,
            data: Data::Distances,
            running: None,
            waiting: Waiting::new(),
            clock: SensorClock::new(Geometry::URG_04LX.revolution()),
            sequence: Sequence::default(),
            took: Duration::ZERO,
        }
    }

    /// Returns a label unlike the ones before, unless the sensor repeats none.
    fn next_label(&mut self) -> Option<Label> {
        self.label = self.label.wrapping_add(1);
        (self.has_labels != Some(false)).then(|| Label::numbered(self.label))
    }
}

/// Line to a sensor that speaks SCIP 2.
pub(crate) struct Scip2<'a> {
    pub(super) line: &'a mut Line,
    pub(super) state: &'a mut State,
}

/// Converts a scan as the sensor sent it.
fn acquired(scan: Scan, times: ReplyTimes) -> Acquired {
    let told = match scan.stamp {
        Stamp::Milliseconds(clock) => Some(clock),
        Stamp::Microseconds(_) => None,
    };
    let told = told.map(|clock| Told { clock, revolution: Revolution::default(), motor: None });
    let has_intensities = !scan.intensities().is_empty();
    let kind = if has_intensities { Values::WithIntensities } else { Values::Long };
    Acquired { values: kind(scan.into_values()), first: 0, told: told.map(Box::new), times }
}

/// Returns true if a reply had the status of SCIP 1.1.
fn is_in_scip1(error: &ErrorKind) -> bool {
    matches!(error, ErrorKind::Malformed { source: MalformedError::Status { .. }, .. })
}

impl Scip2<'_> {
    /// Makes a URG-04LX speak SCIP 2, whose laser is then off.
    ///
    /// # Errors
    ///
    /// [`WrongProtocol`](ErrorKind::WrongProtocol) if it only knows SCIP 1.1.
    pub(super) async fn enter(&mut self) -> Result<(), ExchangeError> {
        let mut answer = self.enter_once().await;
        for _ in 1..ENTRIES {
            // A flipped bit changes the status unseen. A refusal in SCIP 2 has two characters and a sum.
            match &answer {
                Ok(status) if matches!(status.as_bytes(), [b'0'] | [_, _, _]) => {
                    return self.stop().await;
                }
                Err(ExchangeError::Link(_)) => break,
                _ => answer = self.enter_once().await,
            }
        }
        let (expected, status) = (Protocol::Scip2, answer?);
        Err(LinkError::Silent(ErrorKind::WrongProtocol { expected, status }).into())
    }

    /// Sends the command that makes a URG-04LX speak SCIP 2, and returns the status.
    async fn enter_once(&mut self) -> Result<Text, ExchangeError> {
        let command = Command::Version;
        let late = |failure| no_reply(&command, failure);
        let within = self.time_limit(&Request::new(command, None), self.latency(&command));
        let expected = Expected { reply: None, limits: &LIMITS };
        self.line.transport.send(ENTER, &expected, within).await.map_err(late)?;
        loop {
            let received = self.line.transport.next_frame().await.map_err(late)?;
            if let Frame::Reply(frame) = received.frame()
                && let Some(status) = frame.strip_prefix(ENTER)
            {
                return Ok(status.trim_ascii().into());
            }
        }
    }

    /// Stops a stream that another program may have left. The laser is off then, as after power-up,
    /// unless the sensor refuses to stop now.
    pub(super) async fn stop(&mut self) -> Result<(), ExchangeError> {
        let mut outcome = Ok(());
        for _ in 0..TRIES_AT_A_BAUD_RATE {
            outcome = match self.ask(Command::LaserOff).await {
                Ok(answer) if answer.status.is_ok() => return Ok(()),
                Ok(_) => Ok(()),
                Err(ExchangeError::Command(error)) => Err(LinkError::Silent(error).into()),
                Err(lost) => return Err(lost),
            };
            if self.line.shared.is_closing() {
                break;
            }
        }
        outcome
    }

    /// Stops a stream that the sensor may send unknown to this session. The laser stays as it was set.
    pub(super) async fn stop_stray(&mut self) -> Result<(), ExchangeError> {
        match (self.state.has_stray_frames, self.state.keeps_laser) {
            (false, _) => Ok(()),
            (true, Some(true)) => self.end_stream().await,
            (true, _) => self.stop().await,
        }
    }

    pub(super) async fn version(&mut self) -> Result<VersionReply, ExchangeError> {
        let answer = self.ask_twice(Command::Version).await?;
        let frame = answer.known_frame().into();
        match answer.content {
            Content::Version(version) => Ok(VersionReply { version, frame, parameters: None }),
            _ => Err(no_data(Command::Version)),
        }
    }

    /// Reads what the sensor measures. In clock mode, where a program that ended may have left it, it
    /// refuses to tell (p. 15).
    pub(super) async fn parameters(&mut self) -> Result<ParametersReply, ExchangeError> {
        let mut answer = self.ask_twice(Command::Parameters).await;
        if matches!(&answer, Err(ExchangeError::Command(ErrorKind::Refused { .. })))
            && self.ask_twice(Command::LeaveClockMode).await.is_ok()
        {
            answer = self.ask_twice(Command::Parameters).await;
        }
        let answer = answer?;
        let frame = answer.known_frame();
        let Content::Parameters(parameters) = answer.content else {
            return Err(no_data(Command::Parameters));
        };
        let first = *parameters.steps.start();
        self.state.one_step = Window::new(first..=first).ok();
        self.state.geometry = parameters.geometry();
        self.state.clock = SensorClock::new(self.state.geometry.revolution());
        let has_intensities = self.state.wants_intensities && parameters.has_intensities();
        self.state.data = if has_intensities { Data::Intensities } else { Data::Distances };
        Ok(ParametersReply { parameters, frame })
    }

    /// Asks for the sensor's state (`II`). Ends the stream first: in one, a UTM would send half scans.
    pub(super) async fn state(&mut self) -> Result<scip2::State, ExchangeError> {
        self.stop_stray().await?;
        match self.ask_twice(Command::State).await?.content {
            Content::State(state) => Ok(state),
            _ => Err(no_data(Command::State)),
        }
    }

    /// Restarts the sensor by two commands within a second. A UST leaves some of them unanswered, and
    /// restarts all the same (urg_stamped's pull request 71).
    pub(super) async fn reboot(&mut self) -> Result<(), ExchangeError> {
        let (mut was_alive, mut tries) = (false, 3);
        loop {
            tries -= 1;
            let failure = match self.exchange(Command::Reboot).await {
                Ok(answer) => {
                    let status = accepted(answer)?.status;
                    if status.is_ok() {
                        self.await_restart().await;
                        return Ok(());
                    }
                    was_alive = true;
                    ExchangeError::Command(refusal(&Command::Reboot, status))
                }
                Err(ExchangeError::Link(_)) if was_alive => return Ok(()),
                Err(failure) if failure.is_lost_reply() && !self.line.shared.is_closing() => {
                    if tries == 0 {
                        // Until it restarts, it answers.
                        self.await_restart().await;
                    }
                    if self.line.shared.is_closing() {
                        return Err(failure);
                    }
                    let probe = self.probe_once(self.latency(&Command::Reboot)).await;
                    if was_alive && probe.is_err() {
                        return Ok(());
                    }
                    was_alive |= probe.is_ok();
                    failure
                }
                Err(failure) => return Err(failure),
            };
            if tries == 0 {
                return Err(failure);
            }
        }
    }

    /// Waits until a sensor that restarts must be silent, or the port has ended: the system reuses the name
    /// of a USB port only if that is closed before the sensor is back.
    async fn await_restart(&mut self) {
        self.line.transport.expect_unasked(&LIMITS, RESTART);
        while self.line.transport.next_frame().await.is_ok() {}
    }

    /// Asks for one step until there is an answer. Its status is a refusal while the laser is off.
    pub(super) async fn probe(&mut self) -> Result<Status, ExchangeError> {
        let mut failure = LinkError::Silent(ErrorKind::disconnected(None));
        let mut in_scip1 = 0;
        for _ in 0..self.line.tries() {
            match self.probe_once(self.latency(&self.one_step())).await {
                Err(ExchangeError::Command(error)) => {
                    in_scip1 += usize::from(is_in_scip1(&error));
                    failure = LinkError::Silent(error);
                }
                outcome => return outcome,
            }
            // One may be damaged. A URG-04LX that has restarted answers nothing else.
            if in_scip1 == 2 || self.line.shared.is_closing() {
                break;
            }
        }
        Err(failure.into())
    }

    /// Asks for one step. Any status is an answer.
    pub(super) async fn probe_once(&mut self, latency: Duration) -> Result<Status, ExchangeError> {
        self.exchange_within(latency, self.one_step(), true).await.map(|answer| answer.status)
    }

    fn one_step(&self) -> Command {
        match self.state.one_step {
            Some(window) => Command::Latest { data: Data::Distances, window },
            None => Command::Version,
        }
    }

    /// Asks for the newest scan, or takes the next one of the stream.
    pub(super) async fn acquire(&mut self, window: Window) -> Result<Acquired, ExchangeError> {
        self.line.shared.counters.count_poll();
        let wish =
            self.state.running.map(|running| StreamWish { window, skipped: running.skipped });
        // Otherwise the stream would become too slow for its readers: the request ends it.
        if let Some(wish) = wish.filter(|wish| self.can_stream(*wish)) {
            return self.acquire_streamed(wish).await;
        }
        self.prepare().await?;
        let command = Command::Latest { data: self.state.data, window };
        let answer = accepted(self.exchange(command).await?)?;
        match answer.content {
            Content::Scan(scan) => Ok(acquired(scan, answer.times)),
            _ => Err(no_data(command)),
        }
    }

    /// Sees to it that the next request for a scan is answered, and by nothing older.
    async fn prepare(&mut self) -> Result<(), ExchangeError> {
        self.stop_stray().await?;
        if self.state.has_labels == Some(false) && !self.line.is_settled {
            // Nothing else tells a late reply from the newest scan.
            self.probe().await?;
        }
        match self.state.keeps_laser {
            None => self.switch_on().await,
            Some(_) => Ok(()),
        }
    }

    /// Switches the laser, and checks by a probe whether the sensor measures.
    pub(super) async fn set_laser(&mut self, on: bool) -> Result<(), ExchangeError> {
        self.state.keeps_laser = Some(on);
        let command = if on { Command::LaserOn } else { Command::LaserOff };
        let status = match self.ask_twice(command).await {
            Ok(answer) => Some(text(answer.status)),
            // The probe shows what the sensor did. It would end a stream, and switch the laser on.
            Err(failure) if failure.is_lost_reply() && !self.state.is_streaming() => None,
            Err(error) => return Err(error),
        };
        let mut probe = self.probe().await.map_err(on_behalf_of(command))?;
        let is_off = |probe: Status| probe.characters() == *b"10";
        // Any refusal but `10` tells nothing of the laser (p. 13), and may pass.
        if !probe.is_ok() && !is_off(probe) && !self.line.shared.is_closing() {
            probe = self.probe().await.map_err(on_behalf_of(command))?;
        }
        Err(ExchangeError::Command(match probe.is_ok() {
            true if on => return Ok(()),
            false if !on && is_off(probe) => return Ok(()),
            false if !on => refusal(&self.one_step(), probe),
            _ => not_confirmed(&command, status, on.then(|| text(probe))),
        }))
    }

    /// Sends `SS`, and returns the status if the sensor obeys.
    pub(super) async fn send_baud_rate(
        &mut self,
        baud_rate: BaudRate,
    ) -> Result<Text, ExchangeError> {
        let answer = self.exchange(Command::BaudRate(baud_rate)).await?;
        accepted(answer).map(|answer| text(answer.status))
    }

    /// Sends a command, once more if there was no answer, and fails unless the sensor accepts it.
    async fn ask_twice(&mut self, command: Command) -> Result<Answer, ExchangeError> {
        let answer = match self.exchange(command).await {
            Err(failure) if failure.is_lost_reply() && !self.line.shared.is_closing() => {
                self.exchange(command).await
            }
            outcome => outcome,
        };
        accepted(answer?)
    }
}

/// Error for a reply without the data that its command has.
fn no_data(command: Command) -> ExchangeError {
    ExchangeError::Command(malformed(&command, MalformedError::NoData))
}
