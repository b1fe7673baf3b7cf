//! The sensor of the model in SCIP 2: it echoes labels, sums each line, and sends streams.

use tokio::time::Instant;
use tokio_scip::protocol::Protocol;

use super::sensor::{ModelSensor, REVOLUTION, digits, encode, value};

const VERSION: &[&str] = &["VEND:Hokuyo", "PROD:Model", "FIRM:1", "PROT:2", "SERI:7"];
const PARAMETERS: &[&str] = &[
    "MODL:Model",
    "DMIN:20",
    "DMAX:5600",
    "ARES:1024",
    "AMIN:44",
    "AMAX:725",
    "AFRT:384",
    "SCAN:600",
];

/// Scans that are sent without being asked for again.
pub(crate) struct Stream {
    command: Vec<u8>,
    /// Number of the next scan.
    next: usize,
}

impl ModelSensor {
    pub(super) fn answer_in_scip2(&mut self, line: &[u8]) -> Vec<u8> {
        let with_status = |status: &[u8]| reply(line, status, &[]);
        match line {
            [b'V', b'V', ..] => texts(line, VERSION),
            [b'P', b'P', ..] => texts(line, PARAMETERS),
            [b'B', b'M', ..] => {
                let was_on = std::mem::replace(&mut self.is_laser_on, true);
                with_status(if was_on { b"02" } else { b"00" })
            }
            [b'Q', b'T', ..] => {
                (self.is_laser_on, self.stream) = (false, None);
                with_status(b"00")
            }
            [b'S', b'S', rest @ ..] => {
                self.change_baud_rate(rest);
                with_status(b"00")
            }
            [b'M', b'D', ..] => {
                self.is_laser_on = true;
                self.stream = Some(Stream { command: line.to_vec(), next: self.newest() + 1 });
                with_status(b"00")
            }
            [b'G', b'D', ..] if !self.is_laser_on => with_status(b"10"),
            // It has measured nothing since it was switched on.
            [b'G', b'D', ..] if self.measured_at(self.newest()) < self.powered_at => {
                with_status(b"0M")
            }
            [b'G', b'D', ..] => {
                let number = self.newest();
                self.record(number, self.measured_at(number), false);
                self.scan(line, b"00", number)
            }
            _ => with_status(b"0E"),
        }
    }

    /// Returns true if the sensor may answer that it obeys a command, and not do so.
    pub(crate) fn can_disobey(&self, line: &[u8]) -> bool {
        let is_obeyed = |command: &[u8; 2]| line.starts_with(command);
        self.can_refuse(line) && [b"QT", b"BM", b"MD", b"SS"].into_iter().any(is_obeyed)
    }

    /// Returns true if the sensor may refuse a command that it knows.
    pub(crate) fn can_refuse(&self, line: &[u8]) -> bool {
        self.protocol == Protocol::Scip2 && line.contains(&b';')
    }

    pub(crate) fn is_streaming(&self) -> bool {
        self.stream.is_some()
    }

    /// Number of the newest whole revolution.
    fn newest(&self) -> usize {
        (self.built_at.elapsed().as_millis() / REVOLUTION.as_millis()) as usize
    }

    /// When a revolution ends.
    fn measured_at(&self, number: usize) -> Instant {
        self.built_at + REVOLUTION * number as u32
    }

    /// When the stream's next scan is sent.
    pub(crate) fn next_at(&self) -> Option<Instant> {
        self.stream.as_ref().map(|stream| self.measured_at(stream.next))
    }

    /// Returns the stream's next scan, if it is sent by now, and when.
    pub(crate) fn next_scan(&mut self) -> Option<(Instant, Vec<u8>)> {
        let at = self.next_at().filter(|at| *at <= Instant::now())?;
        let stream = self.stream.as_mut()?;
        let (number, command) = (stream.next, stream.command.clone());
        stream.next += 1 + digits(&command[12..13]) as usize;
        self.record(number, at, true);
        Some((at, self.scan(&command, b"99", number)))
    }

    fn scan(&self, echo: &[u8], status: &[u8], number: usize) -> Vec<u8> {
        let (start, end) = (digits(&echo[2..6]), digits(&echo[6..10]));
        let steps = (start..=end).step_by(digits(&echo[10..12]) as usize);
        let data: Vec<u8> = steps.flat_map(|step| encode::<3>(value(number, step))).collect();
        let clock = self.measured_at(number).saturating_duration_since(self.powered_at);
        let clock = encode::<4>(clock.as_millis() as u32);
        let lines: Vec<Vec<u8>> =
            [&clock[..]].into_iter().chain(data.chunks(64)).map(summed).collect();
        reply(echo, status, &lines)
    }
}

/// Returns a line with its sum.
fn summed(line: &[u8]) -> Vec<u8> {
    [line, &[sum(line)]].concat()
}

fn sum(line: &[u8]) -> u8 {
    (line.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)) & 0x3f) + 0x30
}

fn texts(echo: &[u8], texts: &[&str]) -> Vec<u8> {
    let lines = texts.iter().map(|text| [text.as_bytes(), b";", &[sum(text.as_bytes())]].concat());
    reply(echo, b"00", &lines.collect::<Vec<_>>())
}

pub(super) fn reply(echo: &[u8], status: &[u8], lines: &[Vec<u8>]) -> Vec<u8> {
    let mut reply = [echo, b"\n", &summed(status), b"\n"].concat();
    for line in lines {
        reply.extend(line);
        reply.push(b'\n');
    }
    reply.push(b'\n');
    reply
}
