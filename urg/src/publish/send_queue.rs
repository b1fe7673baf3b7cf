//! Messages waiting for room on the link. Keeps the newest `depth` messages of each topic, which
//! bounds the delay of scans on a slow link, and keeps topics from delaying each other.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::SystemTime;

use parking_lot::{Condvar, Mutex};

use super::counts::Counts;
use super::engine::Publisher;

/// Checks without progress before an engine counts as stuck: 10 s. Counting checks instead of
/// time avoids false alarms after the process was stopped or the machine slept.
pub(super) const MAX_SILENT_CHECKS: u32 = 20;

#[derive(Debug)]
pub(super) struct Message {
    pub(super) topic: usize,
    pub(super) payload: Vec<u8>,
    /// Number on its topic, from 1. Dropped messages use up a number, so that readers see the
    /// gap.
    pub(super) sequence: i64,
    pub(super) published_at: SystemTime,
    pub(super) counts: Arc<Counts>,
}

/// Bounded queue with several topics, which take turns. Counts the messages that it drops.
pub(super) struct SendQueue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Default)]
struct QueueState {
    topics: Vec<TopicQueue>,
    /// Topics with pending messages, each once, in the order of their turns.
    turns: VecDeque<usize>,
    /// Whether no message can be sent.
    is_cut: bool,
    is_closed: bool,
    /// Checks since a message was taken.
    silent_checks: u32,
}

struct TopicQueue {
    depth: usize,
    waiting: VecDeque<Message>,
    sequence: i64,
    counts: Arc<Counts>,
}

impl SendQueue {
    /// Creates an empty queue for topics with these depths and counters.
    pub(super) fn new(topics: impl IntoIterator<Item = (usize, Arc<Counts>)>) -> Self {
        let topic = |(depth, counts): (usize, _)| TopicQueue {
            depth: depth.max(1),
            waiting: VecDeque::new(),
            sequence: 0,
            counts,
        };
        let topics = topics.into_iter().map(topic).collect();
        let state = Mutex::new(QueueState { topics, ..QueueState::default() });
        Self { state, changed: Condvar::new() }
    }

    /// Waits for a message, and removes it: the oldest message of the next topic. `None` once
    /// the queue is closed and empty.
    pub(super) fn pop(&self) -> Option<Message> {
        let is_idle = |state: &mut QueueState| state.turns.is_empty() && !state.is_closed;
        let mut guard = self.state.lock();
        self.changed.wait_while(&mut guard, is_idle);
        let state = &mut *guard;
        let turn = state.turns.pop_front()?;
        let waiting = &mut state.topics.get_mut(turn)?.waiting;
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

    /// Sets whether messages can be sent. Without a connection, drops all messages: old scans
    /// are useless.
    pub(super) fn set_connected(&self, is_connected: bool) {
        let mut state = self.state.lock();
        state.is_cut = !is_connected;
        if state.is_cut {
            state.turns.clear();
            let waiting = state.topics.iter_mut().flat_map(|topic| topic.waiting.drain(..));
            waiting.for_each(|message| message.counts.lock().dropped += 1);
        }
    }

    /// Rejects new messages. You can still `pop` pending ones.
    pub(super) fn close(&self) {
        self.state.lock().is_closed = true;
        self.changed.notify_all();
    }
}

impl Publisher for SendQueue {
    /// Queues the message. If the topic is full, drops its oldest message.
    fn publish(&self, topic: usize, payload: Vec<u8>) {
        let mut guard = self.state.lock();
        let state = &mut *guard;
        let Some(TopicQueue { depth, waiting, sequence, counts }) = state.topics.get_mut(topic)
        else {
            return;
        };
        *sequence += 1;
        if state.is_closed || state.is_cut {
            return counts.lock().dropped += 1;
        }
        waiting.push_back(Message {
            topic,
            payload,
            sequence: *sequence,
            published_at: SystemTime::now(),
            counts: Arc::clone(counts),
        });
        if waiting.len() > *depth {
            waiting.pop_front();
            counts.lock().dropped += 1;
        } else if waiting.len() == 1 {
            state.turns.push_back(topic);
            self.changed.notify_one();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn queue<const N: usize>(depths: [usize; N]) -> (SendQueue, [Arc<Counts>; N]) {
        let topics = depths.map(|depth| (depth, Arc::<Counts>::default()));
        (SendQueue::new(topics.clone()), topics.map(|(_, counts)| counts))
    }

    fn text(message: Message) -> (usize, i64, String) {
        (message.topic, message.sequence, String::from_utf8(message.payload).unwrap())
    }

    #[test]
    fn a_full_topic_drops_its_oldest_message_and_topics_take_turns() {
        let (queue, counts) = queue([2, 1]);
        for (topic, message) in [(0, "a1"), (0, "a2"), (1, "b1"), (0, "a3"), (1, "b2")] {
            queue.publish(topic, message.into());
        }
        queue.close();
        queue.publish(0, "late".into());
        let left: Vec<_> = std::iter::from_fn(|| queue.pop()).map(text).collect();
        let expected = [(0, 2, "a2"), (1, 2, "b2"), (0, 3, "a3")];
        assert_eq!(left, expected.map(|(topic, number, text)| (topic, number, text.to_owned())));
        assert_eq!(counts.map(|counts| counts.lock().dropped), [2, 1]);
    }

    #[test]
    fn messages_are_dropped_but_numbered_without_a_connection() {
        let (queue, [counts]) = queue([3]);
        queue.publish(0, "waits".into());
        queue.set_connected(false);
        queue.publish(0, "away".into());
        queue.set_connected(true);
        queue.publish(0, "back".into());
        assert_eq!(queue.pop().map(text), Some((0, 3, "back".to_owned())));
        assert_eq!(counts.lock().dropped, 2);
    }

    #[test]
    fn a_queue_is_stuck_when_messages_wait_and_none_is_taken() {
        let (queue, _) = queue([100]);
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
