//! Slots for images: which node's image each one stores, and least-recently-used eviction.

use std::collections::BTreeSet;

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    node: Option<usize>,
    last_used: u64,
    /// Number of pins; a pinned slot is not evicted.
    pins: u32,
}

/// A fixed number of slots. Each operation takes logarithmic time.
pub struct Slots {
    slots: Vec<Slot>,
    /// Unpinned slots: empty ones first, then by increasing `last_used`.
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

    /// Sets the time of last use.
    pub fn use_at(&mut self, slot: usize, clock: u64) {
        self.change(slot, |s| s.last_used = clock);
    }

    pub fn last_used(&self, slot: usize) -> u64 {
        self.slots[slot].last_used
    }

    /// Assigns a given slot to `node`.
    pub fn set(&mut self, slot: usize, node: usize, clock: u64) {
        self.change(slot, |s| *s = Slot { node: Some(node), last_used: clock, pins: 0 });
    }

    /// Makes a slot empty and removes its pins.
    pub fn clear(&mut self, slot: usize) {
        self.change(slot, |s| *s = Slot::default());
    }

    /// Assigns `node` an empty slot or the least recently used one; returns the slot and the evicted node.
    pub fn take(&mut self, node: usize, clock: u64) -> (usize, Option<usize>) {
        let &(.., slot) = self.free.first().expect("slot_range leaves room");
        let evicted = self.slots[slot].node;
        self.set(slot, node, clock);
        (slot, evicted)
    }

    /// Assigns `node` an empty slot, if there is any.
    pub fn take_empty(&mut self, node: usize, clock: u64) -> Option<usize> {
        let &(is_used, _, slot) = self.free.first()?;
        (!is_used).then(|| self.set(slot, node, clock))?;
        Some(slot)
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
