//! [`Session`]: what the commands of SCIP 2 have set, and how a sensor answers them.

use std::time::Duration;

use tokio::time::Instant;

use super::command::{Asked, Command, Data, Unit};
use super::{encode, texts};
use crate::body::{Answer, Body, Effect, Measure, Steps};
use crate::line_buffer::CommandLine;
use crate::models::Model;

/// Longest time between the two `RB` that restart a sensor.
const REBOOT_WINDOW: Duration = Duration::from_secs(1);

/// Times that a reply has.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Times {
    pub(crate) now: Instant,
    /// Sensor's clock now, in microseconds.
    pub(crate) clock: u64,
    /// Sensor's clock at step 0 of the newest scan.
    pub(crate) scan: u64,
}

/// Behaviour of some real sensors that contradicts the protocol text. A model has its own besides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Quirk {
    /// `VV` has one line more, with the sum of the serial number, whose own line has a wrong one: as
    /// of some URG-04LX.
    SerialSumApart,
    /// The sums of `II` end before `<-`: as of some UTM-30LX.
    ShortStateSums,
    /// `TM1` is answered when the clock reaches a multiple of 5 ms: as of a UST with firmware 4.0.2.
    ClockTicks,
    /// Replies do not repeat the text of their command: as of devices of other makers.
    NoLabels,
}

/// State of a sensor in SCIP 2.
#[derive(Debug, Clone, Default)]
pub(crate) struct Session {
    pub(crate) quirks: Vec<Quirk>,
    stream: Option<Stream>,
    is_in_clock_mode: bool,
    is_asleep: bool,
    /// True if the sensor answers nothing until its power is cut.
    pub(crate) is_locked: bool,
    motor_speed: u8,
    rebooted_at: Option<Instant>,
}

/// Scans that are sent without being asked for again.
#[derive(Debug, Clone)]
pub(crate) struct Stream {
    /// Echo, whose number of scans counts down.
    pub(crate) echo: Vec<u8>,
    asked: Asked,
    /// Number of scans to skip after each one sent.
    pub(crate) skipped: u16,
    /// Number of scans that are left, unless it is endless.
    left: Option<u16>,
    pub(crate) requested_at: Instant,
    /// True if `II` has disturbed it.
    is_halved: bool,
    /// Reply to send within the next scan.
    split_by: Vec<u8>,
}

impl Session {
    /// Resets what commands have set.
    pub(crate) fn power_up(&mut self) {
        *self = Self { quirks: std::mem::take(&mut self.quirks), ..Self::default() };
    }

    pub(crate) fn stream(&self) -> Option<&Stream> {
        self.stream.as_ref().filter(|_| !self.is_locked)
    }

    /// Starts the stream that a host has left, of all steps of the sensor's window.
    pub(crate) fn leave_streaming(&mut self, body: &mut Body, now: Instant) {
        let geometry = body.geometry(true);
        let line = format!("MD{:04}{:04}01000", geometry.first, geometry.last);
        let steps = Steps { start: geometry.first, end: geometry.last, cluster: 1 };
        let asked = Asked { data: Data::Distances, steps, unit: Unit::Milliseconds };
        self.start(line.as_bytes(), asked, 0, 0, now);
        body.is_laser_on = true;
    }

