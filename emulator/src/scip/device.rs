//! Sensor without time and I/O: takes a command, returns the reply's bytes, and holds the
//! state that commands change.

use super::command::{HostCommand, Mistake};
use super::encode;
use crate::models::Model;
use crate::world::Values;
use tokio_scip::BaudRate;

/// Firmware that an emulated sensor plays. Both know only SCIP 1.1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Firmware {
    /// Firmware as in the protocol text: `V` has five lines with a blank after the colon,
    /// and an undefined command gets no answer. On USB it accepts `S` (status `0`) without
    /// effect.
    Text,
    /// Firmware 3.3 of a URG-04LX, as captured: `V` has six lines without the blank. An
    /// undefined command is answered with status `E`, `SCIP2.0` with status `C`. On USB it
    /// answers `S` with status `3`.
    #[default]
    V3,
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

/// Protocol that the sensor speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Mode {
    /// SCIP 1.1, as after every power-up.
    #[default]
    Scip1,
    /// SCIP 2: every command of SCIP 1.1 is answered with the status line `0Eu`.
    Scip2,
    /// SCIP 2 with continuous scanning left on: sends an unsolicited `MD` reply with the
    /// status line `99b` after every revolution.
    Scip2Streaming,
}

/// Effect of a command beyond its reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Effect {
    None,
    /// Laser switched on, which takes a revolution.
    LaserOn,
    /// Baud rate that changes a revolution later.
    BaudRate(BaudRate),
    /// Distance data in the reply.
    Scan,
}

#[derive(Debug)]
pub(crate) struct Device {
    pub(crate) firmware: Firmware,
    pub(crate) empty_command: EmptyCommand,
    pub(crate) repeated_laser: RepeatedLaser,
    pub(crate) serial_number: String,
    /// Lines of the reply to `V`, in place of the firmware's.
    pub(crate) version_lines: Option<Vec<Vec<u8>>>,
    pub(crate) miscount: i8,
    pub(crate) mode: Mode,
    pub(crate) is_laser_on: bool,
    /// `None` on USB.
    pub(crate) baud_rate: Option<BaudRate>,
}

impl Device {
    /// Resets what commands have set (p. 4 and 5): laser on, 19,200 baud.
    pub(crate) fn power_up(&mut self) {
        self.mode = Mode::Scip1;
        self.is_laser_on = true;
        self.baud_rate = self.baud_rate.map(|_| BaudRate::B19200);
    }

    /// Returns true if `command` gets a reply at all.
    pub(crate) fn answers(&self, command: &HostCommand) -> bool {
        match command {
            HostCommand::Empty => self.empty_command != EmptyCommand::Silence,
            HostCommand::Undefined | HostCommand::Scip2 => {
                self.firmware != Firmware::Text || self.mode != Mode::Scip1
            }
            _ => true,
        }
    }

    /// Executes a command, and returns its reply and its effect. Calls `measure` for the
    /// distance data only if they are sent.
    pub(crate) fn execute(
        &mut self,
        line: &[u8],
        command: &HostCommand,
        measure: impl FnOnce(&mut Values),
    ) -> (Vec<u8>, Effect) {
        if *command == HostCommand::Empty {
            return (self.empty_reply(), Effect::None);
        }
        if self.mode != Mode::Scip1 {
            return (self.scip2(line), Effect::None);
        }
        match *command {
            HostCommand::Version => (self.version(line), Effect::None),
            HostCommand::Laser(on) => self.set_laser(line, on),
            HostCommand::BaudRate(baud_rate) => self.set_baud_rate(line, baud_rate),
            HostCommand::Scan { .. } if !self.is_laser_on => status(line, b'6'),
            HostCommand::Scan { start, end, cluster } => {
                let geometry = Model::Urg04lx.geometry(false);
                let mut values = vec![geometry.codes.outside(); geometry.steps()];
                measure(&mut values);
                (self.distances(line, &values, start, end, cluster), Effect::Scan)
            }
            HostCommand::Invalid(Mistake::Length) => status(line, b'1'),
            HostCommand::Invalid(Mistake::Parameter) => status(line, b'4'),
            HostCommand::Invalid(Mistake::Order) => status(line, b'5'),
            HostCommand::Scip2 => status(line, b'C'),
            HostCommand::Undefined | HostCommand::Empty => status(line, b'E'),
        }
    }

