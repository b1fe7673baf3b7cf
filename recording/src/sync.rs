//! [`Syncer`]: makes the system write a recording to its disk, from a separate thread. So a
//! slow disk delays neither the writing thread nor a stream.

use std::io;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::lock;

/// Waits until all written bytes of a file are on the disk.
pub(super) type Sync = Box<dyn FnMut() -> io::Result<()> + Send>;

/// Handle of the thread, which ends with the last clone.
#[derive(Debug, Clone)]
pub(super) struct Syncer {
    steps: mpsc::Sender<SyncStep>,
    state: Arc<Mutex<SyncState>>,
}

#[derive(Debug, Default)]
struct SyncState {
    /// Number of finished syncs that took longer than the interval.
    late: u64,
    /// When the current sync is late, if one is running.
    late_at: Option<Instant>,
    /// Set once the file system has refused to sync.
    is_unsupported: bool,
    failure: Option<io::Error>,
}

/// Syncs a file, unless its file system cannot, and counts it if it takes longer than the interval.
/// Returns when it began.
fn sync(file: &mut Option<Sync>, interval: Duration, state: &Mutex<SyncState>) -> Instant {
    let began = Instant::now();
    let Some(file) = file.as_mut().filter(|_| !lock(state).is_unsupported) else { return began };
    lock(state).late_at = began.checked_add(interval);
    let synced = file();
    let mut state = lock(state);
    state.late_at = None;
    state.late += u64::from(began.elapsed() > interval);
    match synced {
        Ok(()) => {}
        Err(error) if is_unsupported(&error) => {
            tracing::warn!(%error, "the file system cannot sync: a power failure may cost more");
            state.is_unsupported = true;
        }
        Err(error) => drop(state.failure.get_or_insert(error)),
    }
    began
}

/// EINVAL, ENOSYS and EOPNOTSUPP, as some file systems in user space answer.
fn is_unsupported(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported)
}

enum SyncStep {
    /// New file. The previous one gets no more bytes.
    Begin(Sync),
    Written,
    /// Syncs the rest, and confirms it.
    Finish(mpsc::Sender<()>),
}

impl Syncer {
    /// Starts the thread. It syncs the written bytes, at most once per `interval`.
    pub(super) fn start(interval: Duration) -> io::Result<Self> {
        let (steps, receiver) = mpsc::channel();
        let state = Arc::<Mutex<SyncState>>::default();
        let thread = {
            let state = Arc::clone(&state);
            move || run(&receiver, interval, &state)
        };
        std::thread::Builder::new().name("recorder-sync".to_owned()).spawn(thread)?;
        Ok(Self { steps, state })
    }

    /// Syncs another file at once, and from now on.
    pub(super) fn begin(&self, file: Sync) {
        self.send(SyncStep::Begin(file));
    }

    /// Requests a sync of the bytes written so far. Fails if an earlier sync has failed: the
    /// system may have dropped those bytes, and reports that only once.
    pub(super) fn written(&self) -> io::Result<()> {
        self.send(SyncStep::Written);
        self.failure()
    }

    pub(super) fn finish(&self) -> io::Result<()> {
        let (done, finished) = mpsc::channel();
        self.send(SyncStep::Finish(done));
        // Fails once the thread has ended, which it does after this step.
        let _ = finished.recv();
        self.failure()
    }

    /// Number of syncs that took longer than the interval, including the running one.
    pub(super) fn late(&self) -> u64 {
        let state = lock(&self.state);
        state.late + u64::from(state.late_at.is_some_and(|late_at| Instant::now() > late_at))
    }

    pub(super) fn is_unsupported(&self) -> bool {
        lock(&self.state).is_unsupported
    }

    fn send(&self, step: SyncStep) {
        // Fails if the thread has ended; `failure` tells why.
        let _ = self.steps.send(step);
    }

    fn failure(&self) -> io::Result<()> {
        let Some(error) = &lock(&self.state).failure else { return Ok(()) };
        let text = format!("cannot sync the recording to the disk: {error}");
        Err(io::Error::new(error.kind(), text))
    }
}

