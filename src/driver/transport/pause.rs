//! [`Pauses`]: when nothing needs to wake the driver while a reply trickles in.
//!
//! A serial line delivers a scan in 20 to 100 pieces. Waking up for each one costs more than all
//! other work on the scan (`benches/README.md`, item 12). Once a scan has begun, its rest takes at
//! least as long as the rest of the fastest recent scan. So the driver sleeps until shortly before
//! the end. It measures this time and does not compute it from the baud rate, which means nothing on
//! a pseudo-terminal or USB. The port must be able to stop its wake-ups.

use std::time::Duration;

use tokio::time::Instant;

/// Number of scans to read piece by piece, and measure, before the first pause: one may have been slow.
const MEASURED_FIRST: usize = 3;
/// Number of measured scans that count as recent.
const RECENT: usize = 8;
/// Smallest number of missing bytes worth measuring: with fewer, wake-ups take most of the time.
const MIN_BYTES: usize = 256;
/// Smallest number of missing pieces worth a pause, if they are as large as the first. A URG on USB
/// sends its scans in four frames, and to suspend and resume the wake-ups costs more than three.
const MIN_PIECES: usize = 4;
/// Number of reply lengths to remember. A program polls a few windows.
const LENGTHS: usize = 8;
/// Lengths that differ by at most this number of bytes count as the same: the driver adds points to a
/// window, so that consecutive polls differ.
const SAME_LENGTH: usize = 8;
/// After a scan that was complete before its pause ended, the next pause ends earlier, by at least the
/// first of these and this many times as early as before.
const FIRST_STEP: Duration = Duration::from_millis(1);
const STEP_GROWTH: u32 = 10;
/// Lateness of a tokio timer on an idle runtime: it counts whole milliseconds, and one has begun.
const TIMER_DELAY: Duration = Duration::from_millis(1);

/// Decides when to pause, and for how long.
#[derive(Debug, Default)]
pub(super) struct Pauses {
    /// One for each reply length, the last used first. Replies of different lengths take
    /// different times per byte, because an adapter holds back the end of each.
    transfers: Vec<Transfers>,
    /// Scan that is arriving.
    current: Option<Current>,
}

/// Times that replies of one length take.
#[derive(Debug)]
struct Transfers {
    /// Length of the first, including the terminator.
    length: usize,
    /// Nanoseconds per byte of the scans whose end was seen, newest first.
    times: [u32; RECENT],
    /// How much earlier pauses end than these times say, in order to see the end of a scan although it
    /// is faster, or timers are late.
    early: Duration,
}

/// Partly received scan.
#[derive(Debug, Clone, Copy)]
struct Current {
    /// When its first piece was read.
    since: Instant,
    /// Number of bytes missing at that time.
    missing: usize,
    /// Length including the terminator.
    length: usize,
    /// False while pieces wake the driver, so that it sees when the last one arrives.
    is_paused: bool,
}

impl Pauses {
    /// Expects the next byte as the first of a reply.
    pub(super) fn begin_reply(&mut self) {
        self.current = None;
    }

    /// Decides until when to pause, or returns `None` to wait for the next piece. `present`
    /// is the number of received bytes, all read, and `missing` the number still to come. A
    /// pause ends at the deadline at the latest.
    pub(super) fn next(
        &mut self,
        present: usize,
        missing: usize,
        deadline: Instant,
    ) -> Option<Instant> {
        if self.current.is_none() && missing < MIN_BYTES {
            return None;
        }
        let now = Instant::now();
        let length = present + missing;
        let first = Current { since: now, missing, length, is_paused: false };
        let current = self.current.get_or_insert(first);
        current.is_paused = false;
        if current.missing < MIN_PIECES * (length - current.missing) {
            return None;
        }
        // Counts from the first piece, because the last piece takes no time once it is complete.
        let transfers = self.transfers.iter().find(|transfers| transfers.is_for(length))?;
        let end = current.since + transfers.shortest_time(current.missing)?;
        let margin = TIMER_DELAY + transfers.early;
        let left = end.min(deadline).saturating_duration_since(now).checked_sub(margin)?;
        // Whole milliseconds, so that the timer is not later than expected.
        let pause = Duration::from_millis(left.as_millis() as u64);
        current.is_paused = !pause.is_zero();
        current.is_paused.then(|| now + pause)
    }

    /// Records when the last byte of a frame was read, and the frame's length on the wire.
    pub(super) fn end_reply(&mut self, received: Instant, wire_len: u64) {
        let Some(current) = self.current.take() else { return };
        if wire_len != current.length as u64 {
            return;
        }
        if !self.transfers.first().is_some_and(|transfers| transfers.is_for(current.length)) {
            self.bring_to_front(current.length);
        }
        let time = received.saturating_duration_since(current.since);
        if let Some(transfers) = self.transfers.first_mut() {
            transfers.record(time, current.missing, !current.is_paused);
        }
    }

