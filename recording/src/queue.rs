//! [`Queue`]: hands messages from async code to the thread that writes the file, and bounds
//! the waiting bytes. Also contains the thread. Before that, `pending` holds replies back until their
//! scans come, and `held` holds all messages until the trigger.

use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use tokio::time::Instant;

use super::file::RecordingFile;
use super::held::Held;
use super::item::WriteItem;
use super::mcap::Compression;
use super::parts::{Limits, Parts};
use super::pending::PendingReplies;
use super::progress::Progress;
use super::sync::Syncer;
use super::writer::Writer;
use super::{RecordingError, lock};

/// Largest number of bytes that wait for a slow disk. At 10 scans per second, this takes
/// about three minutes. Of a UST it takes 20 s.
const HIGH_WATER_BYTES: usize = 8 << 20;
/// Largest number of bytes held before a trigger: the rest of the queue is for what comes while they are written.
const HELD_BYTES: usize = HIGH_WATER_BYTES / 2;
/// [`Queue::ready`] waits until at most this many bytes wait.
const LOW_WATER_BYTES: usize = 1 << 20;
#[derive(Debug)]
pub(super) struct Queue {
    items: mpsc::Sender<WriteItem>,
    pending: Mutex<PendingReplies>,
    /// Items before the trigger, if there is to be one.
    held: Mutex<Option<Held>>,
    /// Number of waiting bytes, or `None` once the thread has ended.
    waiting: watch::Sender<Option<usize>>,
    progress: Arc<Mutex<Progress>>,
    failure: Mutex<Option<RecordingError>>,
    /// `None` if nothing is synced.
    syncer: Option<Syncer>,
}

/// Settings that the threads of a recording need.
#[derive(Debug, Clone, Default)]
pub(super) struct QueueSettings {
    pub(super) limits: Limits,
    pub(super) frame_id: String,
    pub(super) compression: Compression,
    pub(super) sync_interval: Option<Duration>,
    pub(super) before: Option<Duration>,
}

impl Queue {
    /// Starts a file, and the threads that write and sync it.
    pub(super) fn into_file(
        file: RecordingFile,
        settings: QueueSettings,
    ) -> Result<Arc<Self>, RecordingError> {
        let syncer = settings.sync_interval.map(Syncer::start).transpose();
        let syncer = syncer.map_err(RecordingError::write)?;
        let path = file.first().map(Path::to_owned);
        let out = file.begin(syncer.clone()).map_err(RecordingError::write)?;
        Self::into_writer(out, path, syncer, settings)
    }

    /// Starts a file, and the thread that writes it into `out`. If there is a `path`, of the recording's
    /// first file, creates further ones beside it. Without a `syncer` nothing is synced.
    pub(super) fn into_writer(
        out: Box<dyn Write + Send>,
        path: Option<PathBuf>,
        syncer: Option<Syncer>,
        settings: QueueSettings,
    ) -> Result<Arc<Self>, RecordingError> {
        let QueueSettings { limits, frame_id, compression, before, .. } = settings;
        let (items, receiver) = mpsc::channel();
        let queue = Arc::new(Self {
            items,
            pending: Mutex::default(),
            held: Mutex::new(before.map(|span| Held::new(span, HELD_BYTES))),
            waiting: watch::Sender::new(Some(0)),
            progress: Arc::new(Mutex::new(Progress { files: 1, ..Progress::default() })),
            failure: Mutex::new(None),
            syncer: syncer.clone(),
        });
        let parts = Parts::new(limits, path, Arc::clone(&queue.progress), syncer);
        let writer = Writer::new(out, parts, frame_id, compression);
        let writer = writer.map_err(RecordingError::write)?;
        let thread = {
            let queue = Arc::clone(&queue);
            move || {
                let written = AssertUnwindSafe(|| write_all(writer, &receiver, &queue));
                let panicked = |_| Err(io::Error::other("the writer panicked"));
                queue.fail(catch_unwind(written).unwrap_or_else(panicked));
                queue.waiting.send_replace(None);
            }
        };
        std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(thread)
            .map_err(RecordingError::write)?;
        Ok(queue)
    }

    /// Takes the next item. If too many bytes wait already, or the thread has ended, the item is lost and counted.
    pub(super) fn push(&self, item: WriteItem) {
        // Locked until the item is queued, so that no later one overtakes it.
        lock(&self.pending).take(item, Instant::now().into_std(), |item| self.hold(item));
    }

    fn hold(&self, item: WriteItem) {
        match lock(&self.held).as_mut() {
            Some(held) => held.push(item, Instant::now()),
            None => self.queue(item),
        }
    }

