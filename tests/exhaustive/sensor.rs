//! A sensor of the model: what it answers, and the truth about each scan. It knows no
//! line and makes no mistakes.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Scan};

use super::scip2::Stream;

const VERSION: &[u8] = b"V\n0\nVEND:Hokuyo\nPROD:Model\nFIRM:1\nPROT:1\nSERI:7\n\n";
pub(super) const REVOLUTION: Duration = Duration::from_millis(100);
const BAUD_RATE: BaudRate = BaudRate::B19200;

pub(crate) struct ModelSensor {
    /// Protocol after power-up.
    native: Protocol,
    pub(super) protocol: Protocol,
    pub(crate) is_laser_on: bool,
    /// `None` on USB.
    pub(crate) baud_rate: Option<BaudRate>,
    /// A new baud rate applies a revolution after the command.
    next_baud_rate: Option<(Instant, BaudRate)>,
    pub(super) built_at: Instant,
    pub(super) powered_at: Instant,
    pub(super) stream: Option<Stream>,
    measured: Vec<Measured>,
}

/// Scan that was sent.
struct Measured {
    /// Tells which values it has.
    number: usize,
    at: Instant,
    is_streamed: bool,
}

impl ModelSensor {
    pub(crate) fn new(native: Protocol, has_baud_rate: bool) -> Self {
        let now = Instant::now();
        Self {
            native,
            protocol: native,
            is_laser_on: native == Protocol::Scip1,
            baud_rate: has_baud_rate.then_some(BAUD_RATE),
            next_baud_rate: None,
            built_at: now,
            powered_at: now,
            stream: None,
            measured: Vec::new(),
        }
    }

    /// Cuts the power for a moment.
    pub(crate) fn restart(&mut self) {
        let Self { native, baud_rate, built_at, .. } = *self;
        let measured = std::mem::take(&mut self.measured);
        *self = Self { built_at, measured, ..Self::new(native, baud_rate.is_some()) };
    }

    /// Applies a baud rate whose time has come.
    pub(crate) fn update(&mut self) {
        if let Some((at, baud_rate)) = self.next_baud_rate
            && at <= Instant::now()
        {
            (self.baud_rate, self.next_baud_rate) = (Some(baud_rate), None);
        }
    }

    /// Returns the reply to a command line, if it has one.
    pub(crate) fn answer(&mut self, line: &[u8]) -> Option<Vec<u8>> {
        match self.protocol {
            Protocol::Scip1 => self.answer_in_scip1(line),
            Protocol::Scip2 => Some(self.answer_in_scip2(line)),
        }
    }

    fn answer_in_scip1(&mut self, line: &[u8]) -> Option<Vec<u8>> {
        let with_status = |status: &[u8]| [line, b"\n", status, b"\n\n"].concat();
        Some(match line {
            b"V" => VERSION.to_vec(),
            b"SCIP2.0" => {
                (self.protocol, self.is_laser_on) = (Protocol::Scip2, false);
                with_status(b"0")
            }
            b"L0" | b"L1" => {
                self.is_laser_on = line == b"L1";
                with_status(b"0")
            }
            [b'S', rest @ ..] => {
                self.change_baud_rate(rest);
                with_status(b"0")
            }
            [b'G', ..] if !line[1..].iter().all(u8::is_ascii_digit) => with_status(b"E"),
            [b'G', ..] if !self.is_laser_on => with_status(b"6"),
            [b'G', ..] => {
                let number = self.measured.len();
                self.record(number, Instant::now(), false);
                let (start, end) = (digits(&line[1..4]), digits(&line[4..7]));
                let steps = (start..=end).step_by(digits(&line[7..9]) as usize);
                let mut reply = [line, b"\n0\n"].concat();
                let data: Vec<u8> =
                    steps.flat_map(|step| encode::<2>(value(number, step))).collect();
                for block in data.chunks(64) {
                    reply.extend(block);
                    reply.push(b'\n');
                }
                reply.push(b'\n');
                reply
            }
            _ => return None,
        })
    }

    /// Changes the baud rate, if it has one.
    pub(super) fn change_baud_rate(&mut self, text: &[u8]) {
        let bits = digits(&text[..6]);
        let baud_rate = BaudRate::ALL.into_iter().find(|one| u32::from(*one) == bits);
        let at = Instant::now() + REVOLUTION;
        self.next_baud_rate = baud_rate.filter(|_| self.baud_rate.is_some()).map(|rate| (at, rate));
    }

    /// Records a scan that is sent.
    pub(super) fn record(&mut self, number: usize, at: Instant, is_streamed: bool) {
        self.measured.push(Measured { number, at, is_streamed });
    }

    /// Checks that a scan is the answer to its own request: all its values are those that were
    /// measured once between its request and its end. In SCIP 2 the newest scan may be older by a
    /// revolution, and a stream has one request. Returns the number of the scan, which is after
    /// `latest`: only who polls faster than the motor turns gets a scan twice, and is told so.
    pub(crate) fn check(&self, scan: &Scan, latest: Option<usize>) -> Result<usize, String> {
        let window = scan.window();
        let is_of = |measured: &&Measured| {
            let Measured { number, at, is_streamed } = **measured;
            let cluster = window.cluster_count().into();
            let steps = (u32::from(window.start())..).step_by(cluster);
            let age = if self.native == Protocol::Scip2 { REVOLUTION } else { Duration::ZERO };
            at <= scan.received_at()
                && (is_streamed || scan.times().requested_at <= at + age)
                && scan.len() == window.points()
                && scan.raw_values().zip(steps).all(|(seen, step)| seen == value(number, step))
        };
        let name = format!("scan {} of {window}", scan.sequence());
        let Some(measured) = self.measured.iter().rev().find(is_of) else {
            return Err(format!("{name} is of another poll"));
        };
        let Measured { number, is_streamed, .. } = *measured;
        let may_repeat = scan.is_repeat() && !is_streamed;
        match latest {
            Some(latest) if number < latest => Err(format!("{name} comes after a newer one")),
            Some(latest) if number == latest && !may_repeat => Err(format!("{name} comes twice")),
            _ => Ok(number),
        }
    }
}

/// Returns the value of a point of a scan, which differs from scan to scan and from step to step.
pub(super) fn value(number: usize, step: u32) -> u32 {
    20 + ((number * 1009 + step as usize * 31) % 4000) as u32
}

/// Encodes a number, upper six bits first.
pub(super) fn encode<const N: usize>(number: u32) -> [u8; N] {
    std::array::from_fn(|place| (number >> (6 * (N - 1 - place)) & 0x3f) as u8 + 0x30)
}

pub(super) fn digits(text: &[u8]) -> u32 {
    text.iter().fold(0, |number, digit| number * 10 + u32::from(digit - b'0'))
}