    #[cold]
    fn bring_to_front(&mut self, length: usize) {
        let known = self.transfers.iter().position(|transfers| transfers.is_for(length));
        let transfers = match known {
            Some(at) => self.transfers.remove(at),
            None => Transfers { length, times: [u32::MAX; RECENT], early: Duration::ZERO },
        };
        self.transfers.truncate(LENGTHS - 1);
        self.transfers.insert(0, transfers);
    }
}

impl Transfers {
    fn is_for(&self, length: usize) -> bool {
        self.length.abs_diff(length) <= SAME_LENGTH
    }

    /// Shortest time for receiving `bytes` bytes, or `None` before enough were measured.
    fn shortest_time(&self, bytes: usize) -> Option<Duration> {
        self.times.get(MEASURED_FIRST - 1).filter(|time| **time < u32::MAX)?;
        let shortest = u64::from(*self.times.iter().min()?);
        Some(Duration::from_nanos(shortest * bytes as u64))
    }

    /// Records the time that `bytes` bytes took to arrive, which is exact only if the driver was
    /// awake when the last one did (`is_seen`).
    fn record(&mut self, time: Duration, bytes: usize, is_seen: bool) {
        if !is_seen {
            self.early = (self.early * STEP_GROWTH).max(FIRST_STEP);
            return;
        }
        // Slowly: on some lines every third or fourth scan is faster.
        self.early = self.early * 3 / 4;
        self.times.rotate_right(1);
        if let Some(newest) = self.times.first_mut() {
            *newest = u32::try_from((time / bytes as u32).as_nanos()).unwrap_or(u32::MAX);
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::advance;

    use super::*;

    /// Time between two pieces of a scan that takes 100 ms.
    const SLOW: Duration = Duration::from_micros(4762);
    const NEVER: Duration = Duration::from_secs(3600);

    /// Receives a scan of 22 pieces of 64 bytes. Pauses end late by `late`. Returns the number of
    /// wake-ups, with the one that sent the poll, and the delay between the last byte and its receipt.
    async fn receive(pauses: &mut Pauses, interval: Duration, late: Duration) -> (u32, Duration) {
        pauses.begin_reply();
        let (begin, mut wake_ups) = (Instant::now(), 2);
        loop {
            let come = begin.elapsed().div_duration_f64(interval) as u32;
            let missing = 21_u32.saturating_sub(come) as usize;
            if missing == 0 {
                break;
            }
            match pauses.next(64 * (22 - missing), 64 * missing, begin + NEVER) {
                Some(until) => advance(until - Instant::now() + late).await,
                None => advance(begin + interval * (come + 1) - Instant::now()).await,
            }
            wake_ups += 1;
        }
        pauses.end_reply(Instant::now(), 64 * 22);
        (wake_ups, begin.elapsed() - 21 * interval)
    }

    /// Pauses of a link on which enough scans were measured, each seen late by `late`.
    async fn measured(interval: Duration, late: Duration) -> Pauses {
        let mut pauses = Pauses::default();
        for _ in 0..MEASURED_FIRST {
            pauses.begin_reply();
            assert_eq!(pauses.next(64, 64 * 21, Instant::now() + NEVER), None);
            advance(21 * interval + late).await;
            pauses.end_reply(Instant::now(), 64 * 22);
        }
        pauses
    }

    #[tokio::test(start_paused = true)]
    async fn scans_are_soon_in_time_after_a_stall() {
        for late in (0..=100).map(|tenths| Duration::from_micros(100 * tenths)) {
            let mut pauses = measured(SLOW, Duration::from_millis(14)).await;
            for _ in 0..20 {
                receive(&mut pauses, SLOW, late).await;
            }
            let mut delays = Vec::new();
            for _ in 0..101 {
                delays.push(receive(&mut pauses, SLOW, late).await.1);
            }
            delays.sort();
            // Without pauses there is no delay: each piece wakes the driver.
            assert!(delays[50] <= Duration::from_millis(1), "{late:?}: {delays:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn pauses_return_after_timers_were_late() {
        let mut pauses = measured(SLOW, Duration::ZERO).await;
        for _ in 0..MEASURED_FIRST {
            receive(&mut pauses, SLOW, 40 * SLOW).await;
        }
        let (wake_ups, _) = receive(&mut pauses, SLOW, Duration::ZERO).await;
        assert_eq!(wake_ups, 23, "timers may be late again");
        for _ in 0..7 {
            receive(&mut pauses, SLOW, Duration::ZERO).await;
        }
        assert!(receive(&mut pauses, SLOW, Duration::ZERO).await.0 < 23);
    }

    #[tokio::test(start_paused = true)]
    async fn late_timers_and_fast_scans_cost_few_wake_ups() {
        let (usual, fast) = (Duration::from_micros(171), Duration::from_micros(120));
        let mut pauses = measured(usual, Duration::ZERO).await;
        let mut total = 0;
        for scan in 1..=200 {
            let (interval, late) = match scan % 20 {
                0 => (usual, Duration::from_millis(5)),
                10 => (fast, Duration::ZERO),
                _ => (usual, Duration::ZERO),
            };
            total += receive(&mut pauses, interval, TIMER_DELAY + late).await.0;
        }
        assert!(total <= 200 * 8, "{total}");
    }
}
