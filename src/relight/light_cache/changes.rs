//! What final gathering adds to images of lights, and images without it.

use glam::Vec3;

use super::{LightCache, Plan, Source, Step, Term};
use crate::scene::Rig;

impl LightCache {
    /// Sets what is added to the complete images of the lights, by number of the change: see [`Source::Change`].
    /// `change` gets the rig and the index of a light.
    pub fn set_changes(&mut self, change: impl Fn(&Rig, usize) -> Option<u64>) {
        for light in 0..self.leaf_of.len() {
            let (leaf, change) = (self.leaf_of[light], change(&self.rig, light));
            if self.nodes[leaf].change != change {
                self.nodes[leaf].change = change;
                self.release_changed(leaf);
                self.release_above(leaf);
                self.rest = None;
            }
        }
    }

    /// Plans a leaf's image, with its change, unless it is valid; returns its slot. `most`: see [`Self::add_points`].
    pub(super) fn ensure_leaf(&mut self, leaf: usize, light: usize, most: u32, steps: &mut Vec<Step>) -> usize {
        if let Some(slot) = self.nodes[leaf].changed {
            self.slots.use_at(slot, self.clock);
            return slot;
        }
        let slot = self.add_points(leaf, light, most, steps);
        let node = &self.nodes[leaf];
        let Some(change) = node.change.filter(|_| node.is_complete() && !node.coarse) else { return slot };
        self.slots.pin(slot);
        let target = self.take_free_slot(leaf);
        self.slots.unpin(slot);
        self.nodes[leaf].changed = Some(target);
        let terms = [Source::Slot(slot), Source::Change(change)].map(|source| Term { source, scale: Vec3::ONE });
        steps.push(Step::Sum { target: Source::Slot(target), terms: terms.into(), kept: 0.0 });
        target
    }

    /// Discards `node`'s image with its change.
    pub(super) fn release_changed(&mut self, node: usize) {
        if let Some(slot) = self.nodes[node].changed.take() {
            self.slots.clear(slot);
        }
    }

    /// Plans the picture of one light alone at unit intensity, without changes.
    pub fn plan_unit(&mut self, light: usize) -> Plan {
        self.clock += 1;
        let mut plan = Plan::default();
        let slot = self.add_points(self.leaf_of[light], light, u32::MAX, &mut plan.steps);
        self.release_coarse_above(self.leaf_of[light]);
        plan.picture.push(Term { source: Source::Slot(slot), scale: Vec3::ONE });
        plan
    }

    /// Whether the exact image of one light is there.
    pub fn is_complete(&self, light: usize) -> bool {
        let node = &self.nodes[self.leaf_of[light]];
        node.is_complete() && !node.coarse
    }

    /// Gives the image of a light as many points as it has in another cache for the same rig, if that is known.
    pub fn take_points(&mut self, other: &Self, light: usize) {
        let leaf = self.leaf_of[light];
        if self.nodes[leaf].slot.is_none() {
            self.nodes[leaf].needed = other.nodes[other.leaf_of[light]].needed;
        }
    }
}