    /// Queues the held items and all later ones.
    pub(super) fn release(&self) {
        // Locked until the end, so that no later item overtakes one of them.
        let mut held = lock(&self.held);
        let items = held.take().into_iter().flat_map(Held::into_items);
        items.for_each(|item| self.queue(item));
    }

    fn queue(&self, item: WriteItem) {
        let weight = item.weight();
        let (is_scan, is_reply) =
            (matches!(item, WriteItem::Scan(_)), matches!(item, WriteItem::Reply { .. }));
        let fits = self.waiting.send_if_modified(|waiting| {
            let more =
                waiting.map(|waiting| waiting + weight).filter(|more| *more <= HIGH_WATER_BYTES);
            *waiting = more.or(*waiting);
            more.is_some()
        });
        let queued = fits && self.items.send(item).is_ok();
        let mut counts = lock(&self.progress);
        let Progress { scans, replies, lost, lost_replies, .. } = &mut *counts;
        *if queued { scans } else { lost } += u64::from(is_scan);
        *if queued { replies } else { lost_replies } += u64::from(is_reply);
    }

    /// Waits until at most [`LOW_WATER_BYTES`] bytes wait, or the thread has ended.
    pub(super) async fn ready(&self) {
        let few =
            |waiting: &Option<usize>| waiting.is_none_or(|waiting| waiting <= LOW_WATER_BYTES);
        // Fails only without a sender, and `self` owns it.
        let _ = self.waiting.subscribe().wait_for(few).await;
    }

    /// Ends the file after all queued items. The receiver resolves once the file is
    /// written, or with an error if the thread ends before.
    pub(super) fn finish(&self) -> oneshot::Receiver<()> {
        lock(&self.pending).end(|item| self.hold(item));
        let (done, finished) = oneshot::channel();
        // Fails if the thread has ended, and the file with it.
        let _ = self.items.send(WriteItem::Finish(done));
        finished
    }

    /// Waits until the thread has ended, and everything is on the disk.
    pub(super) async fn ended(&self) {
        // Fails only without a sender, and `self` owns it.
        let _ = self.waiting.subscribe().wait_for(Option::is_none).await;
    }

    pub(super) fn progress(&self) -> Progress {
        Progress {
            late_syncs: self.syncer.as_ref().map_or(0, Syncer::late),
            cannot_sync: self.syncer.as_ref().is_some_and(Syncer::is_unsupported),
            ..*lock(&self.progress)
        }
    }

    pub(super) fn failure(&self) -> Option<RecordingError> {
        lock(&self.failure).clone()
    }

    /// Stores and logs the error, if `outcome` is one.
    fn fail(&self, outcome: io::Result<()>) {
        if let Err(error) = outcome.map_err(RecordingError::write) {
            let cause = std::error::Error::source(&error);
            tracing::error!(cause = cause.map(tracing::field::display), "{error}");
            lock(&self.failure).get_or_insert(error);
        }
    }
}

fn write_all(
    mut writer: Writer,
    items: &mpsc::Receiver<WriteItem>,
    queue: &Queue,
) -> io::Result<()> {
    loop {
        let item = items.recv_timeout(writer.until_flush().unwrap_or(Duration::MAX));
        let weight = item.as_ref().map_or(0, WriteItem::weight);
        match item {
            Ok(WriteItem::Scan(scan)) => writer.scan(&scan)?,
            Ok(WriteItem::Reply { request, bytes, times }) => {
                writer.reply(&request, &bytes, times)?
            }
            Ok(WriteItem::Event { json, times }) => writer.event(&json, times)?,
            Ok(WriteItem::Metadata(metadata)) => writer.metadata(&metadata)?,
            Ok(WriteItem::Finish(done)) => {
                // First, because the waiting recorder looks for the error at once.
                queue.fail(writer.finish());
                // Unlocks the file.
                drop(writer);
                // Fails if the recorder's future was dropped.
                let _ = done.send(());
                return queue.syncer.as_ref().map_or(Ok(()), Syncer::finish);
            }
            // Only by the time: `queue` has a sender.
            Err(_) => writer.flush()?,
        }
        queue.waiting.send_modify(|waiting| *waiting = waiting.map(|waiting| waiting - weight));
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt as _;

    use super::*;

    #[tokio::test]
    async fn a_file_is_written_while_its_sync_hangs() {
        let (go, wait) = mpsc::channel::<()>();
        let syncer = Syncer::start(Duration::ZERO).unwrap();
        syncer.begin(Box::new(move || {
            let _ = wait.recv();
            Ok(())
        }));
        let file = Box::new(io::sink());
        let queue = Queue::into_writer(file, None, Some(syncer), Default::default()).unwrap();
        queue.finish().await.unwrap();
        assert!(queue.ended().now_or_never().is_none());
        drop(go);
        queue.ended().await;
        assert!(queue.failure().is_none());
    }
}
