//! The sensor itself, without time or I/O: a command line in, the reply's bytes
//! out, and the state that commands change.

use super::encode;
use super::request::{Refusal, Request};
use super::world::{FAR, Values};
use crate::BaudRate;

/// Which sensor is played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Firmware {
    /// The sensor of the protocol text: `V` has five lines with a blank after
    /// the colon, and an undefined command gets no answer. On USB it accepts
    /// `S` (status `0`) without effect.
    Text,
    /// A URG-04LX with firmware 3.3, as captured: `V` has six lines without the
    /// blank, and an undefined command is answered with status `E`. On USB it
    /// answers `S` with status `3`. `SCIP2.0` switches it to SCIP 2 until the
    /// next power-up.
    #[default]
    V3,
}

/// What the sensor makes of a terminator with no command before it. What real
/// sensors do is not known, so that a driver has to stand all three.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum EmptyCommand {
    /// Nothing.
    #[default]
    Silence,
    /// It is a command like another: an empty echo and an error status.
    Status,
    /// Two line feeds and nothing else.
    LineFeeds,
}

/// Which protocol the sensor speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Mode {
    /// SCIP 1.1, as after every power-up.
    #[default]
    Scip1,
    /// SCIP 2: every command of SCIP 1.1 is answered with the status line `0Eu`.
    Scip2,
    /// SCIP 2 with continuous scanning left on: an `MD` reply with the status
    /// line `99b` comes after every revolution, unasked.
    Scip2Streaming,
}

/// What a command does beyond its reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effect {
    None,
    /// The laser went on, which takes a revolution.
    LaserOn,
    /// The baud rate changes a revolution later.
    Speed(BaudRate),
    /// Distance data went out.
    Scan,
}

#[derive(Debug)]
pub(super) struct Device {
    pub(super) firmware: Firmware,
    pub(super) empty: EmptyCommand,
    pub(super) serial_number: String,
    pub(super) version: Option<Vec<Vec<u8>>>,
    pub(super) miscount: i8,
    pub(super) mode: Mode,
    pub(super) laser: bool,
    /// `None` on USB.
    pub(super) speed: Option<BaudRate>,
}

impl Device {
    /// Forgets what commands have set (p. 4 and 5): laser on, 19,200 baud.
    pub(super) fn power_up(&mut self) {
        self.mode = Mode::Scip1;
        self.laser = true;
        self.speed = self.speed.map(|_| BaudRate::B19200);
    }

    /// Whether `request` gets a reply at all.
    pub(super) fn answers(&self, request: &Request) -> bool {
        match request {
            Request::Empty => self.empty != EmptyCommand::Silence,
            Request::Undefined | Request::Scip2 => {
                self.firmware != Firmware::Text || self.mode != Mode::Scip1
            }
            _ => true,
        }
    }

    /// Does what `line` asks for, and gives the reply. `measure` fills in the
    /// distance data in the sensor's memory, and is called only where they are
    /// sent.
    pub(super) fn serve(
        &mut self,
        line: &[u8],
        request: &Request,
        measure: impl FnOnce(&mut Values),
    ) -> (Vec<u8>, Effect) {
        if *request == Request::Empty {
            return (self.empty_reply(), Effect::None);
        }
        if self.mode != Mode::Scip1 {
            return (self.scip2(line), Effect::None);
        }
        match *request {
            Request::Version => (self.version(line), Effect::None),
            Request::Laser(on) if self.laser == on => refused(line, b'2'),
            Request::Laser(on) => {
                self.laser = on;
                (encode::status_only(line, b"0"), if on { Effect::LaserOn } else { Effect::None })
            }
            Request::Speed(speed) => self.change_speed(line, speed),
            Request::Scan { .. } if !self.laser => refused(line, b'6'),
            Request::Scan { start, end, cluster } => {
                let mut codes = [FAR; super::STEPS];
                measure(&mut codes);
                (self.distances(line, &codes, start, end, cluster), Effect::Scan)
            }
            Request::Scip2 if self.firmware == Firmware::V3 => {
                self.mode = Mode::Scip2;
                (encode::status_only(line, b"0"), Effect::None)
            }
            Request::Refused(Refusal::Length) => refused(line, b'1'),
            Request::Refused(Refusal::Parameter) => refused(line, b'4'),
            Request::Refused(Refusal::Order) => refused(line, b'5'),
            Request::Scip2 | Request::Undefined | Request::Empty => refused(line, b'E'),
        }
    }

    fn empty_reply(&self) -> Vec<u8> {
        match self.empty {
            EmptyCommand::Silence => Vec::new(),
            EmptyCommand::Status => encode::status_only(b"", b"E"),
            EmptyCommand::LineFeeds => b"\n\n".to_vec(),
        }
    }

    fn change_speed(&self, line: &[u8], speed: BaudRate) -> (Vec<u8>, Effect) {
        match self.speed {
            // "Accepted but it will not have any influence" (p. 5).
            None if self.firmware == Firmware::Text => {
                (encode::status_only(line, b"0"), Effect::None)
            }
            None => refused(line, b'3'),
            Some(current) if current == speed => refused(line, b'3'),
            Some(_) => (encode::status_only(line, b"0"), Effect::Speed(speed)),
        }
    }

    fn version(&self, echo: &[u8]) -> Vec<u8> {
        if let Some(lines) = &self.version {
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
        codes: &Values,
        start: u16,
        end: u16,
        cluster: u16,
    ) -> Vec<u8> {
        let first = usize::from(start);
        let points =
            usize::from(end.saturating_add_signed(self.miscount.into()) + 1).saturating_sub(first);
        // A miscount may ask for a step past the last one, where nothing is.
        let mut window = codes.get(first..).unwrap_or_default().to_vec();
        window.resize(points, FAR);
        if cluster > 1 {
            // The minimum of the raw codes: an error code wins over distances (p. 6).
            let groups = window.chunks(cluster.into());
            window = groups.map(|group| group.iter().copied().min().unwrap_or(FAR)).collect();
        }
        encode::distances(echo, &window)
    }

    fn scip2(&mut self, line: &[u8]) -> Vec<u8> {
        match line {
            b"QT" | b"RS" => {
                self.mode = Mode::Scip2;
                encode::status_only(line, b"00P")
            }
            _ => encode::status_only(line, b"0Eu"),
        }
    }
}

fn refused(line: &[u8], status: u8) -> (Vec<u8>, Effect) {
    (encode::status_only(line, &[status]), Effect::None)
}