fn run(steps: &mpsc::Receiver<SyncStep>, interval: Duration, state: &Mutex<SyncState>) {
    let mut file: Option<Sync> = None;
    // When to sync next, once there is something to sync.
    let mut due: Option<Instant> = None;
    let mut next = Some(Instant::now());
    // An interval may be longer than the clock runs.
    let sync = |file: &mut Option<Sync>| sync(file, interval, state).checked_add(interval);
    // `finish` waits until this is dropped, after the last sync.
    let _done = loop {
        let rest = |due: Instant| due.saturating_duration_since(Instant::now());
        match steps.recv_timeout(due.map_or(Duration::MAX, rest)) {
            Ok(SyncStep::Written) => due = due.or(next),
            Err(RecvTimeoutError::Timeout) => {
                next = sync(&mut file);
                due = None;
            }
            Ok(SyncStep::Begin(begun)) => {
                // Last sync of the previous file.
                sync(&mut file);
                file = Some(begun);
                next = sync(&mut file);
            }
            Ok(SyncStep::Finish(done)) => break Some(done),
            Err(RecvTimeoutError::Disconnected) => break None,
        }
    };
    sync(&mut file);
}

#[cfg(test)]
mod tests {
    use super::*;

    type Answers = mpsc::Sender<io::Result<()>>;

    /// Makes a disk that logs its calls, and returns what is sent to it.
    fn disk(name: &'static str, log: &mpsc::Sender<&'static str>) -> (Sync, Answers) {
        let (log, (answer, answers)) = (log.clone(), mpsc::channel());
        let sync = move || {
            log.send(name).unwrap();
            answers.recv().unwrap_or(Ok(()))
        };
        (Box::new(sync), answer)
    }

    /// Starts to sync a disk. Returns its log and the sender of its answers.
    fn started(interval: Duration) -> (Syncer, mpsc::Receiver<&'static str>, Answers) {
        let (log, logged) = mpsc::channel();
        let syncer = Syncer::start(interval).unwrap();
        let (file, answer) = disk("one", &log);
        syncer.begin(file);
        (syncer, logged, answer)
    }

    #[test]
    fn a_file_is_synced_at_both_ends() {
        let (log, logged) = mpsc::channel();
        let syncer = Syncer::start(Duration::MAX).unwrap();
        for name in ["one", "two"] {
            syncer.begin(disk(name, &log).0);
            syncer.written().unwrap();
        }
        syncer.finish().unwrap();
        drop((log, syncer));
        assert_eq!(logged.iter().collect::<Vec<_>>(), ["one", "one", "two", "two"]);
    }

    /// In real time, like a disk: written bytes are synced without a further call.
    #[test]
    fn written_bytes_are_synced_once_an_interval() {
        let (syncer, logged, answer) = started(Duration::from_millis(20));
        drop(answer);
        logged.recv().unwrap();
        for _ in 0..3 {
            syncer.written().unwrap();
            logged.recv_timeout(Duration::from_secs(60)).unwrap();
        }
        assert!(logged.try_recv().is_err());
    }

    #[test]
    fn a_slow_disk_is_counted_and_nobody_waits_for_it() {
        let (syncer, logged, answer) = started(Duration::ZERO);
        syncer.written().unwrap();
        // Each of these calls returns, and the hanging sync is counted meanwhile.
        for late in 1..3 {
            logged.recv().unwrap();
            for _ in 0..1000 {
                syncer.written().unwrap();
            }
            assert!(syncer.late() >= late);
            answer.send(Ok(())).unwrap();
        }
        drop(answer);
        syncer.finish().unwrap();
        assert!(syncer.late() > 2);
    }

    #[test]
    fn a_file_system_without_sync_fails_nothing() {
        let (syncer, _logged, answer) = started(Duration::ZERO);
        // ENOSYS.
        answer.send(Err(io::ErrorKind::Unsupported.into())).unwrap();
        syncer.written().unwrap();
        // The disk is not asked again: it would not answer.
        syncer.finish().unwrap();
        assert!(syncer.is_unsupported());
    }

    #[test]
    fn a_failed_sync_fails_every_later_write() {
        let (syncer, logged, answer) = started(Duration::ZERO);
        answer.send(Ok(())).unwrap();
        syncer.written().unwrap();
        answer.send(Err(io::ErrorKind::StorageFull.into())).unwrap();
        drop(answer);
        for _ in 0..2 {
            logged.recv().unwrap();
        }
        for outcome in [syncer.finish(), syncer.written()] {
            let error = outcome.unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::StorageFull);
            assert!(error.to_string().contains("cannot sync the recording"), "{error}");
        }
    }
}
