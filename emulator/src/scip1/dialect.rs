//! [`Dialect`]: how a firmware answers the commands of SCIP 1.1.

use super::command::Command;
use crate::body::{Answer, Body, Effect, Measure};
use crate::format::{BLOCK_BYTES, Reply, sextet};
use tokio_scip::BaudRate;

/// Firmware that an emulated URG-04LX plays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Firmware {
    /// Firmware as in the protocol text: `V` has five lines with a blank after the colon,
    /// and an undefined command gets no answer. On USB it accepts `S` (status `0`) without
    /// effect. Knows only SCIP 1.1.
    Text,
    /// Firmware 3.3 of a URG-04LX, as captured: `V` has six lines without the blank. An
    /// undefined command is answered with status `E`, `SCIP2.0` with status `C`. On USB it
    /// answers `S` with status `3`. Knows only SCIP 1.1.
    #[default]
    V3,
    /// Firmware 3.1.04 of a URG-04LX, as captured: like [`V3`](Self::V3), but `SCIP2.0` switches
    /// it to SCIP 2, with the laser off, until the next power cycle.
    V31,
}

/// Answer to a terminator without a command before it. How real sensors answer is unknown,
/// so your driver has to work with all three.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum EmptyCommand {
    /// No answer.
    #[default]
    Silence,
    /// An empty echo and an error status, as to any other command.
    Status,
    /// Two line feeds and nothing else.
    LineFeeds,
}

/// Status of the answer to `L` if the laser already is in that state. It depends on the
/// sensor: some clients stop at a `2`, and others expect it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum RepeatedLaser {
    /// Status `0`, as if the state had changed. All known clients accept it.
    #[default]
    Status0,
    /// Status `2`. Hokuyo's own sample of 2007 stops at it.
    Status2,
}

/// What depends on the firmware.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Dialect {
    pub(crate) firmware: Firmware,
    pub(crate) empty_command: EmptyCommand,
    pub(crate) repeated_laser: RepeatedLaser,
}

impl Dialect {
    /// Returns true if `command` gets a reply at all.
    pub(crate) fn answers(&self, command: &Command) -> bool {
        match command {
            Command::Undefined | Command::Scip2 => self.firmware != Firmware::Text,
            _ => true,
        }
    }

    /// Executes a command. Calls `measure` for the distance data only if they are sent.
    pub(crate) fn execute(
        &self,
        body: &mut Body,
        line: &[u8],
        command: &Command,
        measure: Measure<'_>,
    ) -> Answer {
        match *command {
            Command::Version => self.version(body, line).into(),
            Command::Laser(on) => self.set_laser(body, line, on),
            Command::BaudRate(baud_rate) => self.set_baud_rate(body, line, baud_rate),
            Command::Scan(_) if !body.is_laser_on => status(line, b'6'),
            Command::Scan(steps) => {
                // The minimum over raw values: an error code is less than any distance (p. 6).
                let geometry = body.geometry(false);
                let points = body.points(&geometry, steps, false, measure, |value| value);
                let values: Vec<u32> = points.into_iter().map(|(value, _)| value).collect();
                Answer { bytes: distances(line, &values), effect: Effect::Scan }
            }
            Command::Invalid(refusal) => status(line, refusal),
            Command::Scip2 if self.firmware == Firmware::V31 => status(line, b'0'),
            Command::Scip2 => status(line, b'C'),
            Command::Undefined => status(line, b'E'),
        }
    }

    fn set_laser(&self, body: &mut Body, line: &[u8], on: bool) -> Answer {
        let is_repeated = body.is_laser_on == on;
        body.is_laser_on = on;
        match self.repeated_laser {
            RepeatedLaser::Status2 if is_repeated => status(line, b'2'),
            _ if on && !is_repeated => Answer { effect: Effect::LaserOn, ..status(line, b'0') },
            _ => status(line, b'0'),
        }
    }

    fn set_baud_rate(&self, body: &Body, line: &[u8], baud_rate: BaudRate) -> Answer {
        match body.baud_rate {
            // "Accepted but it will not have any influence" (p. 5).
            None if self.firmware == Firmware::Text => status(line, b'0'),
            None => status(line, b'3'),
            Some(current) if current == baud_rate => status(line, b'3'),
            Some(_) => Answer { effect: Effect::BaudRate(baud_rate), ..status(line, b'0') },
        }
    }

    fn version(&self, body: &Body, echo: &[u8]) -> Vec<u8> {
        if let Some(given) = &body.version_lines {
            return lines(echo, given.iter().map(Vec::as_slice));
        }
        let serial_number = &body.serial_number;
        let text = match self.firmware {
            Firmware::Text => format!(
                "VEND: Hokuyo Automatic Co., Ltd.\n\
                 PROD: SOKUIKI Sensor URG-X002\n\
                 FIRM: 0.01.22a,(2004/12/27)\n\
                 PROT: 00001,(SCIP 1.0)\n\
                 SERI: {serial_number}"
            ),
            Firmware::V3 | Firmware::V31 => format!(
                "VEND:Hokuyo Automatic Co.,Ltd.\n\
                 PROD:SOKUIKI Sensor URG-04LX\n\
                 FIRM:{}(20-4095[mm],240[deg],44-725[step],600[rpm])\n\
                 PROT:00003,(SCIP 1.0)\n\
                 SERI:{serial_number}\n\
                 STAT:FW Normal[FinalDist with shadow  ]",
                if self.firmware == Firmware::V3 { "3.3.00,08/04/16" } else { "3.1.04,07/08/02" },
            ),
        };
        lines(echo, text.split('\n').map(str::as_bytes))
    }
}

/// Encodes a reply without data (p. 3).
pub(crate) fn status(line: &[u8], status: u8) -> Answer {
    Reply::new(line, &[status]).end().into()
}

/// Encodes a reply of text lines, such as the reply to `V` (p. 4).
fn lines<'a>(echo: &[u8], lines: impl IntoIterator<Item = &'a [u8]>) -> Vec<u8> {
    let mut reply = Reply::new(echo, b"0");
    lines.into_iter().for_each(|line| reply.line(line));
    reply.end()
}

/// Encodes a reply with distance data: two characters per value, 64 bytes per line (p. 5,
/// 6).
fn distances(echo: &[u8], values: &[u32]) -> Vec<u8> {
    let data: Vec<u8> =
        values.iter().flat_map(|&value| [sextet(value >> 6), sextet(value)]).collect();
    lines(echo, data.chunks(BLOCK_BYTES))
}
