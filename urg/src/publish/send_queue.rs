//! Messages waiting for room on the link. Keeps the newest `depth` messages of each topic, which
//! bounds the delay of scans on a slow link, and keeps topics from delaying each other.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Bounded queue with several topics, which take turns.
pub(super) struct SendQueue<M> {
    state: Mutex<State<M>>,
    changed: Condvar,
}

struct State<M> {
    topics: Vec<TopicQueue<M>>,
    /// Topics with pending messages, each once, in the order of their turns.
    turns: VecDeque<usize>,
    is_closed: bool,
}

struct TopicQueue<M> {
    depth: usize,
    waiting: VecDeque<M>,
}

impl<M> SendQueue<M> {
    /// Creates an empty queue with one topic per depth.
    pub(super) fn new(depths: impl IntoIterator<Item = usize>) -> Self {
        let topic = |depth: usize| TopicQueue { depth: depth.max(1), waiting: VecDeque::new() };
        let state = State {
            topics: depths.into_iter().map(topic).collect(),
            turns: VecDeque::new(),
            is_closed: false,
        };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Adds a message to the topic with this index. If the topic is full, drops its oldest
    /// message and returns it. A closed queue returns `message` itself. Does not wait.
    pub(super) fn push(&self, topic: usize, message: M) -> Option<M> {
        let mut guard = self.lock();
        let state = &mut *guard;
        let Some(TopicQueue { depth, waiting }) = state.topics.get_mut(topic) else {
            return Some(message);
        };
        if state.is_closed {
            return Some(message);
        }
        waiting.push_back(message);
        if waiting.len() > *depth {
            return waiting.pop_front();
        }
        if waiting.len() == 1 {
            state.turns.push_back(topic);
            self.changed.notify_one();
        }
        None
    }

    /// Waits for a message, and removes it: the oldest message of the next topic, with the
    /// topic's index. `None` once the queue is closed and empty.
    pub(super) fn pop(&self) -> Option<(usize, M)> {
        let is_idle = |state: &mut State<M>| state.turns.is_empty() && !state.is_closed;
        let mut guard =
            self.changed.wait_while(self.lock(), is_idle).unwrap_or_else(PoisonError::into_inner);
        let state = &mut *guard;
        let turn = state.turns.pop_front()?;
        let waiting = &mut state.topics.get_mut(turn)?.waiting;
        let message = waiting.pop_front();
        if !waiting.is_empty() {
            state.turns.push_back(turn);
        }
        message.map(|message| (turn, message))
    }

    pub(super) fn is_empty(&self) -> bool {
        self.lock().turns.is_empty()
    }

    #[cfg_attr(
        not(any(test, feature = "zenoh")),
        expect(dead_code, reason = "only zenoh ends with messages that wait")
    )]
    pub(super) fn clear(&self) -> Vec<M> {
        let mut state = self.lock();
        state.turns.clear();
        state.topics.iter_mut().flat_map(|topic| topic.waiting.drain(..)).collect()
    }

    /// Rejects new messages. You can still `pop` pending ones.
    pub(super) fn close(&self) {
        self.lock().is_closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State<M>> {
        // No code panics while holding it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_topic_drops_its_oldest_message() {
        let queue = SendQueue::new([2, 1]);
        assert_eq!(queue.push(0, "a1"), None);
        assert_eq!(queue.push(0, "a2"), None);
        assert_eq!(queue.push(1, "b1"), None);
        assert_eq!(queue.push(0, "a3"), Some("a1"));
        assert_eq!(queue.push(1, "b2"), Some("b1"));
        queue.close();
        assert_eq!(queue.push(0, "late"), Some("late"));
        let left: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(left, [(0, "a2"), (1, "b2"), (0, "a3")], "topics take turns");
    }

    #[test]
    fn a_cleared_queue_is_empty_and_goes_on() {
        let queue = SendQueue::new([3]);
        for message in 0..3 {
            assert_eq!(queue.push(0, message), None);
        }
        assert_eq!(queue.clear(), [0, 1, 2]);
        assert_eq!(queue.push(0, 3), None);
        assert_eq!(queue.pop(), Some((0, 3)));
    }

    #[test]
    fn the_end_of_the_queue_wakes_the_thread_that_waits() {
        let queue = SendQueue::<()>::new([1]);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| queue.pop());
            queue.close();
            assert_eq!(waiting.join().unwrap(), None);
        });
    }
}