    /// Executes a command line. Calls `measure` only if distances are sent.
    pub(crate) fn execute(
        &mut self,
        body: &mut Body,
        arrived: &CommandLine,
        times: Times,
        measure: Measure<'_>,
    ) -> Answer {
        let mut line = &arrived.bytes[..];
        let parsed = Command::parse(line, arrived.too_long, body);
        if self.quirks.contains(&Quirk::NoLabels) {
            line = line.split(|&byte| byte == b';').next().unwrap_or_default();
        }
        let command = match parsed {
            Err(refusal) => return status(line, refusal),
            Ok(_) if arrived.repeated => return status(line, b"0B"),
            Ok(command) => command,
        };
        if let Some(refusal) = self.refusal(&command, body) {
            return status(line, refusal);
        }
        match command {
            Command::Version => self.version(body, line),
            Command::Parameters => encode::texts(line, texts::parameters(body), false).into(),
            Command::State => self.state(body, line, times),
            Command::StateCode => encode::characters(line, self.state_code(body)).into(),
            Command::LaserOn => {
                body.is_laser_on = true;
                done(line, Effect::LaserOn)
            }
            Command::LaserOff => {
                let split_by = self.stream.take().map(|stream| stream.split_by);
                (body.is_laser_on, self.is_asleep) = (false, false);
                let mut answer = done(line, Effect::None);
                answer.bytes.splice(0..0, split_by.unwrap_or_default());
                answer
            }
            Command::Reset { all } => {
                let motor_speed = if all { 0 } else { self.motor_speed };
                self.power_up();
                self.motor_speed = motor_speed;
                body.is_laser_on = false;
                done(line, Effect::Reset { all })
            }
            Command::Reboot => {
                let first = self.rebooted_at.replace(times.now);
                match first.is_some_and(|first| times.now < first + REBOOT_WINDOW) {
                    true => done(line, Effect::Reboot),
                    false => status(line, b"01"),
                }
            }
            Command::Sleep | Command::EnterClockMode => {
                self.stream = None;
                body.is_laser_on = false;
                self.is_asleep = command == Command::Sleep;
                self.is_in_clock_mode = !self.is_asleep;
                done(line, Effect::None)
            }
            Command::Clock(unit) => {
                let tick = if self.quirks.contains(&Quirk::ClockTicks) { 5000 } else { 1 };
                let effect = Effect::Wait(times.clock.next_multiple_of(tick) - times.clock);
                Answer { bytes: encode::characters(line, &time(times.clock, unit)), effect }
            }
            Command::LeaveClockMode => {
                self.is_in_clock_mode = false;
                done(line, Effect::None)
            }
            Command::BaudRate(Some(baud_rate)) if body.baud_rate.is_some() => {
                done(line, Effect::BaudRate(baud_rate))
            }
            Command::MotorSpeed(speed) => {
                self.motor_speed = speed % 99;
                done(line, Effect::MotorSpeed(self.motor_speed))
            }
            Command::BaudRate(_) | Command::Sensitivity => done(line, Effect::None),
            Command::Latest(asked) => {
                let bytes = scan(body, line, *b"00", asked, times, false, measure);
                Answer { bytes, effect: Effect::Scan }
            }
            Command::Stream { asked, skipped, count } => {
                self.start(line, asked, skipped, count, arrived.at);
                body.is_laser_on = true;
                done(line, Effect::Stream)
            }
            Command::Locking => {
                self.is_locked = true;
                Answer::default()
            }
        }
    }

    /// Status of a valid command that the sensor cannot execute in its state, or that changes
    /// nothing.
    fn refusal(&self, command: &Command, body: &Body) -> Option<&'static [u8; 2]> {
        use Command as C;
        let is_new = body.model == Model::Ust10lx;
        Some(match command {
            C::EnterClockMode if self.is_in_clock_mode => b"02",
            C::LeaveClockMode if !self.is_in_clock_mode => b"03",
            // "It will not accept any other commands" (p. 15). urg_library knows the mode by 0E.
            _ if self.is_in_clock_mode && !command.is_for_clock_mode() => {
                if is_new {
                    b"10"
                } else {
                    b"0E"
                }
            }
            C::EnterClockMode if is_new && self.stream.is_some() => b"10",
            C::LaserOn | C::Stream { .. } | C::EnterClockMode if self.is_asleep => b"10",
            C::LaserOn if body.is_laser_on => b"02",
            C::Latest(_) if !body.is_laser_on => b"10",
            C::BaudRate(_) if is_new => b"0F",
            C::BaudRate(_) if body.model != Model::Urg04lx => b"04",
            C::BaudRate(None) => b"04",
            C::BaudRate(rate) if *rate == body.baud_rate => b"03",
            C::MotorSpeed(_) if matches!(body.model, Model::Utm30lx | Model::Ust10lx) => b"04",
            C::MotorSpeed(speed) if speed % 99 == self.motor_speed => b"03",
            _ => return None,
        })
    }

    /// Begins the next scan of the stream.
    pub(crate) fn count_down(&mut self) -> Option<&Stream> {
        let stream = self.stream.as_mut().filter(|_| !self.is_locked)?;
        stream.count_down();
        Some(stream)
    }

    /// Scan of the stream that has [begun](Self::count_down), with what `II` has done to it; or a status
    /// or the bytes of a script in its place.
    pub(crate) fn next_scan(
        &mut self,
        body: &mut Body,
        times: Times,
        refusal: Option<u8>,
        scripted: Option<Vec<u8>>,
        measure: Measure<'_>,
    ) -> Vec<u8> {
        let Some(stream) = &mut self.stream else { return Vec::new() };
        let mut bytes = match (refusal, scripted) {
            (Some(refusal), _) => encode::status_only(&stream.echo, [b'0', refusal]),
            (None, Some(scripted)) => scripted,
            (None, None) => {
                let is_halved = stream.is_halved;
                scan(body, &stream.echo, *b"99", stream.asked, times, is_halved, measure)
            }
        };
        let half = bytes.get(..bytes.len() / 2).unwrap_or_default();
        let line_end = half.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
        bytes.splice(line_end..line_end, std::mem::take(&mut stream.split_by));
        if stream.left == Some(0) {
            self.stream = None;
            body.is_laser_on = false;
        }
        bytes
    }

    fn start(&mut self, line: &[u8], asked: Asked, skipped: u16, count: u16, now: Instant) {
        self.stream = Some(Stream {
            echo: line.to_vec(),
            asked,
            skipped,
            left: Some(count).filter(|count| *count > 0),
            requested_at: now,
            is_halved: false,
            split_by: Vec::new(),
        });
    }

    fn version(&self, body: &Body, line: &[u8]) -> Answer {
        let mut bytes = encode::texts(line, texts::version(body), false);
        if self.quirks.contains(&Quirk::SerialSumApart)
            && let [.., sum, b'\n', b'\n'] = &mut bytes[..]
        {
            let apart = [*sum, b'\n', b'\n'];
            *sum ^= 1;
            bytes.pop();
            bytes.extend(apart);
        }
        bytes.into()
    }

    fn state(&mut self, body: &Body, line: &[u8], times: Times) -> Answer {
        let milliseconds = (times.clock / 1000) & 0xFF_FFFF;
        let lines = texts::state(body, milliseconds, encode::number(milliseconds));
        let bytes = encode::texts(line, lines, self.quirks.contains(&Quirk::ShortStateSums));
        if let Some(stream) = &mut self.stream {
            stream.is_halved |= body.model == Model::Utm30lx;
            if body.model == Model::Ust10lx {
                stream.split_by.extend(bytes);
                return Answer::default();
            }
        }
        bytes.into()
    }

    fn state_code(&self, body: &Body) -> &'static [u8; 3] {
        match () {
            () if self.is_in_clock_mode => b"002",
            () if self.is_asleep => b"005",
            () if self.stream.is_some() => b"004",
            () if body.is_laser_on => b"003",
            () => b"000",
        }
    }
}

