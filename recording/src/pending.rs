//! [`PendingReplies`]: replies that wait for their scans, so that a recording has the scans of its
//! stream and no more.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use tokio_scip::{Scan, Window};

use super::item::WriteItem;
use super::reply::RecordedReply;

/// Longest time that a reply waits for a consumer that is behind.
const MAX_WAIT: Duration = Duration::from_millis(500);
/// Largest number of bytes that wait.
const MAX_BYTES: usize = 1 << 20;

/// Holds each reply back until the recorded stream shows whether it has a scan of it.
///
/// In SCIP 2 a sensor may send more scans than the rate of the stream asks for. When the stream's next scan
/// is recorded, scans that the sensor sent before it are dropped, unless the consumer has missed some.
#[derive(Debug, Default)]
pub(super) struct PendingReplies {
    /// Window and sequence number of the latest recorded scan.
    latest: Option<(Window, u64)>,
    replies: VecDeque<WriteItem>,
    bytes: usize,
}

impl PendingReplies {
    /// Takes the next item, and passes on what is to be written now.
    pub(super) fn take(&mut self, item: WriteItem, now: Instant, mut write: impl FnMut(WriteItem)) {
        match item {
            WriteItem::Reply { .. } if self.waits(&item) => {
                self.bytes += item.weight();
                self.replies.push_back(item);
                while self.bytes > MAX_BYTES || self.is_overdue(now) {
                    self.pop().into_iter().for_each(&mut write);
                }
            }
            WriteItem::Scan(scan) => {
                self.write_replies_to(&scan, &mut write);
                write(WriteItem::Scan(scan));
            }
            item => {
                while let Some(reply) = self.pop() {
                    write(reply);
                }
                write(item);
            }
        }
    }

    /// Ends the recording: passes on the replies that still wait, except for scans, which no consumer has taken.
    pub(super) fn end(&mut self, mut write: impl FnMut(WriteItem)) {
        while let Some(reply) = self.pop() {
            if self.latest.is_none() || !has_scan(&reply, |_| true) {
                write(reply);
            }
        }
    }

    /// Passes on the reply with this scan, and those before it.
    fn write_replies_to(&mut self, scan: &Scan, mut write: impl FnMut(WriteItem)) {
        let (window, number) = (scan.window(), scan.sequence());
        let before = number.checked_sub(1).map(|before| (window, before));
        let is_next = self.latest.replace((window, number)) == before;
        let is_its_own = |reply: &WriteItem| matches!(reply, WriteItem::Reply { times, .. } if times.wall == scan.times().stamp);
        let Some(place) = self.replies.iter().position(is_its_own) else { return };
        for _ in 0..place {
            let reply = self.pop();
            let reply =
                reply.filter(|reply| !(is_next && has_scan(reply, RecordedReply::is_streamed)));
            reply.into_iter().for_each(&mut write);
        }
        self.pop().into_iter().for_each(write);
    }

    /// Before the first scan, only replies of a stream wait: a recording may have nothing but replies.
    fn waits(&self, reply: &WriteItem) -> bool {
        let is_begun = self.latest.is_some() || !self.replies.is_empty();
        is_begun || has_scan(reply, RecordedReply::is_streamed)
    }

    fn pop(&mut self) -> Option<WriteItem> {
        let reply = self.replies.pop_front()?;
        self.bytes -= reply.weight();
        Some(reply)
    }

    fn is_overdue(&self, now: Instant) -> bool {
        let Some(WriteItem::Reply { times, .. }) = self.replies.front() else { return false };
        now.saturating_duration_since(times.steady) > MAX_WAIT
    }
}

/// Checks whether a reply has a scan, and is one that `is_meant`.
fn has_scan(reply: &WriteItem, is_meant: impl Fn(&RecordedReply) -> bool) -> bool {
    let WriteItem::Reply { request, bytes, times } = reply else { return false };
    let reply = RecordedReply::new(request, &[bytes, &b"\n\n"[..]].concat(), times.wall);
    is_meant(&reply) && reply.values().is_some()
}
