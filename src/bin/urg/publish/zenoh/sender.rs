//! The thread that puts messages into a zenoh session. A put waits there until the link
//! has room: `put` reports no message that zenoh drops, so that a drop must be ours to
//! be counted.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::thread::JoinHandle;
use std::time::SystemTime;

use zenoh::Wait;
use zenoh::pubsub::Publisher;

use super::send_queue::SendQueue;
use crate::publish::counts::ScanCounts;
use crate::publish::engine::Publish;

/// A message under way, with its number in the metadata.
struct Message {
    publisher: Arc<Publisher<'static>>,
    payload: Vec<u8>,
    attachment: Vec<u8>,
    counts: Arc<ScanCounts>,
}

/// The state that publishers and the thread share.
struct Link {
    queue: SendQueue<Message>,
    /// True if messages can get out. A client without its router would lose them.
    is_connected: AtomicBool,
}

/// The thread that sends for all publishers.
pub(super) struct Sender {
    link: Arc<Link>,
    thread: JoinHandle<()>,
}

impl Sender {
    /// Starts the thread, with a queue of messages for each depth. Fails if the system
    /// has no more threads.
    pub(super) fn start(depths: impl IntoIterator<Item = usize>) -> Result<Self, String> {
        let link =
            Arc::new(Link { queue: SendQueue::new(depths), is_connected: AtomicBool::new(true) });
        let sending = Arc::clone(&link);
        let thread = std::thread::Builder::new()
            .name("sender".to_owned())
            .spawn(move || send(&sending))
            .map_err(|error| format!("cannot start the thread that sends: {error}"))?;
        Ok(Self { link, thread })
    }

    /// Returns the publisher that uses the queue at this place. `gid` is its identity for
    /// `rmw_zenoh`.
    pub(super) fn publisher(
        &self,
        topic: usize,
        publisher: Publisher<'static>,
        gid: [u8; 16],
        counts: Arc<ScanCounts>,
    ) -> Box<dyn Publish> {
        Box::new(ZenohPublisher {
            link: Arc::clone(&self.link),
            topic,
            publisher: Arc::new(publisher),
            gid,
            sequence: AtomicI64::new(1),
            counts,
        })
    }

    /// Notes whether messages can get out. Until they can, all are dropped: an old scan
    /// is of no use.
    pub(super) fn set_connected(&self, is_connected: bool) {
        self.link.is_connected.store(is_connected, Ordering::Relaxed);
        if !is_connected {
            self.link.queue.clear().iter().for_each(|message| message.counts.add_dropped());
        }
    }

    /// Sends what waits, and ends the thread. One that waits for a lost router ends
    /// later, by itself.
    pub(super) fn close(self) {
        self.link.queue.close();
        if self.link.is_connected.load(Ordering::Relaxed) {
            // It does not panic, and what it has not sent is lost anyway.
            let _ = self.thread.join();
        }
    }
}

fn send(link: &Link) {
    while let Some(message) = link.queue.pop() {
        let Message { publisher, payload, attachment, counts } = message;
        // Counted before: a scan that is lost while it waits is in transit.
        counts.add_published();
        // It fails only if the session is closed, and nothing is published after that.
        let _ = publisher.put(payload).attachment(attachment).wait();
    }
}

/// Publishes with the metadata that `rmw_zenoh` wants beside each message.
struct ZenohPublisher {
    link: Arc<Link>,
    /// Its place in the queue.
    topic: usize,
    publisher: Arc<Publisher<'static>>,
    gid: [u8; 16],
    sequence: AtomicI64,
    counts: Arc<ScanCounts>,
}

impl Publish for ZenohPublisher {
    fn publish(&self, payload: Vec<u8>) {
        // A dropped message has a number, too: the reader sees the gap.
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        if !self.link.is_connected.load(Ordering::Relaxed) {
            return self.counts.add_dropped();
        }
        let attachment = attachment(sequence, SystemTime::now(), self.gid);
        let publisher = Arc::clone(&self.publisher);
        let counts = Arc::clone(&self.counts);
        let message = Message { publisher, payload, attachment, counts };
        if let Some(dropped) = self.link.queue.push(self.topic, message) {
            dropped.counts.add_dropped();
        }
    }
}

/// Returns the metadata of a message: its number, the time, the publisher.
fn attachment(sequence: i64, time: SystemTime, gid: [u8; 16]) -> Vec<u8> {
    let since_1970 = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let nanos = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
    let mut bytes = Vec::with_capacity(33);
    bytes.extend_from_slice(&sequence.to_le_bytes());
    bytes.extend_from_slice(&nanos.to_le_bytes());
    // The length of the array that follows.
    bytes.push(16);
    bytes.extend_from_slice(&gid);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_has_the_form_of_rmw_zenoh() {
        let time = SystemTime::UNIX_EPOCH + std::time::Duration::from_nanos(258);
        let bytes = attachment(1, time, [7; 16]);
        assert_eq!(bytes.len(), 33);
        assert_eq!(bytes[..17], [1, 0, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 16]);
        assert_eq!(bytes[17..], [7; 16]);
    }
}
