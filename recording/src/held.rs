//! [`Held`]: the newest items of a recording that waits for its trigger.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use tokio::time::Instant;

use super::item::WriteItem;
use super::reply::identity_command;

#[derive(Debug)]
pub(super) struct Held {
    span: Duration,
    max_bytes: usize,
    /// Latest metadata, and the latest replies, by their commands, that are no longer among the items
    /// and identify the sensor: a replay begins with them.
    identity: BTreeMap<&'static str, WriteItem>,
    items: VecDeque<(Instant, WriteItem)>,
    bytes: usize,
}

impl Held {
    pub(super) fn new(span: Duration, max_bytes: usize) -> Self {
        let (identity, items) = (BTreeMap::new(), VecDeque::new());
        Self { span, max_bytes, identity, items, bytes: 0 }
    }

    /// Adds an item, and drops those that are too old, or too many.
    pub(super) fn push(&mut self, item: WriteItem, now: Instant) {
        if matches!(item, WriteItem::Metadata(_)) {
            // First in the file.
            self.identity.insert("", item);
            return;
        }
        self.bytes += item.weight();
        self.items.push_back((now, item));
        while let Some((at, _)) = self.items.front()
            && (now - *at > self.span || self.bytes > self.max_bytes)
            && let Some((_, item)) = self.items.pop_front()
        {
            self.bytes -= item.weight();
            if let WriteItem::Reply { request, .. } = &item
                && let Some(command) = identity_command(request)
            {
                self.identity.insert(command, item);
            }
        }
    }

    /// Returns the items in the order of the file, whose time begins with the first one.
    pub(super) fn into_items(mut self) -> impl Iterator<Item = WriteItem> {
        for item in self.identity.values_mut() {
            if let (WriteItem::Reply { times, .. }, Some((at, _))) = (item, self.items.front()) {
                times.steady = at.into_std();
            }
        }
        self.identity.into_values().chain(self.items.into_iter().map(|(_, item)| item))
    }
}
