//! [`Pauses`]: the times during which nothing needs to wake the driver while a reply
//! trickles in.
//!
//! A serial line delivers a scan in 20 to 100 pieces. To be woken for each costs more than
//! all other work on the scan (`benches/README.md`, item 12). Once a scan has begun, the rest
//! takes at least as long as that of the fastest scan lately, so the driver sleeps until
//! shortly before its end. The time is measured, not computed from the baud rate: that of
//! a pseudo-terminal or of USB means nothing. The port must be able to stop its wake-ups.

use std::time::Duration;

use tokio::time::Instant;

/// The number of scans that are read piece by piece, and so measured, before the first
/// pause: one alone may have been slow.
const MEASURED_FIRST: u32 = 3;
/// Between so many measured scans and twice as many count as those of lately.
const MEASURED_LATELY: u32 = 16;
/// The number of missing bytes from which a scan is measured. The time of fewer bytes is
/// mostly that of the wake-ups at both ends.
const MIN_BYTES: usize = 256;
/// The share of the shortest time that a pause takes, after so many scans in a row of
/// which the end was not seen: they come faster than expected.
const SHARES: [f64; 4] = [1.0, 0.875, 0.75, 0.5];
/// The time by which a timer of tokio is late on an idle runtime: it counts whole
/// milliseconds, of which one has begun.
const TIMER_DELAY: Duration = Duration::from_millis(1);

/// Decides when to pause, and for how long.
#[derive(Debug, Default)]
pub(super) struct Pauses {
    /// The shortest time a byte, in seconds, of the scans that were measured lately, and
    /// of those before.
    shortest: [Option<f64>; 2],
    /// The number of scans that the first of these stands for.
    measured: u32,
    /// The number of scans in a row that were complete before their pause had ended.
    unseen: usize,
    /// The scan that is arriving.
    current: Option<Current>,
}

/// A scan of which a part is there.
#[derive(Debug, Clone, Copy)]
struct Current {
    /// The time when its first piece was read.
    since: Instant,
    /// The number of bytes that were missing then.
    missing: usize,
    /// Its length with the terminator.
    length: usize,
    /// True while pieces wake the driver, so that the time of the last one is seen.
    is_watched: bool,
}

impl Pauses {
    /// Notes that the next byte is the first of a reply.
    pub(super) fn begin_reply(&mut self) {
        self.current = None;
    }

    /// Returns the time until which to pause, or `None` to wait for the next piece: of a
    /// scan `present` bytes are read, all that have come, and `missing` ones follow, at the
    /// latest at the deadline.
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
        let first = Current { since: now, missing, length, is_watched: true };
        let current = *self.current.get_or_insert(first);
        // Counted from the first piece: the last one takes no time once it is complete.
        let end = self.shortest_time(current.missing).map(|shortest| {
            let share = SHARES.get(self.unseen).copied().unwrap_or(0.0);
            current.since + shortest.mul_f64(share)
        });
        let pause = end.and_then(|end| {
            let end = end.min(deadline);
            let left = end.saturating_duration_since(now).checked_sub(TIMER_DELAY)?;
            // Whole milliseconds, so that the timer is not later than expected.
            let pause = Duration::from_millis(left.as_millis() as u64);
            (!pause.is_zero()).then(|| now + pause)
        });
        if let Some(current) = &mut self.current {
            current.is_watched = pause.is_none();
        }
        pause
    }

    /// Notes when the last byte of a frame was read, which had so many on the wire.
    pub(super) fn end_reply(&mut self, received: Instant, wire_len: u64) {
        let Some(current) = self.current.take() else { return };
        if wire_len != current.length as u64 {
            return;
        }
        let time = received.saturating_duration_since(current.since);
        if current.is_watched {
            self.unseen = 0;
            self.note(time.as_secs_f64() / current.missing as f64);
        } else if self.shortest_time(current.missing).is_some_and(|shortest| time < shortest) {
            self.unseen += 1;
        }
    }

    /// Returns the shortest time in which so many bytes come.
    fn shortest_time(&self, bytes: usize) -> Option<Duration> {
        let [lately, before] = self.shortest;
        if before.is_none() && self.measured < MEASURED_FIRST {
            return None;
        }
        let shortest = lately.into_iter().chain(before).reduce(f64::min)?;
        Some(Duration::from_secs_f64(shortest * bytes as f64))
    }

    /// Notes the time a byte of a scan that was measured.
    fn note(&mut self, time: f64) {
        let [lately, before] = &mut self.shortest;
        if self.measured >= MEASURED_LATELY {
            *before = lately.take();
            self.measured = 0;
        }
        self.measured += 1;
        *lately = Some(lately.map_or(time, |shortest| shortest.min(time)));
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::advance;

    use super::*;

    /// The bytes of a scan's first piece and of the rest, which takes 100 ms.
    const PIECE: usize = 14;
    const REST: usize = 1_385;
    const REST_TIME: Duration = Duration::from_millis(100);

    /// Pauses of a link of which enough scans were measured.
    async fn measured() -> Pauses {
        let mut pauses = Pauses::default();
        for _ in 0..MEASURED_FIRST {
            pauses.begin_reply();
            assert_eq!(next(&mut pauses, REST), None);
            advance(REST_TIME).await;
            pauses.end_reply(Instant::now(), (PIECE + REST) as u64);
        }
        pauses
    }

    /// Returns how long the pause is, at the first piece of a scan of which so many bytes
    /// are missing.
    fn next(pauses: &mut Pauses, missing: usize) -> Option<Duration> {
        let now = Instant::now();
        pauses.next(PIECE, missing, now + Duration::from_secs(10)).map(|until| until - now)
    }

    #[tokio::test(start_paused = true)]
    async fn a_pause_is_counted_from_its_own_reply_and_not_from_one_that_was_never_whole() {
        let mut pauses = measured().await;
        pauses.begin_reply();
        assert!(next(&mut pauses, REST).is_some());
        advance(Duration::from_secs(1)).await;
        pauses.begin_reply();
        let pause = next(&mut pauses, REST).unwrap();
        assert!(pause > REST_TIME - 3 * TIMER_DELAY && pause < REST_TIME, "{pause:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn the_last_bytes_of_a_reply_are_awaited_without_a_pause() {
        let mut pauses = measured().await;
        pauses.begin_reply();
        assert_eq!(next(&mut pauses, MIN_BYTES - 1), None);
        assert!(next(&mut pauses, MIN_BYTES).is_some());
    }

    #[tokio::test(start_paused = true)]
    async fn scans_that_take_exactly_the_shortest_time_make_no_pause_shorter() {
        let mut pauses = measured().await;
        for _ in 0..=SHARES.len() {
            pauses.begin_reply();
            let pause = next(&mut pauses, REST).unwrap();
            assert!(pause > REST_TIME - 3 * TIMER_DELAY, "{pause:?}");
            advance(REST_TIME).await;
            pauses.end_reply(Instant::now(), (PIECE + REST) as u64);
        }
    }
}
