//! Reads in Cyclone's trace of discovery which participants are back after an outage.
//!
//! Cyclone forgets a participant that is silent for its lease. But the participant, if its process
//! was only stopped, still remembers Cyclone. Cyclone's counter restarts, so the participant takes
//! new requests for old ones, and never answers. They find each other again only if Cyclone's
//! participant is reopened under a new name. Cyclone's own events do not name participants.
//!
//! A participant with a longer lease may forget Cyclone instead. Readers on RustDDS 0.13 and
//! dust_dds 0.16 then get no scans until Cyclone has a new name, too. Both number each of their
//! announcements, which the trace calls updates; Cyclone and Fast DDS repeat theirs.

use std::collections::HashMap;
use std::fs::OpenOptions;
use std::io::{self, BufRead, BufReader, PipeWriter};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use parking_lot::Mutex;

use super::log::text;

/// Silence after which others forget this process. Its lease, as in `network`, is a second
/// longer: checks may be late.
const OWN_LEASE: Duration = Duration::from_secs(23);

/// Silence that means an outage, if as long a time without one precedes or follows it. The lease of
/// this process is an announcement longer. RustDDS, each 10 s, may lose one announcement.
const OUTAGE: Duration = Duration::from_secs(22);

/// Maximum number of participants to remember. A domain has room for 120 per machine.
const MAX_PARTICIPANTS: usize = 10_000;

/// Reader of the trace, on a thread that ends when Cyclone has closed it and this is dropped.
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
    let mut heard = HashMap::new();
    for line in trace.split(b'\n').map_while(Result::ok) {
        if has_returned(&mut heard, text(&String::from_utf8_lossy(&line)), Instant::now()) {
            *returned.lock() = Some("a reader is back after a silence".to_owned());
        }
    }
}

/// First and latest announcement of a participant since its last silence, and whether that may
/// have been an outage; `None` once forgotten.
type Heard = Option<(Instant, Instant, bool)>;

/// Returns true if the line announces a participant that was forgotten or silent.
fn has_returned(heard: &mut HashMap<String, Heard>, line: &str, now: Instant) -> bool {
    if heard.len() >= MAX_PARTICIPANTS {
        heard.clear();
    }
    match line.split(' ').collect::<Vec<_>>()[..] {
        ["lease", "expired:", "l", _, "guid", guid, ..] => {
            heard.insert(guid.to_owned(), None);
            false
        }
        ["SPDP", "ST0", guid, "bes", _, "NEW", ..] => {
            heard.insert(guid.to_owned(), Some((now, now, false))) == Some(None)
        }
        ["SPDP", "ST0", guid, what, ..] if what.starts_with("(update)") => {
            let heard = heard.entry(guid.to_owned()).or_insert(None);
            let (first, latest, may_be_back) = heard.unwrap_or((now, now, false));
            let is_silent = now - latest > OUTAGE;
            let (may_be_back, is_steady) = (may_be_back || is_silent, latest - first > OUTAGE);
            *heard = Some((if is_silent { now } else { first }, now, may_be_back && !is_steady));
            may_be_back && is_steady
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_outages_of_steady_participants_count() {
        for (announced, expected) in [
            (&[0, 10, 20, 30, 60, 70][..], &[60][..]),
            (&[0, 10, 20, 40, 50, 80, 90, 120, 130], &[80]),
            (&[0, 1, 35, 45, 55, 65, 75, 85, 95], &[75]),
            (&[0, 1, 2, 3, 40, 80, 120, 160], &[]),
        ] {
            let (mut heard, start) = (HashMap::new(), Instant::now());
            let mut is_back =
                |line: &str, at| has_returned(&mut heard, line, start + Duration::from_secs(at));
            assert!(!is_back("SPDP ST0 110a:b:c:1c1 bes c3f NEW (data", 0));
            let update = "SPDP ST0 110a:b:c:1c1 (update)ddsi_update_qos_locked 110a:b:c:1c1";
            let back = announced.iter().copied().filter(|at| is_back(update, *at));
            assert_eq!(back.collect::<Vec<_>>(), expected);
            assert!(!is_back("lease expired: l 0x7f01 guid 110a:b:c:1c1 tend 1 < now 2", 200));
            assert!(is_back("SPDP ST0 110a:b:c:1c1 bes c3f NEW (data", 210));
        }
    }
}
