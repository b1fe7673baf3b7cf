//! Lines for the viewers of a source. Each scan is serialized once for all viewers: with
//! many viewers, serializing it for each of them would take most of the program's time.

use bytes::Bytes;
use parking_lot::Mutex;

use crate::failure::Failure;

const EVENT_START: &str = "data: ";

/// Line in both formats of `/scans`. Clones share the bytes.
#[derive(Debug, Clone)]
pub(super) struct ViewerLine {
    /// Server-sent event, which contains the NDJSON line.
    event: Bytes,
    pub(super) is_scan: bool,
}

impl ViewerLine {
    /// Creates a line from NDJSON, which ends in LF.
    pub(super) fn new(ndjson: &str, is_scan: bool) -> Self {
        Self { event: [EVENT_START, ndjson, "\n"].concat().into(), is_scan }
    }

    pub(super) fn ndjson(&self) -> Bytes {
        self.event.slice(EVENT_START.len()..self.event.len() - 1)
    }

    pub(super) fn event(&self) -> Bytes {
        self.event.clone()
    }
}

#[derive(Debug, Default)]
pub(super) struct NewestLine {
    line: Mutex<Option<(u64, ViewerLine)>>,
}

impl NewestLine {
    /// Returns the line of scan `number`. Calls `ndjson` only if the line is not cached.
    pub(super) fn scan(
        &self,
        number: u64,
        ndjson: impl FnOnce() -> Result<String, Failure>,
    ) -> Option<ViewerLine> {
        let mut newest = self.line.lock();
        if newest.as_ref().is_none_or(|(newest, _)| *newest != number) {
            *newest = Some((number, ViewerLine::new(&ndjson().ok()?, true)));
        }
        newest.as_ref().map(|(_, line)| line.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_is_written_once_for_all_viewers() {
        let (newest, mut written) = (NewestLine::default(), 0);
        for number in [1, 1, 1, 2, 2, 1] {
            let ndjson = || {
                written += 1;
                Ok(format!("{number}\n"))
            };
            assert_eq!(newest.scan(number, ndjson).unwrap().ndjson(), format!("{number}\n"));
        }
        assert_eq!(written, 3, "1, 2, and 1 again");
    }
}
