//! Line from the sensor to the host: when each byte arrives, and what the host reads if
//! its baud rate is not the sensor's.
//!
//! `Transmitter` is the queue of bytes on their way; `byte_time` and `garble` are
//! the physics of one serial line, used for both directions.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::io::ReadBuf;
use tokio::time::Instant;

/// Throughput of a sensor on USB, measured on a URG-04LX.
const USB_BYTES_PER_SECOND: u32 = 375_000;

/// Longest time between two wake-ups of the reader while a reply arrives. The first and
/// the last byte are always on time. In between, a longer time means fewer wake-ups and
/// less exact times.
const WAKE_INTERVAL: Duration = Duration::from_millis(8);

/// Time of one byte at `baud_rate`, or on USB if `None`: 10 bits, one start, 8 data and
/// one stop bit (C-42-3320-A p. 2).
pub(super) fn byte_time(baud_rate: Option<u32>) -> Duration {
    let per_second = match baud_rate {
        Some(bits) => bits.max(10) / 10,
        None => USB_BYTES_PER_SECOND,
    };
    Duration::from_nanos(1_000_000_000 / u64::from(per_second.max(1)))
}

/// Bytes that a receiver at one baud rate reads when they were sent at another.
///
/// Models the hardware: the receiver waits for a falling edge, then samples the middle of
/// ten of its own bits. A faster receiver reads several bytes for one, and a slower one
/// misses most. A missing stop bit goes unnoticed, as on a terminal in raw mode.
pub(super) fn garble(bytes: &[u8], sender: u32, receiver: u32) -> Vec<u8> {
    if sender == receiver || sender == 0 || receiver == 0 {
        return bytes.to_vec();
    }
    let total = bytes.len() * 10;
    let high = |bit: usize| match (bytes.get(bit / 10), bit % 10) {
        (None, _) | (Some(_), 9) => true,
        (Some(_), 0) => false,
        (Some(byte), n) => byte >> (n - 1) & 1 == 1,
    };
    // Middle of the receiver's n-th bit, in bits of the sender.
    let middle = |n: u64| ((2 * n + 1) * u64::from(sender) / (2 * u64::from(receiver))) as usize;

    let mut received = Vec::new();
    let mut bit = 0;
    while bit < total {
        if high(bit) {
            bit += 1;
            continue;
        }
        let mut end = bit + 1;
        if !high(bit + middle(0)) {
            let byte = (0..8).fold(0, |byte, n| byte | u8::from(high(bit + middle(n + 1))) << n);
            received.push(byte);
            end = bit + middle(9).max(1);
        }
        // The line must be idle before the next falling edge can be seen.
        while end < total && !high(end) {
            end += 1;
        }
        bit = end;
    }
    received
}

/// Bytes sent without a pause between them.
#[derive(Debug)]
struct Segment {
    /// Time of the first bit.
    start: Instant,
    byte_time: Duration,
    bytes: Vec<u8>,
    /// Number of bytes read so far.
    taken: usize,
    /// Number of bytes that had arrived at the latest read.
    seen: usize,
    /// Baud rate of the sensor, `None` on USB.
    sent_at: Option<u32>,
    /// True once it was compared with the host's, which happens when the first bit is on the line.
    is_compared: bool,
    /// What the sensor sent, if the host's baud rate makes other bytes of it.
    garbled: Option<Vec<u8>>,
}

impl Segment {
    fn new(start: Instant, byte_time: Duration, sent_at: Option<u32>, bytes: Vec<u8>) -> Self {
        Self {
            start,
            byte_time,
            bytes,
            taken: 0,
            seen: 0,
            sent_at,
            is_compared: false,
            garbled: None,
        }
    }

    /// When this number of bytes has arrived.
    fn arrival(&self, bytes: usize) -> Instant {
        self.start + self.byte_time * bytes as u32
    }

    /// Number of bytes that have arrived.
    fn arrived(&self, now: Instant) -> usize {
        let elapsed = now.saturating_duration_since(self.start).as_nanos();
        let bytes = elapsed.checked_div(self.byte_time.as_nanos()).unwrap_or(u128::MAX);
        self.bytes.len().min(usize::try_from(bytes).unwrap_or(usize::MAX))
    }
}

/// Bytes that the sensor has sent and the host has not read.
#[derive(Debug)]
pub(super) struct Transmitter {
    segments: VecDeque<Segment>,
    /// Number of unread bytes in `segments`.
    unread: usize,
    /// From when on the line is idle.
    free: Instant,
    /// Bytes to repeat for ever.
    endless: Option<Vec<u8>>,
    /// While this many bytes are unread, the sensor sends nothing unsolicited and leaves commands
    /// waiting. So a host that does not read costs no memory.
    high_water: usize,
}

