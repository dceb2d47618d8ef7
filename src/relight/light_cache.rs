//! Cache of light images: a balanced tree of partial sums [Yang 2007, Figure 3.3] and what each edit invalidates.
//!
//! A leaf is the image of one light at unit intensity. An inner node is the sum of its children, each times its scale
//! (colour, intensity, group master). The picture is the sum of the *focus*, the nodes being edited, and the *rest*,
//! one image with the sum of all others. While one light is edited, a frame reads two images, whatever the number of
//! lights. When the focus changes, the sums above the old focus and the rest are recomputed: O(log L) images. Images
//! are never subtracted.
//!
//! Images are stored in a fixed number of slots. If none is free, the least recently used image is evicted, and
//! recomputed when it is needed again. This module only plans: [`LightCache::plan`] lists the work, the relighter
//! executes it.

mod changes;
mod focus;
mod limit;
mod plan;
mod planning;
mod points;
mod slots;
mod tree;

use std::collections::HashMap;

use glam::Vec3;

pub use self::plan::{Detail, LightPoints, Plan, Shade, Source, Step, Term};
pub use self::points::POINTS_A_STEP;
use self::slots::Slots;
use crate::scene::{Light, Links, Rig};
use crate::shared::MAX_TERMS;

/// Maximum nodes in the focus. If more are edited, the focus is empty and the picture is the rest alone.
const MAX_FOCUS: usize = MAX_TERMS as usize - 1;
/// Maximum images that one pass sums.
const BATCH: usize = MAX_TERMS as usize;
/// Plans which images to compute after each edit of the lights.
pub struct LightCache {
    rig: Rig,
    nodes: Vec<Node>,
    root: Option<usize>,
    /// Node of each light.
    leaf_of: Vec<usize>,
    /// Node of each group; `None` for groups without lights.
    node_of_group: Vec<Option<usize>>,
    slots: Slots,
    focus: Vec<usize>,
    /// Terms of the rest; `None` if it must be recomputed.
    rest: Option<Vec<Term>>,
    /// Whether any image in the rest is coarse.
    rest_is_coarse: bool,
    /// Number of lights that the last planned picture lacks.
    lacking: usize,
    /// Whether a picture lacked no light since all images were invalid.
    was_whole: bool,
    /// See [`LightCache::points_in_rest`].
    points_in_rest: usize,
    /// Whether any image in the last planned picture is coarse.
    picture_is_coarse: bool,
    /// Nodes edited since the last plan.
    edited: Vec<usize>,
    /// Requested focus of the next plan, whatever is edited; ascending.
    selected: Option<Vec<usize>>,
    /// Edited nodes of the last plan that had any.
    edited_before: Vec<usize>,
    /// Index of the image of each emitter that is seen, by its material.
    emitters: HashMap<String, usize>,
    /// Leaf whose image at its last checkpoint is in [`Source::Checkpoint`]. The others wait at their first one.
    compared: Option<usize>,
    /// Accuracy of images computed from now on.
    detail: Detail,
    clock: u64,
}

#[derive(Clone, Debug, Default)]
struct Node {
    parent: Option<usize>,
    children: Option<[usize; 2]>,
    light: Option<usize>,
    group: Option<usize>,
    /// Slot of its image; `None` if there is no valid image.
    slot: Option<usize>,
    /// Whether the image is coarse, lacks points of its light, or is a sum with such a part or without one.
    coarse: bool,
    /// Of a sum: number of lights that it lacks.
    lacking: usize,
    /// Of a leaf whose image has interleaved points: slot of the image that will replace it; `None` if it is not begun.
    growing: Option<usize>,
    /// Of a leaf: whether its image has interleaved points.
    is_interleaved: bool,
    /// Of a leaf: points of the light that its image has, or the one that grows.
    points: u32,
    /// Of a leaf: points that its image needs; `None` if that is not known yet.
    needed: Option<u32>,
    /// Of a leaf: points that its image of the whole picture needed, as far as known.
    needed_by_whole: Option<u32>,
    /// Of a leaf: what is added to its complete image; see [`LightCache::set_changes`].
    change: Option<u64>,
    /// Of a leaf: slot of its image with the change.
    changed: Option<usize>,
}

impl Node {
    /// Of a leaf: whether it has an image with all points that it needs.
    fn is_complete(&self) -> bool {
        self.slot.is_some() && !self.is_interleaved && self.needed == Some(self.points)
    }
}

impl LightCache {
    /// Minimum number of slots for a rig, and the number that stores every image: the tree has 2 L - 1 nodes.
    pub fn slot_range(light_count: usize) -> (usize, usize) {
        // Summing a tree pins one image per level, and groups at most double the depth. The focus and one batch of the
        // rest are pinned meanwhile.
        let depth = usize::BITS - light_count.leading_zeros();
        let most = 2 * light_count;
        (most.min(2 * depth as usize + MAX_FOCUS + BATCH + 4), most)
    }

