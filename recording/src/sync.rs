//! [`Syncer`]: makes the system write a recording to its disk, from a separate thread. So a
//! slow disk delays neither the writing thread nor a stream.

use std::io;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::lock;

/// File, as the thread that syncs it sees it.
pub(super) trait Durable: Send {
    /// Waits until all written bytes are on the disk.
    fn sync(&self) -> io::Result<()>;

    /// Waits until the file's name is on the disk.
    fn sync_folder(&self) -> io::Result<()>;
}

/// Handle of the thread, which ends with the last clone.
#[derive(Debug, Clone)]
pub(super) struct Syncer {
    steps: mpsc::Sender<SyncStep>,
    state: Arc<Mutex<SyncState>>,
}

/// Results of the syncs.
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

/// Syncs, and counts it if it takes longer than the interval.
fn timed(
    sync: impl FnOnce() -> io::Result<()>,
    interval: Duration,
    state: &Mutex<SyncState>,
) -> io::Result<()> {
    let began = Instant::now();
    lock(state).late_at = began.checked_add(interval);
    let synced = sync();
    let mut state = lock(state);
    state.late_at = None;
    state.late += u64::from(began.elapsed() > interval);
    synced
}

/// Syncs a file, unless its file system cannot. Returns when it began.
fn sync(file: Option<&dyn Durable>, interval: Duration, state: &Mutex<SyncState>) -> Instant {
    let began = Instant::now();
    let Some(file) = file.filter(|_| !lock(state).is_unsupported) else { return began };
    let synced = timed(|| file.sync(), interval, state);
    let mut state = lock(state);
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
    Begin(Box<dyn Durable>),
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

    /// Syncs another file from now on, and its folder at once.
    pub(super) fn begin(&self, file: Box<dyn Durable>) {
        self.send(SyncStep::Begin(file));
    }

    /// Requests a sync of the bytes written so far. Fails if an earlier sync has failed: the
    /// system may have dropped those bytes, and reports that only once.
    pub(super) fn written(&self) -> io::Result<()> {
        self.send(SyncStep::Written);
        self.failure()
    }

    /// Waits until everything is on the disk.
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

    /// Returns true if the file system cannot sync.
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
    let mut file: Option<Box<dyn Durable>> = None;
    // When to sync next, once there is something to sync.
    let mut due: Option<Instant> = None;
    let mut next = Some(Instant::now());
    let sync = |file: &Option<Box<dyn Durable>>| {
        // An interval may be longer than the clock runs.
        sync(file.as_deref(), interval, state).checked_add(interval)
    };
    loop {
        let step = match due {
            None => steps.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(due) => steps.recv_timeout(due.saturating_duration_since(Instant::now())),
        };
        match step {
            Ok(SyncStep::Written) => due = due.or(next),
            Err(RecvTimeoutError::Timeout) => {
                next = sync(&file);
                due = None;
            }
            Ok(SyncStep::Begin(begun)) => {
                // Last sync of the previous file.
                next = sync(&file);
                if let Err(error) = timed(|| begun.sync_folder(), interval, state) {
                    // Some file systems cannot sync a folder. If anything else is wrong, the
                    // next sync shows it.
                    tracing::debug!(%error, "the folder of the recording cannot be synced");
                }
                file = Some(begun);
            }
            Ok(SyncStep::Finish(done)) => {
                sync(&file);
                return drop(done);
            }
            Err(RecvTimeoutError::Disconnected) => {
                sync(&file);
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Disk that logs its calls, and returns `answers`.
    struct Disk {
        name: &'static str,
        log: mpsc::Sender<String>,
        answers: mpsc::Receiver<io::Result<()>>,
    }

    impl Durable for Disk {
        fn sync(&self) -> io::Result<()> {
            self.log.send(format!("sync {}", self.name)).unwrap();
            self.answers.recv().unwrap_or(Ok(()))
        }

        fn sync_folder(&self) -> io::Result<()> {
            self.log.send(format!("folder of {}", self.name)).unwrap();
            self.answers.recv().unwrap_or(Ok(()))
        }
    }

    type Answers = mpsc::Sender<io::Result<()>>;

    fn disk(name: &'static str, log: &mpsc::Sender<String>) -> (Box<dyn Durable>, Answers) {
        let (answer, answers) = mpsc::channel();
        (Box::new(Disk { name, log: log.clone(), answers }), answer)
    }

    /// Starts to sync a disk. Returns its log and the sender of its answers.
    fn started(interval: Duration) -> (Syncer, mpsc::Receiver<String>, Answers) {
        let (log, logged) = mpsc::channel();
        let syncer = Syncer::start(interval).unwrap();
        let (file, answer) = disk("one", &log);
        syncer.begin(file);
        (syncer, logged, answer)
    }

    #[test]
    fn a_file_is_synced_after_its_folder() {
        let (log, logged) = mpsc::channel();
        let syncer = Syncer::start(Duration::MAX).unwrap();
        for name in ["one", "two"] {
            syncer.begin(disk(name, &log).0);
            syncer.written().unwrap();
        }
        syncer.finish().unwrap();
        drop((log, syncer));
        let logged: Vec<String> = logged.iter().collect();
        let last = logged.len() - 1;
        assert_eq!(logged[0], "folder of one");
        assert_eq!(&logged[logged.len() - 3..last], ["sync one", "folder of two"]);
        assert_eq!(logged[last], "sync two");
    }

    /// In real time, like a disk: written bytes are synced without a further call.
    #[test]
    fn written_bytes_are_synced_once_an_interval() {
        let (syncer, logged, answer) = started(Duration::from_millis(20));
        drop(answer);
        assert_eq!(logged.recv().unwrap(), "folder of one");
        for _ in 0..3 {
            syncer.written().unwrap();
            assert_eq!(logged.recv_timeout(Duration::from_secs(60)).unwrap(), "sync one");
        }
        assert!(logged.try_recv().is_err());
    }

    #[test]
    fn a_slow_disk_is_counted_and_nobody_waits_for_it() {
        let (syncer, logged, answer) = started(Duration::ZERO);
        syncer.written().unwrap();
        // The folder hangs and then the file, but each of these calls returns, and the hanging sync
        // is counted meanwhile.
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
        answer.send(Ok(())).unwrap();
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
        answer.send(Err(io::ErrorKind::StorageFull.into())).unwrap();
        drop(answer);
        syncer.written().unwrap();
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
