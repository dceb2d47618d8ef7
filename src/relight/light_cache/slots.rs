//! Which image lies in which slot, and which one goes when a new one comes.

use std::collections::BTreeSet;

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    node: Option<usize>,
    last_used: u64,
    /// Uses under way; a pinned slot stays.
    pins: u32,
}

/// A fixed number of slots. Each step takes a time that grows with the logarithm of their number.
pub struct Slots {
    slots: Vec<Slot>,
    /// Those without pins: empty ones first, then those that were not used for the longest time.
    free: BTreeSet<(bool, u64, usize)>,
}

impl Slots {
    pub fn new(count: usize) -> Self {
        let mut slots = Self { slots: Vec::new(), free: BTreeSet::new() };
        slots.grow(count);
        slots
    }

    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Adds empty slots up to `count`.
    pub fn grow(&mut self, count: usize) {
        for slot in self.slots.len()..count {
            self.slots.push(Slot::default());
            self.free.insert(self.key(slot));
        }
    }

    pub fn pin(&mut self, slot: usize) {
        self.change(slot, |s| s.pins += 1);
    }

    pub fn unpin(&mut self, slot: usize) {
        self.change(slot, |s| s.pins -= 1);
    }

    pub fn use_at(&mut self, slot: usize, clock: u64) {
        self.change(slot, |s| s.last_used = clock);
    }

    pub fn last_used(&self, slot: usize) -> u64 {
        self.slots[slot].last_used
    }

    /// Puts `node` into a given slot.
    pub fn set(&mut self, slot: usize, node: usize, clock: u64) {
        self.change(slot, |s| *s = Slot { node: Some(node), last_used: clock, pins: 0 });
    }

    pub fn clear(&mut self, slot: usize) {
        self.change(slot, |s| *s = Slot::default());
    }

    /// Gives `node` the slot that was not used for the longest time; returns it and who had it.
    pub fn take(&mut self, node: usize, clock: u64) -> (usize, Option<usize>) {
        let &(.., slot) = self.free.first().expect("slot_range leaves room");
        let evicted = self.slots[slot].node;
        self.set(slot, node, clock);
        (slot, evicted)
    }

    fn key(&self, slot: usize) -> (bool, u64, usize) {
        let Slot { node, last_used, .. } = self.slots[slot];
        (node.is_some(), last_used, slot)
    }

    fn change(&mut self, slot: usize, change: impl FnOnce(&mut Slot)) {
        self.free.remove(&self.key(slot));
        change(&mut self.slots[slot]);
        if self.slots[slot].pins == 0 {
            self.free.insert(self.key(slot));
        }
    }
}
