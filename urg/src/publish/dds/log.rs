//! Filter for what Cyclone DDS writes to standard error. Cyclone has no other way to report a
//! packet that it cannot send, and prints a line for each of them.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use crate::output::capture::Capture;
use crate::output::notice::notice;

/// Number of checks without an unsent packet after which sending works again. Covers one
/// announcement, every 2 s.
const FAILING_CHECKS: u32 = 6;

/// Maximum number of different lines printed in [`PAUSE`].
const MAX_LINES: usize = 20;

/// Time until a line is printed again.
const PAUSE: Duration = Duration::from_secs(600);

/// Lines printed lately, without what differs each time. Outlives the reopening of DDS.
static SAID: Mutex<BTreeMap<String, Instant>> = Mutex::new(BTreeMap::new());

/// Number of checks after which sending is judged: 5 s.
const SOME_CHECKS: u32 = 10;

/// What Cyclone's lines say about sending.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sending {
    Works,
    /// Some packets cannot be sent.
    Fails,
    /// For some seconds announcements cannot be sent that could be sent before.
    Stopped,
}

/// Receiver of Cyclone's lines.
pub(super) struct Log {
    unsent: Unsent,
    unsent_announcements: Unsent,
    last: Arc<Mutex<Option<String>>>,
    capture: Capture,
}

impl Log {
    pub(super) fn start() -> io::Result<Self> {
        let (unsent, unsent_announcements) = (Unsent::default(), Unsent::default());
        let (any, multicast) = (Arc::clone(&unsent.lines), Arc::clone(&unsent_announcements.lines));
        let last = Arc::<Mutex<_>>::default();
        let latest = Arc::clone(&last);
        let capture = Capture::start(move |line| {
            let text = text(line);
            if text.starts_with("ddsi_udp_conn_write") {
                tracing::debug!("{line}");
                any.fetch_add(1, Ordering::Relaxed);
                let is_multicast = text.contains("udp/239.255.0.1:");
                multicast.fetch_add(is_multicast.into(), Ordering::Relaxed);
                return;
            }
            if is_news(&mut SAID.lock(), text, Instant::now()) {
                notice(format_args!("DDS: {text}"));
            }
            *latest.lock() = Some(text.to_owned());
        })?;
        Ok(Self { unsent, unsent_announcements, last, capture })
    }

    /// Checks the lines since the last check. Call it at regular intervals.
    pub(super) fn check(&mut self) -> Sending {
        let (unsent, announcements) = (&mut self.unsent, &mut self.unsent_announcements);
        unsent.check();
        announcements.check();
        match (unsent.checks, announcements.checks) {
            (_, SOME_CHECKS..) if announcements.has_worked => Sending::Stopped,
            (0, _) => Sending::Works,
            _ => Sending::Fails,
        }
    }

    /// Waits for all lines. Returns the last one that was not about an unsent packet.
    pub(super) fn finish(self) -> Option<String> {
        drop(self.capture);
        self.last.lock().take()
    }
}

/// Packets that could not be sent.
#[derive(Default)]
struct Unsent {
    lines: Arc<AtomicU64>,
    seen: u64,
    /// Checks without a line before sending works again.
    left: u32,
    /// Checks since sending began to fail.
    checks: u32,
    /// Checks since it began to work.
    working_checks: u32,
    /// Whether it ever worked for some time.
    has_worked: bool,
}

impl Unsent {
    fn check(&mut self) {
        let lines = self.lines.load(Ordering::Relaxed);
        let is_new = std::mem::replace(&mut self.seen, lines) != lines;
        self.left = if is_new { FAILING_CHECKS } else { self.left.saturating_sub(1) };
        let is_failing = self.left > 0;
        self.checks = if is_failing { self.checks + 1 } else { 0 };
        self.working_checks = if is_failing { 0 } else { self.working_checks + 1 };
        self.has_worked |= self.working_checks >= SOME_CHECKS;
    }
}

/// Checks whether a line is to be printed, and remembers it. Lines that differ only in numbers,
/// such as addresses in memory, count as the same.
fn is_news(said: &mut BTreeMap<String, Instant>, text: &str, now: Instant) -> bool {
    let is_number = |word: &&str| word.contains(|c: char| c.is_ascii_digit());
    let words = text.split([' ', '(', ')', ',', '=', '@']).filter(|word| !is_number(word));
    let key = words.collect::<Vec<_>>().join(" ");
    said.retain(|_, at| now - *at < PAUSE);
    if said.contains_key(&key) || said.len() >= MAX_LINES {
        return false;
    }
    said.insert(key, now);
    true
}

/// Cuts the time and the thread off a line such as `1795395521.219124 [7]        dds: text`.
fn text(line: &str) -> &str {
    let text = line.split_once("]").and_then(|(_, rest)| rest.split_once(": "));
    text.map_or(line, |(_, text)| text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_printed_without_its_time_and_thread() {
        for (line, expected) in [
            (
                "1795395521.219124 [7]        dds: ddsi_udp_conn_write to udp/10.3.0.2:9161 failed",
                "ddsi_udp_conn_write to udp/10.3.0.2:9161 failed",
            ),
            ("1795395521.219124 [7]       recv: 10.1.0.1: no match", "10.1.0.1: no match"),
            ("thread 'x' panicked", "thread 'x' panicked"),
        ] {
            assert_eq!(text(line), expected);
        }
    }

    #[test]
    fn lines_are_limited_in_number_for_a_time() {
        let (mut said, start) = (BTreeMap::new(), Instant::now());
        let mut is_news = |text: &str, seconds| {
            super::is_news(&mut said, text, start + Duration::from_secs(seconds))
        };
        assert!(is_news("invalid packet (0x7f01) of 10.0.0.1:7400", 0));
        assert!(!is_news("invalid packet (0x8f02) of 10.0.0.2:7410", 1));
        for name in 'a'..='z' {
            is_news(&format!("a packet called {name}"), 2);
        }
        assert!(!is_news("another one", 500), "too many");
        assert!(is_news("invalid packet (0x7f01) of 10.0.0.1:7400", 700));
        assert!(is_news("another one", 700));
    }

    #[test]
    fn sending_fails_until_there_was_no_line_for_some_checks() {
        let mut unsent = Unsent::default();
        let mut check = |lines| {
            unsent.lines.fetch_add(lines, Ordering::Relaxed);
            unsent.check();
            (unsent.checks, unsent.has_worked)
        };
        assert_eq!(check(1), (1, false));
        let checks = [(); 6].map(|()| check(0).0);
        assert_eq!(checks, [2, 3, 4, 5, 6, 0]);
        let worked = [(); 10].map(|()| check(0).1);
        assert_eq!(worked.iter().filter(|worked| **worked).count(), 2);
        assert_eq!(check(1), (1, true));
    }
}
