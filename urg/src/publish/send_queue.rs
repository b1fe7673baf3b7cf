//! Messages waiting for room on the link. Keeps the newest `depth` messages of each topic, which
//! bounds the delay of scans on a slow link, and keeps topics from delaying each other.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::SystemTime;

use parking_lot::{Condvar, Mutex};

use super::topic::{Counts, Topic};

/// Checks without progress before an engine counts as stuck: 10 s. Counting checks instead of
/// time avoids false alarms after the process was stopped or the machine slept.
pub(super) const MAX_SILENT_CHECKS: u32 = 20;

#[derive(Debug)]
pub(super) struct Message {
    pub(super) topic: usize,
    pub(super) payload: Vec<u8>,
    /// Number on its topic, from 1. Dropped messages use up a number, so that readers see the gap.
    pub(super) sequence: i64,
    pub(super) published_at: SystemTime,
    pub(super) counts: Arc<Counts>,
}

/// Bounded queue with several topics, which take turns. Counts the messages that it drops.
pub(super) struct SendQueue {
    pub(super) topics: Arc<[Topic]>,
    state: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Default)]
struct QueueState {
    /// One for each topic.
    queues: Vec<TopicQueue>,
    /// Topics with pending messages, each once, in the order of their turns.
    turns: VecDeque<usize>,
    /// Whether no message can be sent.
    is_cut: bool,
    is_closed: bool,
    /// Checks since a message was taken.
    silent_checks: u32,
}

#[derive(Default)]
struct TopicQueue {
    waiting: VecDeque<Message>,
    sequence: i64,
}

impl SendQueue {
    pub(super) fn new(topics: &Arc<[Topic]>) -> Self {
        let queues = topics.iter().map(|_| TopicQueue::default()).collect();
        let state = Mutex::new(QueueState { queues, ..QueueState::default() });
        Self { topics: Arc::clone(topics), state, changed: Condvar::new() }
    }

    /// Waits for a message, and removes it: the oldest message of the next topic. `None` once
    /// the queue is closed and empty.
    pub(super) fn pop(&self) -> Option<Message> {
        let is_idle = |state: &mut QueueState| state.turns.is_empty() && !state.is_closed;
        let mut guard = self.state.lock();
        self.changed.wait_while(&mut guard, is_idle);
        let state = &mut *guard;
        let turn = state.turns.pop_front()?;
        let waiting = &mut state.queues.get_mut(turn)?.waiting;
        let message = waiting.pop_front();
        if !waiting.is_empty() {
            state.turns.push_back(turn);
        }
        state.silent_checks = 0;
        message
    }

    /// Checks whether messages have been waiting too long. Call it at regular intervals.
    pub(super) fn is_stuck(&self) -> bool {
        let mut state = self.state.lock();
        state.silent_checks = if state.turns.is_empty() { 0 } else { state.silent_checks + 1 };
        state.silent_checks > MAX_SILENT_CHECKS
    }

    /// Sets whether messages can be sent. If not, drops all of them: old scans are useless.
    pub(super) fn set_connected(&self, is_connected: bool) {
        let mut state = self.state.lock();
        state.is_cut = !is_connected;
        if state.is_cut {
            state.turns.clear();
            let waiting = state.queues.iter_mut().flat_map(|queue| queue.waiting.drain(..));
            waiting.for_each(|message| message.counts.lock().dropped += 1);
        }
    }

    /// Rejects new messages. You can still `pop` pending ones.
    pub(super) fn close(&self) {
        self.state.lock().is_closed = true;
        self.changed.notify_all();
    }

    /// Queues the message. If the topic is full, drops its oldest message. Does not block.
    pub(super) fn publish(&self, index: usize, payload: Vec<u8>) {
        let mut guard = self.state.lock();
        let state = &mut *guard;
        let (Some(Topic { depth, counts, .. }), Some(TopicQueue { waiting, sequence })) =
            (self.topics.get(index), state.queues.get_mut(index))
        else {
            return;
        };
        *sequence += 1;
        if state.is_closed || state.is_cut {
            return counts.lock().dropped += 1;
        }
        waiting.push_back(Message {
            topic: index,
            payload,
            sequence: *sequence,
            published_at: SystemTime::now(),
            counts: Arc::clone(counts),
        });
        if waiting.len() > *depth {
            waiting.pop_front();
            counts.lock().dropped += 1;
        } else if waiting.len() == 1 {
            state.turns.push_back(index);
            self.changed.notify_one();
        }
    }
}

#[cfg(test)]
mod tests {
    use urg_recording::ros::MessageType;

    use super::*;

    #[test]
    fn a_queue_is_stuck_when_messages_wait_and_none_is_taken() {
        let topic = Topic::new(0, "/t", MessageType::LASER_SCAN, 100);
        let queue = SendQueue::new(&[topic].into());
        (0..=MAX_SILENT_CHECKS).for_each(|_| assert!(!queue.is_stuck(), "nothing waits"));
        queue.publish(0, Vec::new());
        for _ in 0..=MAX_SILENT_CHECKS {
            queue.publish(0, Vec::new());
            queue.pop();
            assert!(!queue.is_stuck(), "it moves");
        }
        (1..MAX_SILENT_CHECKS).for_each(|_| assert!(!queue.is_stuck()));
        assert!(queue.is_stuck());
        queue.pop();
        assert!(!queue.is_stuck(), "it moves again");
    }
}
