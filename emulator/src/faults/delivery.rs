//! [`Delivery`]: a reply on its way, and what faults change about it.

use std::ops::Range;
use std::time::Duration;

use super::Fault;
use crate::format::sextet;
use crate::random::Random;
use crate::timing::LONGEST;

/// Reply on its way to the host.
#[derive(Debug, Default)]
pub(crate) struct Delivery {
    pub(crate) bytes: Vec<u8>,
    /// Delay of the first byte.
    pub(crate) delay: Duration,
    /// Pauses, each with the index of the byte after it.
    pauses: Vec<(usize, Duration)>,
    /// Time per byte, or `None` for the speed of the line.
    pub(crate) byte_time: Option<Duration>,
    /// What happens after the last byte.
    pub(crate) then: Option<Aftermath>,
}

/// Event after the last byte of a reply.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Aftermath {
    Reset,
    HangUp,
    Endless(Vec<u8>),
}

impl Delivery {
    pub(crate) fn new(bytes: Vec<u8>) -> Self {
        Self { bytes, ..Self::default() }
    }

    /// Applies a fault to the reply, on top of the earlier faults.
    pub(crate) fn apply(&mut self, fault: Fault, random: &mut Random) {
        let bytes = &mut self.bytes;
        match fault {
            // These were applied to the command, before there was a reply.
            Fault::CommandLost | Fault::Status(_) | Fault::Ignored | Fault::ClockJump(_) => {}
            Fault::WrongSum => falsify_sum(bytes, random),
            Fault::Lost => bytes.clear(),
            Fault::Late(delay) => self.delay += delay.min(LONGEST),
            Fault::Doubled => bytes.extend_from_within(..),
            Fault::Drop(range) => drop(bytes.drain(clip(range, bytes.len()))),
            Fault::Insert(at, more) if at <= bytes.len() => {
                bytes.splice(at..at, more);
            }
            Fault::Insert(..) => {}
            Fault::Flip(at, mask) => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= mask;
                }
            }
            Fault::Repeat(range) => repeat(bytes, range),
            Fault::Cut(length) => bytes.truncate(length),
            Fault::Damaged => damage_one_byte(bytes, random),
            Fault::Merged => drop(bytes.pop()),
            Fault::Garbage(garbage) => drop(bytes.splice(0..0, garbage)),
            Fault::Noise(length) => {
                drop(bytes.splice(0..0, (0..length).map(|_| random.next() as u8)));
            }
            Fault::Pause(at, pause) => self.pauses.push((at, pause.min(LONGEST))),
            Fault::Trickle(byte_time) => self.byte_time = Some(byte_time.min(LONGEST)),
            Fault::CrLf => {
                let lines: Vec<_> = bytes.split(|&byte| byte == b'\n').collect();
                *bytes = lines.join(&b"\r\n"[..]);
            }
            Fault::Reset(after) => self.end(after, Aftermath::Reset),
            Fault::HangUp(after) => self.end(after, Aftermath::HangUp),
            Fault::Endless(pattern) => self.end(0, Aftermath::Endless(pattern)),
        }
    }

    fn end(&mut self, after: usize, then: Aftermath) {
        self.bytes.truncate(after);
        self.then = Some(then);
    }

    /// Splits the reply at its pauses. Returns each part with the pause before it.
    pub(crate) fn take_parts(&mut self) -> Vec<(Duration, Vec<u8>)> {
        let mut rest = std::mem::take(&mut self.bytes);
        let mut parts = Vec::with_capacity(1 + self.pauses.len());
        // From the end, so that splitting leaves the remaining positions valid.
        self.pauses.sort_by_key(|(at, _)| std::cmp::Reverse(*at));
        for &(at, pause) in &self.pauses {
            if at < rest.len() {
                parts.push((pause, rest.split_off(at)));
            }
        }
        parts.push((Duration::ZERO, rest));
        parts.reverse();
        parts
    }
}

fn clip(range: Range<usize>, length: usize) -> Range<usize> {
    let end = range.end.min(length);
    range.start.min(end)..end
}

fn repeat(bytes: &mut Vec<u8>, range: Range<usize>) {
    let range = clip(range, bytes.len());
    let end = range.end;
    let again = bytes.get(range).unwrap_or_default().to_vec();
    bytes.splice(end..end, again);
}

fn falsify_sum(bytes: &mut [u8], random: &mut Random) {
    // Positions of the sums: before each line feed, except for the echo's and the last one.
    let last_of_line = |two: &[u8]| matches!(two, [first, b'\n'] if *first != b'\n');
    let ends = bytes.windows(2).enumerate().filter(|(_, two)| last_of_line(two));
    // The echo has no sum.
    let ends: Vec<usize> = ends.map(|(at, _)| at).skip(1).collect();
    let chosen = random.below(ends.len() as u64) as usize;
    if let Some(sum) = ends.get(chosen).and_then(|at| bytes.get_mut(*at)) {
        let six = u32::from(*sum).wrapping_sub(0x30);
        *sum = sextet(six.wrapping_add(1 + random.below(63) as u32));
    }
}

fn damage_one_byte(bytes: &mut Vec<u8>, random: &mut Random) {
    if bytes.is_empty() {
        return;
    }
    let at = random.below(bytes.len() as u64) as usize;
    match random.below(5) {
        0 => drop(bytes.remove(at)),
        1 => repeat(bytes, at..at + 1),
        2 => bytes.insert(at, random.next() as u8),
        3 => bytes.truncate(at),
        _ => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
    }
}
