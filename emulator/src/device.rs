//! [`Device`]: the sensor without time and I/O. Takes a command line, returns the reply's bytes,
//! and holds the state that commands change.

use tokio::time::Instant;

use super::body::{Answer, Body, Measure};
use super::format::Reply;
use super::journal::Verdict;
use super::line_buffer::CommandLine;
use super::models::{Geometry, Model};
use super::scip1::{self, Command, Dialect, EmptyCommand, Firmware};
use super::scip2::{self, Session, Times};
use tokio_scip::BaudRate;

/// Protocol that the sensor speaks. Only a URG-04LX speaks SCIP 1.1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Mode {
    /// SCIP 1.1, as after every power-up of a URG-04LX.
    #[default]
    Scip1,
    /// SCIP 2: every command of SCIP 1.1 is answered with the status line `0Ee`.
    Scip2,
    /// SCIP 2 with the scans of a host that has died: sends an `MD` reply with the status line
    /// `99b` after every revolution, until it is stopped.
    Scip2Streaming,
}

#[derive(Debug, Clone)]
pub(crate) struct Device {
    pub(crate) body: Body,
    pub(crate) dialect: Dialect,
    pub(crate) session: Session,
    pub(crate) is_in_scip2: bool,
}

impl Device {
    /// Resets what commands have set: in SCIP 1.1 laser on, 19,200 baud (C-42-3320-A p. 4 and 5);
    /// in SCIP 2 laser off (C-42-03320B p. 14).
    pub(crate) fn power_up(&mut self) {
        let speaks_scip1 = self.body.model == Model::Urg04lx;
        self.is_in_scip2 = !speaks_scip1;
        self.body.is_laser_on = speaks_scip1;
        self.body.baud_rate = self.body.baud_rate.map(|_| BaudRate::B19200);
        self.session.power_up();
    }

    pub(crate) fn set_mode(&mut self, mode: Mode, now: Instant) {
        self.is_in_scip2 = mode != Mode::Scip1 || self.body.model != Model::Urg04lx;
        self.session.power_up();
        if mode == Mode::Scip2Streaming {
            self.session.leave_streaming(&mut self.body, now);
        }
    }

    pub(crate) fn geometry(&self) -> Geometry {
        self.body.geometry(self.is_in_scip2)
    }

    /// Returns whether a line is a command of a protocol that the sensor knows.
    pub(crate) fn verdict(&self, line: &CommandLine) -> Verdict {
        let (model, knows_both) = (self.body.model, self.dialect.firmware == Firmware::V31);
        let is_of_scip1 = || match Command::parse(&line.bytes, line.too_long) {
            Command::Scip2 => knows_both,
            Command::Undefined | Command::Invalid(_) => false,
            _ => true,
        };
        let is_of_scip2 = || scip2::Command::parse(&line.bytes, line.too_long, &self.body).is_ok();
        match () {
            () if line.bytes.is_empty() => Verdict::Empty,
            () if model == Model::Urg04lx && is_of_scip1() => Verdict::WellFormed,
            () if (self.is_in_scip2 || knows_both) && is_of_scip2() => Verdict::WellFormed,
            () => Verdict::Malformed,
        }
    }

    /// Returns true if a line gets a reply at all.
    pub(crate) fn answers(&self, line: &CommandLine) -> bool {
        match () {
            () if self.session.is_locked => false,
            () if line.bytes.is_empty() => self.dialect.empty_command != EmptyCommand::Silence,
            () if self.is_in_scip2 => true,
            () => self.dialect.answers(&Command::parse(&line.bytes, line.too_long)),
        }
    }

    /// First and last step that the line asks for, if it asks for the newest scan and the laser is
    /// on.
    pub(crate) fn asked_steps(&self, line: &CommandLine) -> Option<(u16, u16)> {
        let (line, too_long) = (&line.bytes, line.too_long);
        let steps = match (self.is_in_scip2, Command::parse(line, too_long)) {
            (false, Command::Scan(steps)) => steps,
            (false, _) => return None,
            (true, _) => match scip2::Command::parse(line, too_long, &self.body) {
                Ok(scip2::Command::Latest(asked)) => asked.steps,
                _ => return None,
            },
        };
        self.body.is_laser_on.then_some((steps.start, steps.end))
    }

    /// Executes a command, and returns its reply and its effect. Calls `measure` for the
    /// distance data only if they are sent.
    pub(crate) fn execute(
        &mut self,
        line: &CommandLine,
        times: Times,
        measure: Measure<'_>,
    ) -> Answer {
        let Self { body, dialect, session, is_in_scip2 } = self;
        if line.bytes.is_empty() {
            return match dialect.empty_command {
                EmptyCommand::Silence => Answer::default(),
                EmptyCommand::Status => Reply::new(b"", b"E").end().into(),
                EmptyCommand::LineFeeds => b"\n\n".to_vec().into(),
            };
        }
        if *is_in_scip2 {
            let mut answer = session.execute(body, line, times, measure);
            // Captures of UST-10LX have the CR of the command there, and no LF.
            if body.model.is_on_ethernet()
                && answer.bytes.starts_with(&line.bytes)
                && let Some(end) = answer.bytes.get_mut(line.bytes.len())
            {
                *end = line.end;
            }
            return answer;
        }
        let command = Command::parse(&line.bytes, line.too_long);
        if command == Command::Scip2 && dialect.firmware == Firmware::V31 {
            (*is_in_scip2, body.is_laser_on) = (true, false);
        }
        dialect.execute(body, &line.bytes, &command, measure)
    }

    /// Refuses a command with a status. In SCIP 2 a `0` precedes it.
    pub(crate) fn refuse(&self, line: &[u8], status: u8) -> Answer {
        match self.is_in_scip2 {
            true => scip2::status(line, &[b'0', status]),
            false => scip1::status(line, status),
        }
    }
}