impl Stream {
    fn count_down(&mut self) {
        let Some(left) = &mut self.left else { return };
        *left = left.saturating_sub(1);
        let text = self.echo.iter().position(|&byte| byte == b';').unwrap_or(self.echo.len());
        if let Some(slot) = self.echo.get_mut(..text).and_then(|body| body.last_chunk_mut::<2>()) {
            *slot = [b'0' + (*left / 10) as u8, b'0' + (*left % 10) as u8];
        }
    }
}

/// Encodes a scan, or its first half.
fn scan(
    body: &Body,
    echo: &[u8],
    status: [u8; 2],
    asked: Asked,
    times: Times,
    is_halved: bool,
    measure: Measure<'_>,
) -> Vec<u8> {
    let geometry = body.geometry(true);
    let has_intensity = asked.data == Data::Intensities;
    // The minimum without the values that are no distance (p. 10).
    let rank = |value| (!geometry.is_distance(value), value);
    let mut points = body.points(&geometry, asked.steps, has_intensity, measure, rank);
    if is_halved {
        points.truncate(points.len() / 2);
    }
    let mut data = Vec::with_capacity(6 * points.len());
    for (distance, intensity) in points {
        match asked.data {
            // More does not fit.
            Data::Short => data.extend(encode::number::<2>(distance.min(4095).into())),
            Data::Distances => data.extend(encode::number::<3>(distance.into())),
            Data::Intensities => {
                data.extend(encode::number::<3>(distance.into()));
                data.extend(encode::number::<3>(intensity.into()));
            }
        }
    }
    encode::scan(echo, status, &time(times.scan, asked.unit), &data)
}

/// Encodes a time of the sensor's clock: 24 bits of milliseconds, or 64 of microseconds.
fn time(microseconds: u64, unit: Unit) -> Vec<u8> {
    match unit {
        Unit::Milliseconds => encode::number::<4>(microseconds / 1000).to_vec(),
        Unit::Microseconds => encode::number::<11>(microseconds).to_vec(),
    }
}

pub(crate) fn status(line: &[u8], status: &[u8; 2]) -> Answer {
    encode::status_only(line, *status).into()
}

fn done(line: &[u8], effect: Effect) -> Answer {
    Answer { bytes: encode::status_only(line, *b"00"), effect }
}
