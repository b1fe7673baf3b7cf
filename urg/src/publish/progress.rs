//! Detects a stuck queue from outside, by looks at regular intervals. Counting looks instead of
//! time avoids false alarms after the process was stopped or the machine slept.

/// Looks without progress before an engine counts as stuck: 10 s.
pub(super) const MAX_SILENT_LOOKS: u32 = 20;

/// Looks since the last progress of a queue.
#[derive(Debug, Default)]
pub(super) struct Progress {
    taken: u64,
    looks: u32,
}

impl Progress {
    /// Checks whether messages have been waiting too long. `taken` is the number of messages
    /// taken from the queue so far.
    pub(super) fn is_stuck(&mut self, taken: u64, is_waiting: bool) -> bool {
        self.looks = if is_waiting && taken == self.taken { self.looks + 1 } else { 0 };
        self.taken = taken;
        self.looks > MAX_SILENT_LOOKS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_queue_is_stuck_when_messages_wait_and_none_is_taken() {
        let mut progress = Progress::default();
        for taken in 1..100 {
            assert!(!progress.is_stuck(taken, true), "it moves");
        }
        for _ in 0..100 {
            assert!(!progress.is_stuck(99, false), "nothing waits");
        }
        for _ in 0..MAX_SILENT_LOOKS {
            assert!(!progress.is_stuck(99, true));
        }
        assert!(progress.is_stuck(99, true));
        assert!(!progress.is_stuck(100, true), "it moves again");
    }
}