    /// A cache without images. `slot_count` must be at least the minimum of [`Self::slot_range`]. `emitters`: see
    /// [`Self::invalidate`].
    pub fn new(rig: &Rig, slot_count: usize, emitters: HashMap<String, usize>) -> Self {
        let mut cache = Self {
            rig: rig.with_solo_applied().into_owned(),
            nodes: Vec::new(),
            root: None,
            leaf_of: Vec::new(),
            node_of_group: Vec::new(),
            slots: Slots::new(slot_count),
            focus: Vec::new(),
            rest: None,
            rest_is_coarse: false,
            lacking: 0,
            was_whole: false,
            points_in_rest: 0,
            picture_is_coarse: false,
            edited: Vec::new(),
            selected: None,
            edited_before: Vec::new(),
            emitters,
            compared: None,
            detail: Detail::Exact,
            clock: 0,
        };
        cache.build_tree();
        cache
    }

    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Replaces the lights. Images of unmoved lights stay valid. The number of slots never decreases.
    ///
    /// What changed is found by comparing both rigs: undo, snapshots and scripts give whole rigs, so a list of edits
    /// would be a second way, and stale images wherever it is incomplete. The comparison takes less time than the copy
    /// of the rig.
    pub fn set_rig(&mut self, rig: &Rig, slot_count: usize) {
        self.slots.grow(slot_count);
        let same_tree = self.rig.groups.len() == rig.groups.len()
            && self.rig.lights.len() == rig.lights.len()
            && self.rig.lights.iter().zip(&rig.lights).all(|(a, b)| a.group == b.group && a.name == b.name);
        let same_sets = self.rig.sets == rig.sets;
        let old = std::mem::replace(&mut self.rig, rig.with_solo_applied().into_owned());
        if !same_tree {
            self.rebuild_tree(&old);
            return;
        }
        for (i, old) in old.lights.iter().enumerate() {
            let new = &self.rig.lights[i];
            let (same_image, same_scale) = (same_image(old, new, same_sets), old.scale() == new.scale());
            if !same_image {
                self.release(self.leaf_of[i]);
            }
            if !same_image || !same_scale {
                self.mark_edited(self.leaf_of[i]);
            }
        }
        for (i, old) in old.groups.iter().enumerate() {
            if old.scale() != self.rig.groups[i].scale()
                && let Some(node) = self.node_of_group[i]
            {
                self.mark_edited(node);
            }
        }
    }

    /// Adds empty slots up to `slot_count`.
    pub fn grow(&mut self, slot_count: usize) {
        self.slots.grow(slot_count);
    }

    /// Sets the accuracy of images computed from now on. The focus does not change.
    pub fn set_detail(&mut self, detail: Detail) {
        self.detail = detail;
        if detail != Detail::Coarse {
            self.release_coarse();
        }
    }

    /// Invalidates coarse images and the sums above them, but not images that lack points of their light.
    fn release_coarse(&mut self) {
        for light in 0..self.leaf_of.len() {
            let leaf = self.leaf_of[light];
            if self.nodes[leaf].coarse && self.rig.lights[light].is_punctual() {
                self.release(leaf);
                self.release_above(leaf);
                self.rest = None;
            }
        }
    }

    /// Whether the last planned picture lacks lights, or an image in it is coarse or lacks points of its light.
    pub fn is_coarse(&self) -> bool {
        self.picture_is_coarse
    }

    /// Number of lights that the last planned picture lacks; see [`Self::plan`].
    pub fn lacking(&self) -> usize {
        self.lacking
    }

    /// Whether a picture lacked no light since all images were invalid.
    pub fn was_whole(&self) -> bool {
        self.was_whole
    }

    /// Points of lights outside of the focus that the last planned picture shades; see [`Self::plan`].
    pub fn points_in_rest(&self) -> usize {
        self.points_in_rest
    }

    /// Invalidates all images. `emitters`: index of the image of each emitter that is seen, by its material.
    pub fn invalidate(&mut self, emitters: HashMap<String, usize>) {
        self.emitters = emitters;
        for node in 0..self.nodes.len() {
            self.release(node);
        }
        (self.rest, self.was_whole) = (None, false);
    }

    /// Invalidates all images since from now on they show other layers of the picture. `whole`: whether they did and do
    /// show the whole of it. Images of parts have as many points as those of the whole had, so that they add up to it.
    pub fn change_layers(&mut self, emitters: HashMap<String, usize>, whole: [bool; 2]) {
        let [was_whole, is_whole] = whole;
        let of = |node: &Node| if was_whole { node.needed } else { node.needed_by_whole };
        let needed: Vec<_> = self.nodes.iter().map(of).collect();
        self.invalidate(emitters);
        for (node, needed) in self.nodes.iter_mut().zip(needed) {
            node.needed_by_whole = needed;
            node.needed = needed.filter(|_| !is_whole);
        }
    }

