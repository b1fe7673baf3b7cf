//! Thread that passes messages to the zenoh session. zenoh drops messages silently, so `put`
//! blocks until the link has room, and messages are dropped and counted in our own queue.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::SystemTime;

use zenoh::Wait;
use zenoh::pubsub::Publisher;

use crate::publish::counts::ScanCounts;
use crate::publish::engine::MessagePublisher;
use crate::publish::progress::Progress;
use crate::publish::send_queue::SendQueue;

/// Queued message. Its sequence number is in the attachment.
struct ZenohMessage {
    publisher: Arc<Publisher<'static>>,
    payload: Vec<u8>,
    attachment: Vec<u8>,
    counts: Arc<ScanCounts>,
}

/// State shared by the publishers and the thread.
struct ZenohQueue {
    queue: SendQueue<ZenohMessage>,
    /// Whether messages can be sent. A client without its router would lose them.
    is_connected: AtomicBool,
    /// Number of messages taken from the queue.
    taken: AtomicU64,
}

/// Handle of the thread that sends for all publishers.
pub(super) struct Sender {
    link: Arc<ZenohQueue>,
    thread: JoinHandle<()>,
    progress: Progress,
}

impl Sender {
    pub(super) fn start(depths: impl IntoIterator<Item = usize>) -> Result<Self, String> {
        let link = Arc::new(ZenohQueue {
            queue: SendQueue::new(depths),
            is_connected: AtomicBool::new(true),
            taken: AtomicU64::new(0),
        });
        let sending = Arc::clone(&link);
        let thread = std::thread::Builder::new()
            .name("sender".to_owned())
            .spawn(move || send(&sending))
            .map_err(|error| format!("cannot start the thread that sends: {error}"))?;
        Ok(Self { link, thread, progress: Progress::default() })
    }

    /// Creates the publisher for the queued topic at index `topic`. `gid` identifies it for
    /// `rmw_zenoh`.
    pub(super) fn publisher(
        &self,
        topic: usize,
        publisher: Publisher<'static>,
        gid: [u8; 16],
        counts: Arc<ScanCounts>,
    ) -> Box<dyn MessagePublisher> {
        Box::new(ZenohPublisher {
            link: Arc::clone(&self.link),
            topic,
            publisher: Arc::new(publisher),
            gid,
            sequence: AtomicI64::new(1),
            counts,
        })
    }

    /// Sets whether messages can be sent. Without a connection, all messages are dropped: old
    /// scans are useless.
    pub(super) fn set_connected(&self, is_connected: bool) {
        self.link.is_connected.store(is_connected, Ordering::Relaxed);
        if !is_connected {
            self.link.queue.clear().iter().for_each(|message| message.counts.add_dropped());
        }
    }

    /// Checks whether messages have been waiting too long. Call it at regular intervals.
    pub(super) fn is_stuck(&mut self) -> bool {
        let is_waiting =
            self.link.is_connected.load(Ordering::Relaxed) && !self.link.queue.is_empty();
        self.progress.is_stuck(self.link.taken.load(Ordering::Relaxed), is_waiting)
    }

    /// Sends pending messages, and stops the thread. Without a connection, does not wait for the
    /// thread.
    pub(super) fn close(self) {
        self.link.queue.close();
        if self.link.is_connected.load(Ordering::Relaxed) {
            // The thread does not panic.
            let _ = self.thread.join();
        }
    }
}

fn send(link: &ZenohQueue) {
    while let Some((_, message)) = link.queue.pop() {
        link.taken.fetch_add(1, Ordering::Relaxed);
        let ZenohMessage { publisher, payload, attachment, counts } = message;
        // Counted before `put`, so that a scan waiting there counts as in transit.
        counts.add_published();
        // Fails only after the session is closed.
        let _ = publisher.put(payload).attachment(attachment).wait();
    }
}

/// Publisher that attaches the metadata `rmw_zenoh` expects.
struct ZenohPublisher {
    link: Arc<ZenohQueue>,
    /// Index of the topic in the queue.
    topic: usize,
    publisher: Arc<Publisher<'static>>,
    gid: [u8; 16],
    sequence: AtomicI64,
    counts: Arc<ScanCounts>,
}

impl MessagePublisher for ZenohPublisher {
    fn publish(&self, payload: Vec<u8>) {
        // Dropped messages use up a number, so that readers see the gap.
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        if !self.link.is_connected.load(Ordering::Relaxed) {
            return self.counts.add_dropped();
        }
        let attachment = attachment(sequence, SystemTime::now(), self.gid);
        let publisher = Arc::clone(&self.publisher);
        let counts = Arc::clone(&self.counts);
        let message = ZenohMessage { publisher, payload, attachment, counts };
        if let Some(dropped) = self.link.queue.push(self.topic, message) {
            dropped.counts.add_dropped();
        }
    }
}

/// Encodes the metadata of a message: sequence number, time, GID of the publisher.
pub(super) fn attachment(sequence: i64, time: SystemTime, gid: [u8; 16]) -> Vec<u8> {
    let since_1970 = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let nanos = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
    let mut bytes = Vec::with_capacity(33);
    bytes.extend_from_slice(&sequence.to_le_bytes());
    bytes.extend_from_slice(&nanos.to_le_bytes());
    // Length of the GID.
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
