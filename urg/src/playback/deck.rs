//! Arithmetic of a playback: decides when to show each scan, without a clock, a task or a file.

use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;
use tokio::time::Instant;

use super::command::PlaybackCommand;
use super::settings::SPEEDS;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct PlaybackStatus {
    /// Number of the current scan, from 0.
    pub(crate) scan: usize,
    /// Number of scans in the recording.
    pub(crate) scans: usize,
    /// Seconds since the first scan.
    pub(crate) position: f64,
    /// Seconds from the first scan to the last.
    pub(crate) length: f64,
    pub(crate) paused: bool,
    /// True at the last scan, unless the playback loops.
    pub(crate) ended: bool,
    pub(crate) speed: f64,
    #[serde(rename = "loop")]
    pub(crate) is_looping: bool,
}

#[derive(Debug)]
pub(super) struct Deck {
    /// Time of each scan since the first. Never empty.
    times: Arc<[Duration]>,
    scan: usize,
    /// Position at `since`.
    position: Duration,
    since: Instant,
    paused: bool,
    speed: f64,
    is_looping: bool,
}

impl Deck {
    /// Starts at the first scan. `times` are relative to the first scan.
    pub(super) fn new(times: Arc<[Duration]>, speed: f64, is_looping: bool, now: Instant) -> Self {
        let (scan, position) = (0, Duration::ZERO);
        Self { times, scan, position, since: now, paused: false, speed, is_looping }
    }

    fn length(&self) -> Duration {
        self.times.last().copied().unwrap_or_default()
    }

    fn time(&self, scan: usize) -> Duration {
        self.times.get(scan).copied().unwrap_or_default()
    }

    fn last(&self) -> usize {
        self.times.len().saturating_sub(1)
    }

    /// Finds the last scan at or before a position.
    fn scan_at(&self, position: Duration) -> usize {
        self.times.partition_point(|time| *time <= position).saturating_sub(1)
    }

    /// Position where a loop starts over. The last scan stays as long as the scan before it, but at least 0.1 s.
    fn end_of_loop(&self) -> Duration {
        let last = self.length().saturating_sub(self.time(self.last().saturating_sub(1)));
        self.length() + last.max(Duration::from_millis(100))
    }

    fn ended(&self) -> bool {
        !self.is_looping && self.position >= self.length()
    }

    fn is_moving(&self) -> bool {
        !self.paused && !self.ended()
    }

    /// Moves to `now`. Passes over scans if the caller is too slow to show each of them.
    pub(super) fn advance(&mut self, now: Instant) {
        let elapsed = now.saturating_duration_since(self.since).mul_f64(self.speed);
        let was_moving = self.is_moving();
        self.since = now;
        if !was_moving {
            return;
        }
        self.position += elapsed;
        if self.position >= self.length() {
            if !self.is_looping {
                self.position = self.length();
            } else if self.position >= self.end_of_loop() {
                self.position = Duration::ZERO;
            }
        }
        self.scan = self.scan_at(self.position);
    }

    /// Returns the time of the next change, or `None` if only a command can change anything.
    pub(super) fn due(&self) -> Option<Instant> {
        if !self.is_moving() {
            return None;
        }
        let next = match self.times.get(self.scan + 1) {
            Some(next) => *next,
            None => self.end_of_loop(),
        };
        let wait = next.saturating_sub(self.position).div_f64(self.speed);
        // Round up: if the timer fired too early, the scan would not be due yet.
        self.since.checked_add(wait + Duration::from_millis(1))
    }

    pub(super) fn apply(&mut self, command: PlaybackCommand, now: Instant) {
        use PlaybackCommand::{Loop, Pause, Play, Scan, Seek, SeekBy, Speed, Step, Toggle};
        self.advance(now);
        match command {
            Pause => self.paused = true,
            Play => self.play(),
            Toggle if self.is_moving() => self.paused = true,
            Toggle => self.play(),
            Step(count) => {
                self.paused = true;
                self.go_to(self.scan.saturating_add_signed(count));
            }
            Scan(scan) => self.go_to(scan),
            Seek(seconds) => self.seek(seconds),
            SeekBy(seconds) => self.seek(self.position.as_secs_f64() + seconds),
            Speed(speed) => self.speed = speed.clamp(*SPEEDS.start(), *SPEEDS.end()),
            Loop(is_looping) => self.is_looping = is_looping,
        }
    }

    fn play(&mut self) {
        if self.ended() {
            self.go_to(0);
        }
        self.paused = false;
    }

    fn go_to(&mut self, scan: usize) {
        self.scan = scan.min(self.last());
        self.position = self.time(self.scan);
    }