    /// Number of lights that a whole picture needs and that no image includes, and the first of them.
    pub fn pending(&self) -> (usize, Option<usize>) {
        let is_complete = |n: usize| {
            let Node { slot, light, changed, coarse, .. } = self.nodes[n];
            let is_whole = if light.is_some() { self.nodes[n].is_complete() } else { !coarse };
            changed.is_some() || (slot.is_some() && is_whole)
        };
        let held = |node: usize| {
            let mut above = std::iter::successors(Some(node), |&n| self.nodes[n].parent);
            // The product can be black though no factor is: a red light in a blue group.
            let mut scale = Vec3::ONE;
            above.any(|n| {
                scale *= self.scale(n);
                is_complete(n) || scale == Vec3::ZERO
            })
        };
        let mut pending = (0..self.leaf_of.len()).filter(|&light| !held(self.leaf_of[light]));
        let first = pending.next();
        (usize::from(first.is_some()) + pending.count(), first)
    }

    /// Assigns `node` a free slot or the least recently used one, for its image.
    fn take_slot(&mut self, node: usize) -> usize {
        let slot = self.take_free_slot(node);
        self.nodes[node].slot = Some(slot);
        slot
    }

    fn take_free_slot(&mut self, node: usize) -> usize {
        let (slot, evicted) = self.slots.take(node, self.clock);
        if let Some(evicted) = evicted {
            let node = &mut self.nodes[evicted];
            if node.slot == Some(slot) {
                (node.slot, node.coarse, node.lacking) = (None, false, 0);
            }
            node.changed = node.changed.filter(|&changed| changed != slot);
            self.stop_growing(evicted, slot);
        }
        slot
    }

    /// Discards `node`'s image.
    fn release(&mut self, node: usize) {
        (self.nodes[node].coarse, self.nodes[node].lacking) = (false, 0);
        (self.nodes[node].needed, self.nodes[node].needed_by_whole) = (None, None);
        self.release_changed(node);
        if let Some(slot) = self.nodes[node].slot.take() {
            self.slots.clear(slot);
            self.stop_growing(node, slot);
        }
    }

    /// Discards the image that grows, after `node` lost `slot`.
    fn stop_growing(&mut self, node: usize, slot: usize) {
        if let Some(growing) = self.nodes[node].growing.take() {
            self.nodes[node].points = 0;
            if growing != slot {
                self.slots.clear(growing);
            }
        }
    }

    /// Records that `node`'s contribution changed: invalidates the sums above it.
    fn mark_edited(&mut self, node: usize) {
        self.release_above(node);
        self.edited.push(node);
    }

    fn release_above(&mut self, node: usize) {
        let mut above = self.nodes[node].parent;
        while let Some(n) = above {
            self.release(n);
            above = self.nodes[n].parent;
        }
    }

    /// After a leaf's image changed: invalidates the sums above it that lack it or some of its points.
    fn release_coarse_above(&mut self, leaf: usize) {
        let mut above = self.nodes[leaf].parent;
        while let Some(n) = above {
            if self.nodes[n].coarse {
                self.release(n);
            }
            above = self.nodes[n].parent;
        }
        if self.rest_is_coarse {
            self.rest = None;
        }
    }

    fn scale(&self, node: usize) -> Vec3 {
        let Node { light, group, .. } = self.nodes[node];
        light.map_or(Vec3::ONE, |i| self.rig.lights[i].scale())
            * group.map_or(Vec3::ONE, |i| self.rig.groups[i].scale())
    }

    fn is_below(&self, node: usize, ancestor: usize) -> bool {
        std::iter::successors(self.nodes[node].parent, |&n| self.nodes[n].parent).any(|n| n == ancestor)
    }

    /// `sorted` is ascending.
    fn has_ancestor_in(&self, node: usize, sorted: &[usize]) -> bool {
        std::iter::successors(self.nodes[node].parent, |&n| self.nodes[n].parent)
            .any(|n| sorted.binary_search(&n).is_ok())
    }
}

/// Whether the image at unit intensity is the same for two states of a light. `same_sets`: the sets that links may name
/// did not change.
pub(super) fn same_image(a: &Light, b: &Light, same_sets: bool) -> bool {
    (a.kind, a.position, a.direction) == (b.kind, b.position, b.direction)
        && (a.radius, a.size, a.up, a.angle) == (b.radius, b.size, b.up, b.angle)
        && (a.spread, a.two_sided, a.visible) == (b.spread, b.two_sided, b.visible)
        && (a.inner_angle, a.outer_angle, a.range, a.shadows) == (b.inner_angle, b.outer_angle, b.range, b.shadows)
        && (a.decay_start, &a.filter) == (b.decay_start, &b.filter)
        && (a.rotation, &a.map, &a.material) == (b.rotation, &b.map, &b.material)
        && a.links == b.links
        && (same_sets || a.links == Links::default())
}

#[cfg(test)]
mod tests;
