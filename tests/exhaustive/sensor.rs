//! A sensor of the model: what it answers, and the truth about each scan. It knows no
//! line and makes no mistakes.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{BaudRate, Scan};

const VERSION: &[u8] = b"V\n0\nVEND:Hokuyo\nPROD:Model\nFIRM:1\nPROT:1\nSERI:7\n\n";
/// New baud rate applies a revolution after `S`.
const REVOLUTION: Duration = Duration::from_millis(100);

pub(crate) struct ModelSensor {
    pub(crate) is_laser_on: bool,
    /// `None` on USB.
    pub(crate) baud_rate: Option<BaudRate>,
    next_baud_rate: Option<(Instant, BaudRate)>,
    /// Times at which it measured; the numbers of its scans are the places.
    measured: Vec<Instant>,
}

impl ModelSensor {
    pub(crate) fn new(baud_rate: Option<BaudRate>) -> Self {
        Self { is_laser_on: true, baud_rate, next_baud_rate: None, measured: Vec::new() }
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
        let with_status = |status: &[u8]| [line, b"\n", status, b"\n\n"].concat();
        Some(match line {
            b"V" => VERSION.to_vec(),
            b"L0" | b"L1" => {
                self.is_laser_on = line == b"L1";
                with_status(b"0")
            }
            [b'S', ..] => {
                let bits = digits(&line[1..7]);
                let baud_rate = BaudRate::ALL.into_iter().find(|one| u32::from(*one) == bits);
                if self.baud_rate.is_some() {
                    self.next_baud_rate =
                        baud_rate.map(|baud_rate| (Instant::now() + REVOLUTION, baud_rate));
                }
                with_status(b"0")
            }
            [b'G', ..] if !self.is_laser_on => with_status(b"6"),
            [b'G', ..] => {
                let number = self.measured.len();
                self.measured.push(Instant::now());
                let (start, end) = (digits(&line[1..4]), digits(&line[4..7]));
                let steps = (start..=end).step_by(digits(&line[7..9]) as usize);
                let mut reply = [line, b"\n0\n"].concat();
                let data: Vec<u8> = steps.flat_map(|step| encode(value(number, step))).collect();
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

    /// Checks that a scan is the answer to its own request: all its values are those that
    /// were measured once between its request and its end.
    pub(crate) fn check(&self, scan: &Scan) -> Result<(), String> {
        let is_of = |number: usize| {
            let (window, measured) = (scan.window(), self.measured[number]);
            let cluster = window.cluster_count().into();
            let steps = (u32::from(window.start())..).step_by(cluster);
            (scan.times().requested_at..=scan.received_at()).contains(&measured)
                && scan.len() == window.points()
                && scan.raw_values().zip(steps).all(|(seen, step)| seen == value(number, step))
        };
        if (0..self.measured.len()).rev().any(is_of) {
            return Ok(());
        }
        Err(format!("scan {} of {} is of another poll", scan.sequence(), scan.window()))
    }
}

/// Returns the value of a point of a scan, which differs from scan to scan and from step to step.
fn value(number: usize, step: u32) -> u32 {
    20 + ((number * 1009 + step as usize * 31) % 4000) as u32
}

fn encode(value: u32) -> [u8; 2] {
    [(value >> 6) as u8 + 0x30, (value & 0x3f) as u8 + 0x30]
}

fn digits(text: &[u8]) -> u32 {
    text.iter().fold(0, |number, digit| number * 10 + u32::from(digit - b'0'))
}