    fn empty_reply(&self) -> Vec<u8> {
        match self.empty_command {
            EmptyCommand::Silence => Vec::new(),
            EmptyCommand::Status => encode::status_only(b"", b"E"),
            EmptyCommand::LineFeeds => b"\n\n".to_vec(),
        }
    }

    fn set_laser(&mut self, line: &[u8], on: bool) -> (Vec<u8>, Effect) {
        let is_repeated = self.is_laser_on == on;
        self.is_laser_on = on;
        match self.repeated_laser {
            RepeatedLaser::Status2 if is_repeated => status(line, b'2'),
            _ if on && !is_repeated => (encode::status_only(line, b"0"), Effect::LaserOn),
            _ => status(line, b'0'),
        }
    }

    fn set_baud_rate(&self, line: &[u8], baud_rate: BaudRate) -> (Vec<u8>, Effect) {
        match self.baud_rate {
            // "Accepted but it will not have any influence" (p. 5).
            None if self.firmware == Firmware::Text => status(line, b'0'),
            None => status(line, b'3'),
            Some(current) if current == baud_rate => status(line, b'3'),
            Some(_) => (encode::status_only(line, b"0"), Effect::BaudRate(baud_rate)),
        }
    }

    fn version(&self, echo: &[u8]) -> Vec<u8> {
        if let Some(lines) = &self.version_lines {
            return encode::lines(echo, lines.iter().map(Vec::as_slice));
        }
        let serial_number = &self.serial_number;
        let text = match self.firmware {
            Firmware::Text => format!(
                "VEND: Hokuyo Automatic Co., Ltd.\n\
                 PROD: SOKUIKI Sensor URG-X002\n\
                 FIRM: 0.01.22a,(2004/12/27)\n\
                 PROT: 00001,(SCIP 1.0)\n\
                 SERI: {serial_number}"
            ),
            Firmware::V3 => format!(
                "VEND:Hokuyo Automatic Co.,Ltd.\n\
                 PROD:SOKUIKI Sensor URG-04LX\n\
                 FIRM:3.3.00,08/04/16(20-4095[mm],240[deg],44-725[step],600[rpm])\n\
                 PROT:00003,(SCIP 1.0)\n\
                 SERI:{serial_number}\n\
                 STAT:FW Normal[FinalDist with shadow  ]"
            ),
        };
        encode::lines(echo, text.split('\n').map(str::as_bytes))
    }

    fn distances(
        &self,
        echo: &[u8],
        values: &Values,
        start: u16,
        end: u16,
        cluster: u16,
    ) -> Vec<u8> {
        let first = usize::from(start);
        let points =
            usize::from(end.saturating_add_signed(self.miscount.into()) + 1).saturating_sub(first);
        // A miscount may reach past the last step. Those points are not measurable.
        let mut window = values.get(first..).unwrap_or_default().to_vec();
        let missing = Model::Urg04lx.geometry(false).codes.outside();
        window.resize(points, missing);
        if cluster > 1 {
            // The minimum over raw values: an error code is less than any distance (p. 6).
            let groups = window.chunks(cluster.into());
            window = groups.map(|group| group.iter().copied().min().unwrap_or(missing)).collect();
        }
        encode::distances(echo, &window)
    }

    fn scip2(&mut self, line: &[u8]) -> Vec<u8> {
        match line {
            b"QT" | b"RS" => {
                self.mode = Mode::Scip2;
                encode::status_only(line, b"00P")
            }
            b"VV" => {
                let text = self.version(line);
                encode::scip2_lines(line, text.split(|byte| *byte == b'\n').skip(2))
            }
            _ => encode::status_only(line, b"0Eu"),
        }
    }
}

fn status(line: &[u8], status: u8) -> (Vec<u8>, Effect) {
    (encode::status_only(line, &[status]), Effect::None)
}