impl Transmitter {
    pub(super) fn new(now: Instant, high_water: usize) -> Self {
        Self { segments: VecDeque::new(), unread: 0, free: now, endless: None, high_water }
    }

    /// Sends `bytes` at `at`, or as soon as the line is free. `baud_rate` is the
    /// sensor's, `None` on USB. `slowed` is the time per byte if a fault sets it.
    pub(super) fn send(
        &mut self,
        at: Instant,
        bytes: Vec<u8>,
        baud_rate: Option<u32>,
        slowed: Option<Duration>,
    ) {
        let start = self.free.max(at);
        let byte_time = slowed.unwrap_or_else(|| byte_time(baud_rate));
        self.free = start + byte_time * bytes.len() as u32;
        if !bytes.is_empty() {
            self.unread += bytes.len();
            self.segments.push_back(Segment::new(start, byte_time, baud_rate, bytes));
        }
    }

    /// When the line is free.
    pub(super) fn free(&self) -> Instant {
        self.free
    }

    /// Returns true if the host has too many unread bytes for the sensor to send more.
    pub(super) fn is_full(&self) -> bool {
        self.unread >= self.high_water
    }

    /// Starts to repeat `pattern`, or stops if it is `None` or empty.
    pub(super) fn set_endless(&mut self, pattern: Option<Vec<u8>>) {
        self.endless = pattern.filter(|pattern| !pattern.is_empty());
    }

    /// Brings the line up to `now`, with the sensor at `baud_rate` and the host's end
    /// at `host`.
    pub(super) fn advance(&mut self, now: Instant, baud_rate: Option<u32>, host: Option<u32>) {
        if let Some(pattern) = self.endless.take() {
            while self.free <= now && !self.is_full() {
                let times = (256 / pattern.len()).max(1);
                self.send(self.free, pattern.repeat(times), baud_rate, None);
            }
            if self.is_full() {
                // Bytes that could not be sent in time are skipped.
                self.free = self.free.max(now);
            }
            self.endless = Some(pattern);
        }
        for segment in &mut self.segments {
            if segment.start > now {
                break;
            }
            if let (false, Some(sent_at), Some(host)) = (segment.is_compared, segment.sent_at, host)
                && sent_at != host
            {
                let duration = segment.byte_time * segment.bytes.len() as u32;
                self.unread -= segment.bytes.len();
                let bytes = garble(&segment.bytes, sent_at, host);
                segment.garbled = Some(std::mem::replace(&mut segment.bytes, bytes));
                self.unread += segment.bytes.len();
                segment.byte_time = duration / segment.bytes.len().max(1) as u32;
            }
            segment.is_compared = true;
        }
    }

    /// Lets the host read at another baud rate from `now` on. Call `advance` first.
    pub(super) fn retune(&mut self, now: Instant) {
        let on_the_line = |segment: &Segment| {
            let is_begun = segment.start < now && now < segment.arrival(segment.bytes.len());
            is_begun && segment.sent_at.is_some()
        };
        let Some(place) = self.segments.iter().position(on_the_line) else { return };
        let Some(segment) = self.segments.get_mut(place) else { return };
        let duration = segment.byte_time * segment.bytes.len() as u32;
        let arrived = segment.arrived(now).max(segment.taken);
        let sent = segment.garbled.take().unwrap_or_else(|| segment.bytes.clone());
        let byte_time = duration / sent.len().max(1) as u32;
        // The byte that is on the line now is lost.
        let elapsed = (now - segment.start).as_nanos();
        let first = elapsed.checked_div(byte_time.as_nanos()).unwrap_or_default() as usize + 1;
        segment.bytes.truncate(arrived);
        let rest = sent.get(first..).unwrap_or_default().to_vec();
        let start = segment.start + byte_time * first as u32;
        let rest = Segment::new(start, byte_time, segment.sent_at, rest);
        self.segments.insert(place + 1, rest);
        self.drop_read_segments();
    }

    /// Fills `buffer` with bytes that had arrived at the latest read, and returns true.
    /// If there are too few, changes nothing. So a host that reads in small pieces does
    /// not look at the clock for each of them.
    pub(super) fn take_seen(&mut self, buffer: &mut ReadBuf<'_>) -> bool {
        let Some(segment) = self.segments.front_mut() else { return false };
        let seen = segment.bytes.get(segment.taken..segment.seen).unwrap_or_default();
        // Leaves the last byte to `take`, which moves on to the next segment.
        let Some(bytes) = seen.get(..buffer.remaining()).filter(|bytes| bytes.len() < seen.len())
        else {
            return false;
        };
        buffer.put_slice(bytes);
        segment.taken += bytes.len();
        self.unread -= bytes.len();
        true
    }

