//! Reads in Cyclone's trace of discovery which participants were forgotten and are back.
//!
//! Cyclone forgets a participant that is silent for its lease. But the participant, if its process
//! was only stopped, still remembers Cyclone. Cyclone's counter restarts, so the participant takes
//! new requests for old ones, and never answers. They find each other again only if Cyclone's
//! participant is reopened under a new name. Cyclone's own events do not name participants.

use std::collections::HashMap;
use std::fs::OpenOptions;
use std::io::{self, BufRead, BufReader, PipeWriter};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use parking_lot::Mutex;

use super::log::text;

/// Silence after which others forget this process. Its lease, as in `network`, is a second
/// longer: checks may be late.
const OWN_LEASE: Duration = Duration::from_secs(19);

/// Maximum number of participants to remember. A domain has room for 120 per machine.
const MAX_FORGOTTEN: usize = 10_000;

/// Reader of the trace, on a thread of its own. The thread ends when Cyclone has closed the trace,
/// and this is dropped.
pub(super) struct Trace {
    /// Why the participant is outdated.
    returned: Arc<Mutex<Option<String>>>,
    checked: SystemTime,
    /// Open until Cyclone has opened the pipe by its path.
    writer: PipeWriter,
}

impl Trace {
    pub(super) fn start() -> io::Result<Self> {
        let returned = Arc::<Mutex<_>>::default();
        let (reader, writer) = io::pipe()?;
        let found = Arc::clone(&returned);
        std::thread::Builder::new()
            .name("trace".to_owned())
            .spawn(move || read(BufReader::new(reader), &found))?;
        Ok(Self { returned, checked: SystemTime::now(), writer })
    }

    /// Path of the pipe for Cyclone, on systems that have one.
    pub(super) fn path(&self) -> Option<String> {
        #[cfg(unix)]
        let number = Some(std::os::fd::AsRawFd::as_raw_fd(&self.writer));
        #[cfg(not(unix))]
        let number: Option<u8> = None;
        let path = format!("/dev/fd/{}", number?);
        // Not every container has these paths.
        OpenOptions::new().write(true).open(&path).is_ok().then_some(path)
    }

    /// Checks whether a forgotten participant is back, or this process itself, after it was
    /// stopped or the machine slept. From then on, always returns a line for the user. Call it at
    /// regular intervals.
    pub(super) fn returned(&mut self) -> Option<String> {
        // Only the wall clock includes the time that the machine slept.
        let now = SystemTime::now();
        let before = std::mem::replace(&mut self.checked, now);
        let stopped = now.duration_since(before).unwrap_or_default();
        let mut returned = self.returned.lock();
        if stopped > OWN_LEASE {
            *returned = Some(format!("this program was stopped for {} s", stopped.as_secs()));
        }
        returned.clone()
    }
}

fn read(trace: impl BufRead, returned: &Mutex<Option<String>>) {
    let mut forgotten = HashMap::new();
    for line in trace.split(b'\n').map_while(Result::ok) {
        let line = String::from_utf8_lossy(&line);
        match text(&line).split(' ').collect::<Vec<_>>()[..] {
            ["lease", "expired:", "l", _, "guid", guid, ..] => {
                if forgotten.len() >= MAX_FORGOTTEN {
                    forgotten.clear();
                }
                forgotten.insert(guid.to_owned(), Instant::now());
            }
            ["SPDP", "ST0", guid, "bes", _, "NEW", ..] => {
                if let Some(at) = forgotten.remove(guid) {
                    let since = at.elapsed().as_secs();
                    let why = format!("a reader is back that was forgotten {since} s ago");
                    *returned.lock() = Some(why);
                }
            }
            _ => {}
        }
    }
}
