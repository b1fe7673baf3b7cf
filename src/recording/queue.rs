//! [`Queue`]: what waits for the thread that writes the file, how much may wait,
//! and that thread.

use std::collections::BTreeMap;
use std::io::{self, BufWriter, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use mcap::McapResult;
use tokio::sync::{oneshot, watch};

use super::RecordingError;
use super::recorder::Progress;
use super::writer::{LogClock, Times, Writer};
use crate::Scan;

/// How long what was recorded may stay in memory.
const FLUSH: Duration = Duration::from_secs(1);
/// How many bytes wait for a disk that is slow; at 10 scans a second that
/// is some four minutes.
const MOST: usize = 8 << 20;
/// How many are so few that a source that can wait goes on.
const FEW: usize = 1 << 20;
/// What an entry costs besides what it carries.
const OVERHEAD: usize = 128;

/// What is on its way into the file.
#[derive(Debug)]
pub(super) struct Queue {
    entries: mpsc::Sender<Entry>,
    /// How many bytes wait; nothing once nobody writes any more.
    waiting: watch::Sender<Option<usize>>,
    scans: AtomicU64,
    replies: AtomicU64,
    bytes: AtomicU64,
    lost: AtomicU64,
    lost_replies: AtomicU64,
    failure: Mutex<Option<RecordingError>>,
}

#[derive(Debug)]
pub(super) enum Entry {
    Scan(Scan),
    Reply {
        command: String,
        bytes: Box<[u8]>,
        times: Times,
    },
    Event {
        json: String,
        times: Times,
    },
    Metadata(BTreeMap<String, String>),
    /// The end, and who is to be told that it was written.
    Finish(oneshot::Sender<()>),
}

impl Entry {
    fn weight(&self) -> usize {
        OVERHEAD
            + match self {
                Self::Scan(scan) => scan.len() * size_of::<u16>(),
                Self::Reply { bytes, .. } => bytes.len(),
                Self::Event { json, .. } => json.len(),
                Self::Metadata(_) | Self::Finish(_) => 0,
            }
    }
}

impl Queue {
    fn new() -> (Self, mpsc::Receiver<Entry>) {
        let (entries, receiver) = mpsc::channel();
        let queue = Self {
            entries,
            waiting: watch::Sender::new(Some(0)),
            scans: AtomicU64::new(0),
            replies: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            lost_replies: AtomicU64::new(0),
            failure: Mutex::new(None),
        };
        (queue, receiver)
    }

    /// Begins a file, and the thread that writes it.
    pub(super) fn into_file(
        out: impl Write + Send + 'static,
        frame_id: String,
    ) -> Result<Arc<Self>, RecordingError> {
        let (queue, receiver) = Self::new();
        let queue = Arc::new(queue);
        let counted = Counted { out, queue: Arc::clone(&queue) };
        let writer = Writer::new(BufWriter::new(counted), LogClock::starting_now(), frame_id)
            .map_err(RecordingError::write)?;
        let thread = {
            let queue = Arc::clone(&queue);
            move || queue.end(write_all(writer, &receiver, &queue))
        };
        std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(thread)
            .map_err(|error| RecordingError::Write { source: Arc::new(error) })?;
        Ok(queue)
    }

    /// Queues an entry, unless too much is queued already or nobody writes any
    /// more: then it is lost.
    pub(super) fn push(&self, entry: Entry) {
        let weight = entry.weight();
        let counters = match &entry {
            Entry::Scan(_) => Some((&self.scans, &self.lost)),
            Entry::Reply { .. } => Some((&self.replies, &self.lost_replies)),
            _ => None,
        };
        let room = self.waiting.send_if_modified(|waiting| {
            let more = waiting.map(|waiting| waiting + weight).filter(|more| *more <= MOST);
            *waiting = more.or(*waiting);
            more.is_some()
        });
        let queued = room && self.entries.send(entry).is_ok();
        if let Some((kept, lost)) = counters {
            if queued { kept } else { lost }.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Waits until only few bytes wait, or nobody writes any more.
    pub(super) async fn room(&self) {
        // The sender is here.
        let few = |waiting: &Option<usize>| waiting.is_none_or(|waiting| waiting <= FEW);
        let _ = self.waiting.subscribe().wait_for(few).await;
    }

    /// Ends the file behind what is queued; the receiver is told, or dropped where
    /// the thread has failed.
    pub(super) fn finish(&self) -> oneshot::Receiver<()> {
        let (done, finished) = oneshot::channel();
        // No thread: no need.
        let _ = self.entries.send(Entry::Finish(done));
        finished
    }

    pub(super) fn progress(&self) -> Progress {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Progress {
            scans: count(&self.scans),
            replies: count(&self.replies),
            bytes: count(&self.bytes),
            lost: count(&self.lost),
            lost_replies: count(&self.lost_replies),
        }
    }

    /// Why writing failed, if it did.
    pub(super) fn failure(&self) -> Option<RecordingError> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Nobody writes any more, so that nothing is waited for.
    fn end(&self, outcome: McapResult<()>) {
        self.fail(outcome);
        self.waiting.send_replace(None);
    }

    /// Keeps why writing failed, for the recorder to tell; one line of log.
    fn fail(&self, outcome: McapResult<()>) {
        if let Err(error) = outcome.map_err(RecordingError::write) {
            let cause = std::error::Error::source(&error);
            tracing::error!(cause = cause.map(tracing::field::display), "{error}");
            *self.failure.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        }
    }
}

/// Writes the file until it is finished.
fn write_all<W: Write>(
    mut writer: Writer<W>,
    entries: &mpsc::Receiver<Entry>,
    queue: &Queue,
) -> McapResult<()> {
    // When the oldest thing came that is not in the file.
    let mut unwritten: Option<Instant> = None;
    loop {
        let entry = match unwritten {
            None => entries.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(since) => entries.recv_timeout(FLUSH.saturating_sub(since.elapsed())),
        };
        let weight = entry.as_ref().map_or(0, Entry::weight);
        match entry {
            Ok(Entry::Scan(scan)) => writer.scan(&scan)?,
            Ok(Entry::Reply { command, bytes, times }) => writer.reply(&command, &bytes, times)?,
            Ok(Entry::Event { json, times }) => writer.event(&json, times)?,
            Ok(Entry::Metadata(metadata)) => writer.metadata(metadata)?,
            Ok(Entry::Finish(done)) => {
                // Before whoever waits looks for it.
                queue.fail(writer.finish());
                // They may have given up.
                let _ = done.send(());
                return Ok(());
            }
            Err(RecvTimeoutError::Timeout) => {
                writer.flush()?;
                unwritten = None;
                continue;
            }
            Err(RecvTimeoutError::Disconnected) => return writer.finish(),
        }
        queue.waiting.send_modify(|waiting| *waiting = waiting.map(|waiting| waiting - weight));
        if unwritten.get_or_insert_with(Instant::now).elapsed() >= FLUSH {
            writer.flush()?;
            unwritten = None;
        }
    }
}

/// Counts the bytes that get through. What they go to is anybody's: that it panics
/// is a failure to write.
struct Counted<W> {
    out: W,
    queue: Arc<Queue>,
}

impl<W: Write> Counted<W> {
    fn caught<T>(&mut self, work: impl FnOnce(&mut W) -> io::Result<T>) -> io::Result<T> {
        let done = catch_unwind(AssertUnwindSafe(|| work(&mut self.out)));
        done.unwrap_or_else(|_| Err(io::Error::other("the writer panicked")))
    }
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.caught(|out| out.write(bytes))?;
        self.queue.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.caught(W::flush)
    }
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use futures::FutureExt as _;

    use super::*;

    /// The thread is told to be gone before its end of the channel is.
    #[test]
    fn nobody_waits_for_what_comes_while_the_thread_that_writes_ends() {
        let (queue, _receiver) = Queue::new();
        let times = Times { steady: Instant::now(), wall: SystemTime::now() };
        let push = || queue.push(Entry::Event { json: "x".repeat(FEW), times });
        push();
        push();
        assert!(queue.room().now_or_never().is_none());
        queue.end(Err(io::Error::from(io::ErrorKind::StorageFull).into()));
        push();
        push();
        assert!(queue.room().now_or_never().is_some());
    }
}
