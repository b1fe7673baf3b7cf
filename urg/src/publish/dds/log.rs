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

/// Maximum number of different lines printed in [`PAUSE`].
const MAX_LINES: usize = 20;

/// Time until a line is printed again.
const PAUSE: Duration = Duration::from_secs(600);

/// Lines printed lately, without what differs each time. Outlives the reopening of DDS.
static SAID: Mutex<BTreeMap<String, Instant>> = Mutex::new(BTreeMap::new());

/// Number of checks without an unsent packet after which sending works again. Covers one
/// announcement, every 2 s.
const FAILING_CHECKS: u32 = 6;

/// Number of checks after which sending is judged: 5 s.
const SOME_CHECKS: u32 = 10;

/// Receiver of Cyclone's lines.
pub(super) struct Log {
    last: Arc<Mutex<Option<String>>>,
    capture: Capture,
}

impl Log {
    /// Returns the counters of unsent packets, and of unsent announcements, too.
    pub(super) fn start() -> io::Result<(Self, [Unsent; 2])> {
        let unsent = <[Unsent; 2]>::default();
        let lines = unsent.each_ref().map(|unsent| Arc::clone(&unsent.lines));
        let last = Arc::<Mutex<_>>::default();
        let latest = Arc::clone(&last);
        let capture = Capture::start(move |line| {
            let text = text(line);
            if text.starts_with("ddsi_udp_conn_write") {
                tracing::debug!("{line}");
                let is_multicast = text.contains("udp/239.255.0.1:");
                for (lines, is_one) in lines.iter().zip([true, is_multicast]) {
                    lines.fetch_add(is_one.into(), Ordering::Relaxed);
                }
                return;
            }
            if is_news(&mut SAID.lock(), text, Instant::now()) {
                notice(format_args!("DDS: {text}"));
            }
            *latest.lock() = Some(text.to_owned());
        })?;
        Ok((Self { last, capture }, unsent))
    }

    /// Waits for all lines. Returns the last one that was not about an unsent packet.
    pub(super) fn finish(self) -> Option<String> {
        drop(self.capture);
        self.last.lock().take()
    }
}

/// Cuts the time and the thread off a line such as `1795395521.219124 [7]        dds: text`.
pub(super) fn text(line: &str) -> &str {
    let text = line.split_once(']').and_then(|(_, rest)| rest.split_once(": "));
    text.map_or(line, |(_, text)| text)
}

/// Packets that could not be sent.
#[derive(Default)]
pub(super) struct Unsent {
    /// Number of lines since the last check.
    lines: Arc<AtomicU64>,
    /// Checks without a line before sending works again.
    left: u32,
    /// Checks since it began to fail, or to work.
    checks: u32,
    /// Whether it ever worked for some time.
    has_worked: bool,
}

impl Unsent {
    /// Returns whether sending fails, and whether it has failed for some time after it worked.
    /// Call it at regular intervals.
    pub(super) fn check(&mut self) -> (bool, bool) {
        let was_failing = self.left > 0;
        let is_new = self.lines.swap(0, Ordering::Relaxed) > 0;
        self.left = if is_new { FAILING_CHECKS } else { self.left.saturating_sub(1) };
        let is_failing = self.left > 0;
        self.checks = if is_failing == was_failing { self.checks + 1 } else { 1 };
        self.has_worked |= !is_failing && self.checks >= SOME_CHECKS;
        (is_failing, is_failing && self.has_worked && self.checks >= SOME_CHECKS)
    }
}

/// Checks whether a line is to be printed, and remembers it. Lines that differ only in numbers,
/// such as addresses in memory, count as the same.
fn is_news(said: &mut BTreeMap<String, Instant>, text: &str, now: Instant) -> bool {
    let key = text.replace(|c: char| c.is_ascii_hexdigit(), "");
    said.retain(|_, at| now - *at < PAUSE);
    if said.contains_key(&key) || said.len() >= MAX_LINES {
        return false;
    }
    said.insert(key, now);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_limited_in_number_for_a_time() {
        let (mut said, start) = (BTreeMap::new(), Instant::now());
        let mut is_news = |text: &str, seconds| {
            super::is_news(&mut said, text, start + Duration::from_secs(seconds))
        };
        assert!(is_news("invalid packet (0x7f01) of 10.0.0.1:7400", 0));
        assert!(!is_news("invalid packet (0x8f02) of 10.0.0.2:7410", 1));
        ('g'..='z').for_each(|name| _ = is_news(&format!("a packet called {name}"), 2));
        assert!(!is_news("another one", 500), "too many");
        assert!(is_news("invalid packet (0x7f01) of 10.0.0.1:7400", 700));
        assert!(is_news("another one", 700));
    }
}
