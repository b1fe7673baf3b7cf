//! Filter for what Cyclone DDS writes to standard error. Cyclone has no other way to report a
//! packet that it cannot send, and prints a line for each of them.

use std::collections::BTreeSet;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;

use crate::output::capture::Capture;
use crate::output::notice::notice;

/// Number of checks without an unsent packet after which sending works again. Covers one
/// announcement, every 2 s.
const FAILING_CHECKS: u32 = 6;

const MAX_LINES: usize = 20;

/// Lines printed so far: each only once, even if DDS is opened again.
static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());

/// Receiver of Cyclone's lines.
pub(super) struct Log {
    unsent: Arc<AtomicU64>,
    seen: u64,
    failing_checks: u32,
    _capture: Capture,
}

impl Log {
    pub(super) fn start() -> io::Result<Self> {
        let unsent = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&unsent);
        let capture = Capture::start(move |line| {
            let text = text(line);
            if text.starts_with("ddsi_udp_conn_write") {
                tracing::debug!("{line}");
                count.fetch_add(1, Ordering::Relaxed);
                return;
            }
            let mut said = SAID.lock();
            if said.len() < MAX_LINES && said.insert(text.to_owned()) {
                notice(format_args!("DDS: {text}"));
            }
        })?;
        Ok(Self { unsent, seen: 0, failing_checks: 0, _capture: capture })
    }

    /// Checks whether Cyclone cannot send packets. Call it at regular intervals.
    pub(super) fn is_failing(&mut self) -> bool {
        let unsent = self.unsent.load(Ordering::Relaxed);
        self.failing_checks = if unsent == self.seen {
            self.failing_checks.saturating_sub(1)
        } else {
            FAILING_CHECKS
        };
        self.seen = unsent;
        self.failing_checks > 0
    }
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
}