    /// Moves the bytes that have arrived into `buffer`, as far as they fit, and returns true if
    /// there are any. Call `advance` first: it garbles them.
    pub(super) fn take(&mut self, now: Instant, buffer: &mut ReadBuf<'_>) -> bool {
        let before = buffer.filled().len();
        while let Some(segment) = self.segments.front_mut() {
            let arrived = segment.arrived(now);
            let ready = segment.bytes.get(segment.taken..arrived).unwrap_or_default();
            let count = ready.len().min(buffer.remaining());
            buffer.put_slice(ready.get(..count).unwrap_or_default());
            segment.taken += count;
            segment.seen = arrived;
            self.unread -= count;
            if segment.taken < segment.bytes.len() {
                break;
            }
            self.segments.pop_front();
        }
        buffer.filled().len() > before
    }

    /// When to wake the reader for more bytes.
    pub(super) fn next_arrival(&self) -> Option<Instant> {
        let Some(segment) = self.segments.front() else {
            return self.endless.as_ref().map(|_| self.free);
        };
        let piece = match segment.taken {
            0 => 1,
            _ => WAKE_INTERVAL
                .as_nanos()
                .checked_div(segment.byte_time.as_nanos())
                .unwrap_or(1)
                .max(1),
        };
        let next = segment.taken + usize::try_from(piece).unwrap_or(usize::MAX / 2);
        Some(segment.arrival(next.min(segment.bytes.len())))
    }

    /// Cuts the sensor's power at `at`: bytes not sent by then are lost.
    pub(super) fn cut(&mut self, at: Instant) {
        self.endless = None;
        self.free = at;
        for segment in &mut self.segments {
            segment.bytes.truncate(segment.arrived(at).max(segment.taken));
        }
        self.drop_read_segments();
    }

    fn drop_read_segments(&mut self) {
        self.segments.retain(|segment| segment.taken < segment.bytes.len());
        self.unread = self.segments.iter().map(|s| s.bytes.len() - s.taken).sum();
    }

    /// Drops all bytes, unread ones included, as when the cable is pulled.
    pub(super) fn clear(&mut self, now: Instant) {
        *self = Self { endless: self.endless.take(), ..Self::new(now, self.high_water) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_baud_rates_change_nothing() {
        let all: Vec<u8> = (0..=255).collect();
        assert_eq!(garble(&all, 19_200, 19_200), all);
    }

    #[test]
    fn a_receiver_twice_as_fast_sees_each_bit_twice() {
        // 'U' is 0x55: on the line 0 1010 1010 1, so each falling edge is seen
        // as a start bit: 0 01 10 01 10, and 0 01 10 01 11 where the line ends idle.
        assert_eq!(garble(b"U", 19_200, 38_400), [0x66, 0xE6]);
    }

    #[test]
    fn a_slow_receiver_reads_one_byte_for_several() {
        // Of three NULs only the second one's stop bit is sampled, as bit 5.
        assert_eq!(garble(&[0, 0, 0], 57_600, 19_200), [0x20]);
    }

    #[test]
    fn a_host_that_changes_its_baud_rate_reads_the_rest() {
        let (start, sent) = (Instant::now(), b"0123456789".repeat(10));
        let mut transmitter = Transmitter::new(start, 4096);
        transmitter.send(start, sent.clone(), Some(19_200), None);
        let middle = start + byte_time(Some(19_200)) * 50 + Duration::from_micros(1);
        transmitter.advance(middle, Some(19_200), Some(57_600));
        transmitter.retune(middle);
        let end = transmitter.free();
        transmitter.advance(end, Some(19_200), Some(19_200));
        let mut bytes = [0; 4096];
        let mut buffer = ReadBuf::new(&mut bytes);
        transmitter.take(end, &mut buffer);
        let read = buffer.filled();
        assert!(read.ends_with(&sent[51..]) && !read.starts_with(&sent[..5]), "{read:?}");
        assert_eq!(transmitter.unread, 0);
    }

    #[test]
    fn different_baud_rates_never_leave_a_command_unchanged() {
        let baud_rates = [19_200, 57_600, 115_200, 250_000, 500_000, 750_000];
        for sender in baud_rates {
            for receiver in baud_rates.into_iter().filter(|receiver| *receiver != sender) {
                assert_ne!(garble(b"G04472501\n", sender, receiver), b"G04472501\n");
            }
        }
    }
}