    fn seek(&mut self, seconds: f64) {
        let position = Duration::try_from_secs_f64(seconds.max(0.0)).unwrap_or(Duration::MAX);
        self.position = position.min(self.length());
        self.scan = self.scan_at(self.position);
    }

    pub(super) fn status(&self) -> PlaybackStatus {
        PlaybackStatus {
            scan: self.scan,
            scans: self.times.len(),
            position: self.position.min(self.length()).as_secs_f64(),
            length: self.length().as_secs_f64(),
            paused: self.paused,
            ended: self.ended(),
            speed: self.speed,
            is_looping: self.is_looping,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten scans a second, for a second.
    fn deck(is_looping: bool, now: Instant) -> Deck {
        let times = (0..11).map(|tenth| Duration::from_millis(tenth * 100));
        Deck::new(times.collect(), 1.0, is_looping, now)
    }

    fn after(now: Instant, millis: u64) -> Instant {
        now + Duration::from_millis(millis)
    }

    #[test]
    fn each_scan_is_shown_at_its_time() {
        let now = Instant::now();
        let mut deck = deck(false, now);
        for (millis, scan) in [(0, 0), (99, 0), (101, 1), (550, 5), (999, 9), (1001, 10)] {
            deck.advance(after(now, millis));
            assert_eq!(deck.status().scan, scan, "{millis}");
        }
        assert!(deck.status().ended && deck.due().is_none());
        deck.advance(after(now, 60_000));
        assert_eq!(deck.status().scan, 10);
        // Playing again starts at the first scan.
        deck.apply(PlaybackCommand::Toggle, after(now, 60_000));
        assert_eq!(deck.status().scan, 0);
        deck.advance(after(now, 60_250));
        assert_eq!(deck.status().scan, 2);
    }

    #[test]
    fn a_pause_keeps_the_position_however_long_it_is() {
        let now = Instant::now();
        let mut deck = deck(false, now);
        deck.apply(PlaybackCommand::Pause, after(now, 450));
        assert_eq!((deck.status().scan, deck.due()), (4, None));
        deck.apply(PlaybackCommand::Play, after(now, 90_000));
        assert!((deck.status().position - 0.45).abs() < 1e-6, "{:?}", deck.status());
        deck.advance(after(now, 90_060));
        assert_eq!(deck.status().scan, 5);
    }

    #[test]
    fn steps_and_seeks_go_no_farther_than_the_ends() {
        use PlaybackCommand::{Scan, Seek, SeekBy, Step};
        let now = Instant::now();
        let mut deck = deck(false, now);
        for (command, scan) in [
            (Seek(0.75), 7),
            (SeekBy(-0.5), 2),
            (SeekBy(-99.0), 0),
            (Seek(1e300), 10),
            (Scan(3), 3),
            (Scan(usize::MAX), 10),
            (Step(-1), 9),
            (Step(isize::MAX), 10),
            (Step(isize::MIN), 0),
        ] {
            deck.apply(command, now);
            assert_eq!(deck.status().scan, scan, "{command:?}");
            assert_eq!(deck.status().paused, matches!(command, Step(_)));
        }
    }

    #[test]
    fn speed_is_a_factor_from_now_on() {
        let now = Instant::now();
        let mut deck = deck(false, now);
        deck.apply(PlaybackCommand::Speed(2.0), after(now, 200));
        deck.advance(after(now, 310));
        assert_eq!(deck.status().scan, 4);
        deck.apply(PlaybackCommand::Speed(0.5), after(now, 310));
        deck.advance(after(now, 520));
        assert_eq!(deck.status().scan, 5);
        assert!(deck.due().unwrap() >= after(now, 670));
    }

    #[test]
    fn a_loop_begins_again_after_its_last_scan_was_shown() {
        let now = Instant::now();
        let mut deck = deck(true, now);
        deck.advance(after(now, 1050));
        assert_eq!(deck.status().scan, 10);
        deck.advance(deck.due().unwrap());
        assert!(deck.status().scan == 0 && !deck.status().ended);
        assert!(deck.due().is_some());
    }

    #[test]
    fn a_recording_of_one_scan_does_not_spin() {
        let now = Instant::now();
        for is_looping in [false, true] {
            let mut deck = Deck::new(Arc::new([Duration::ZERO]), 1.0, is_looping, now);
            deck.apply(PlaybackCommand::Play, now);
            deck.advance(after(now, 500));
            assert_eq!(deck.status().scan, 0);
            assert!(deck.due().is_none_or(|due| due > after(now, 550)));
        }
    }
}
