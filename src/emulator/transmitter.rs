//! The line from the sensor to the host: what was sent and when each of its
//! bytes arrives.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::Instant;

use super::wire::{byte_time, garble};

/// While more than this is unread the sensor sends nothing more of itself, and
/// leaves commands waiting: a host that does not read costs no memory.
const BACKLOG: usize = 16 * 1024;

/// Bytes reach the reader in pieces that take at most this long, after the
/// first byte, which comes alone. It is a compromise between exact times and
/// many wake-ups; the first and the last byte are on time whatever it is.
const PIECE: Duration = Duration::from_millis(8);

/// Bytes sent without a pause.
#[derive(Debug)]
struct Segment {
    /// When the first bit is sent.
    start: Instant,
    byte_time: Duration,
    bytes: Vec<u8>,
    taken: usize,
    /// The sensor's baud rate, until it was seen what the host makes of it.
    sent_at: Option<u32>,
}

impl Segment {
    fn arrival(&self, bytes: usize) -> Instant {
        self.start + self.byte_time * bytes as u32
    }

    /// How many bytes have arrived.
    fn arrived(&self, now: Instant) -> usize {
        let elapsed = now.saturating_duration_since(self.start).as_nanos();
        let bytes = elapsed.checked_div(self.byte_time.as_nanos()).unwrap_or(u128::MAX);
        self.bytes.len().min(usize::try_from(bytes).unwrap_or(usize::MAX))
    }
}

#[derive(Debug)]
pub(super) struct Transmitter {
    segments: VecDeque<Segment>,
    unread: usize,
    /// When the line is idle again.
    free: Instant,
    /// Sent over and over for ever.
    endless: Option<Vec<u8>>,
}

impl Transmitter {
    pub(super) fn new(now: Instant) -> Self {
        Self { segments: VecDeque::new(), unread: 0, free: now, endless: None }
    }

    /// Sends `bytes` at `at` or when the line is free, and gives the time when
    /// the first bit goes out. `speed` is the sensor's, `None` on USB.
    pub(super) fn send(
        &mut self,
        at: Instant,
        bytes: Vec<u8>,
        speed: Option<u32>,
        slowed: Option<Duration>,
    ) -> Instant {
        let start = self.free.max(at);
        let byte_time = slowed.unwrap_or_else(|| byte_time(speed));
        self.free = start + byte_time * bytes.len() as u32;
        if !bytes.is_empty() {
            self.unread += bytes.len();
            self.segments.push_back(Segment { start, byte_time, bytes, taken: 0, sent_at: speed });
        }
        start
    }

    /// When all that was sent is through.
    pub(super) fn free(&self) -> Instant {
        self.free
    }

    /// Whether the host has left too much unread for anything more to be sent.
    pub(super) fn is_clogged(&self) -> bool {
        self.unread >= BACKLOG
    }

    pub(super) fn set_endless(&mut self, pattern: Option<Vec<u8>>) {
        self.endless = pattern.filter(|pattern| !pattern.is_empty());
    }

    /// Brings the line to `now`, with the host's end at `host` bits a second.
    pub(super) fn advance(&mut self, now: Instant, speed: Option<u32>, host: Option<u32>) {
        if let Some(pattern) = self.endless.take() {
            while self.free <= now && !self.is_clogged() {
                let times = (256 / pattern.len()).max(1);
                self.send(self.free, pattern.repeat(times), speed, None);
            }
            if self.is_clogged() {
                // What could not be sent meanwhile is not made up for.
                self.free = self.free.max(now);
            }
            self.endless = Some(pattern);
        }
        for segment in &mut self.segments {
            if segment.start > now {
                break;
            }
            if let (Some(sent_at), Some(host)) = (segment.sent_at.take(), host)
                && sent_at != host
            {
                let duration = segment.byte_time * segment.bytes.len() as u32;
                self.unread -= segment.bytes.len();
                segment.bytes = garble(&segment.bytes, sent_at, host);
                self.unread += segment.bytes.len();
                segment.byte_time = duration / segment.bytes.len().max(1) as u32;
            }
        }
    }

    /// Moves what has arrived into `buffer`, as far as it has room, and gives
    /// the number of bytes. Garbling must have been settled by `advance`.
    pub(super) fn take(&mut self, now: Instant, buffer: &mut tokio::io::ReadBuf<'_>) -> usize {
        let before = buffer.filled().len();
        while let Some(segment) = self.segments.front_mut() {
            let arrived = segment.arrived(now);
            let ready = segment.bytes.get(segment.taken..arrived).unwrap_or_default();
            let count = ready.len().min(buffer.remaining());
            buffer.put_slice(ready.get(..count).unwrap_or_default());
            segment.taken += count;
            self.unread -= count;
            if segment.taken < segment.bytes.len() {
                break;
            }
            self.segments.pop_front();
        }
        buffer.filled().len() - before
    }

    /// When more bytes arrive.
    pub(super) fn next_arrival(&self) -> Option<Instant> {
        let Some(segment) = self.segments.front() else {
            return self.endless.as_ref().map(|_| self.free);
        };
        let piece = match segment.taken {
            0 => 1,
            _ => PIECE.as_nanos().checked_div(segment.byte_time.as_nanos()).unwrap_or(1).max(1),
        };
        let next = segment.taken + usize::try_from(piece).unwrap_or(usize::MAX / 2);
        Some(segment.arrival(next.min(segment.bytes.len())))
    }

    /// The sensor's power fails: what has not gone out by `at` never will.
    pub(super) fn cut(&mut self, at: Instant) {
        self.endless = None;
        self.free = at;
        for segment in &mut self.segments {
            segment.bytes.truncate(segment.arrived(at).max(segment.taken));
        }
        self.segments.retain(|segment| segment.taken < segment.bytes.len());
        self.unread = self.segments.iter().map(|s| s.bytes.len() - s.taken).sum();
    }

    /// The cable is pulled: also what has arrived and was not read is gone.
    pub(super) fn clear(&mut self, now: Instant) {
        *self = Self { endless: self.endless.take(), ..Self::new(now) };
    }
}
