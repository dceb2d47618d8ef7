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
mod points;
mod slots;
mod tree;

use std::collections::HashMap;

use glam::Vec3;

use self::limit::{Advances, Limit};
pub use self::plan::{Detail, LightPoints, Plan, Shade, Source, Step, Term};
pub use self::points::POINTS_A_STEP;
use self::slots::Slots;
use crate::scene::{Light, LightKind, Links, Rig};
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
    /// What changed is found by comparing both rigs: undo, snapshots and scripts give whole rigs, so a list of edits would
    /// be a second way, and stale images wherever it is incomplete. The comparison takes less time than the copy of the rig.
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

    /// Plans the whole picture. Outside of the focus it shades about `most` points of lights: as long as all images are
    /// being made, it begins so many of them and lacks further lights, and then gives points to images of lights with a
    /// size, unless lights were edited. Later pictures go on. Images that edits invalidate have no such limit.
    pub fn plan(&mut self, most: usize) -> Plan {
        self.clock += 1;
        if self.detail != Detail::Coarse {
            self.release_coarse();
        }
        self.stop_comparing_dark();
        let mut plan = Plan::default();
        let mut edited = std::mem::take(&mut self.edited);
        let is_edited = !edited.is_empty();
        edited.sort_unstable();
        edited.dedup();
        match self.selected.take() {
            Some(selected) => {
                let is_inside = |n| selected.binary_search(&n).is_ok() || self.has_ancestor_in(n, &selected);
                if self.focus != selected || !edited.iter().all(|&n| is_inside(n)) {
                    self.rest = None;
                }
                self.focus = selected;
                self.edited_before.clone_from(&self.focus);
            }
            None => self.focus_on(edited),
        }
        let mut focus_terms = Vec::new();
        let mut rest_nodes = Vec::new();
        if let Some(root) = self.root {
            self.split(root, Vec3::ONE, &mut focus_terms, &mut rest_nodes);
        }
        let mut pinned = Vec::new();
        let mut is_coarse = false;
        if self.rest_is_coarse && self.detail != Detail::Coarse {
            self.rest = None;
        }
        let of_focus = self.advances(&focus_terms, &Limit::none());
        let of_rest = match self.rest {
            Some(_) => Advances::default(),
            None => self.advances(&rest_nodes, &self.limit(most, is_edited)),
        };
        of_focus.leaves().chain(of_rest.leaves()).for_each(|leaf| self.release_above(leaf));
        for (node, scale) in focus_terms {
            let (slot, _) = self.ensure_image(node, &of_focus, &mut plan.steps);
            let slot = slot.expect("nothing in the focus is lacking");
            is_coarse |= self.nodes[node].coarse;
            self.slots.pin(slot);
            pinned.push(slot);
            plan.picture.push(Term { source: Source::Slot(slot), scale });
        }
        let before_rest = plan.steps.len();
        let rest = match self.rest.take() {
            Some(rest) => rest,
            None => self.make_rest(&rest_nodes, &of_rest, &mut plan.steps),
        };
        let shades = plan.steps[before_rest..].iter().filter_map(Step::as_shade);
        self.points_in_rest = shades.map(|shade| shade.points.count()).sum();
        self.was_whole |= self.lacking == 0;
        plan.picture.extend(&rest);
        self.rest = Some(rest);
        for slot in pinned {
            self.slots.unpin(slot);
        }
        self.picture_is_coarse = is_coarse || self.rest_is_coarse;
        plan
    }

    /// Moves the focus to the edited nodes.
    fn focus_on(&mut self, mut edited: Vec<usize>) {
        // A group's node includes all edited nodes below it.
        let below: Vec<usize> = edited.iter().copied().filter(|&n| self.has_ancestor_in(n, &edited)).collect();
        edited.retain(|n| below.binary_search(n).is_err());
        // If the same part of the focus is edited twice, it becomes the focus: later frames read fewer images.
        let narrower = edited == self.edited_before && edited.len() < self.focus.len();
        if !edited.is_empty() {
            self.edited_before.clone_from(&edited);
        }
        let outside = !edited.iter().all(|n| self.focus.contains(n)) || !below.is_empty();
        if outside || (narrower && !edited.is_empty()) {
            self.focus = if edited.len() <= MAX_FOCUS { edited } else { Vec::new() };
            self.rest = None;
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

    /// Plans the picture of one light alone.
    pub fn plan_light(&mut self, light: usize) -> Plan {
        self.compared = self.compared.filter(|&compared| compared == self.leaf_of[light]);
        self.plan_light_beside_others(light)
    }

    fn plan_light_beside_others(&mut self, light: usize) -> Plan {
        self.clock += 1;
        let mut plan = Plan::default();
        let mut scale = Vec3::ONE;
        let mut node = Some(self.leaf_of[light]);
        while let Some(n) = node {
            scale *= self.scale(n);
            node = self.nodes[n].parent;
        }
        (self.picture_is_coarse, self.lacking, self.points_in_rest) = (false, 0, 0);
        if scale != Vec3::ZERO {
            let most = self.steps_of_each();
            let slot = self.ensure_leaf(self.leaf_of[light], light, most, &mut plan.steps);
            self.release_coarse_above(self.leaf_of[light]);
            self.picture_is_coarse = self.nodes[self.leaf_of[light]].coarse;
            plan.picture.push(Term { source: Source::Slot(slot), scale });
        }
        plan
    }

    /// Plans a part of the image of one light: all of it if the light has no size, else at most `most` times some of its
    /// points.
    pub fn plan_part(&mut self, light: usize, most: u32) -> Plan {
        self.clock += 1;
        self.compared = self.compared.filter(|&compared| compared == self.leaf_of[light]);
        let mut plan = Plan::default();
        self.add_points(self.leaf_of[light], light, most, &mut plan.steps);
        self.release_coarse_above(self.leaf_of[light]);
        plan
    }

    /// Plans a contact sheet of `cells` cells, one light's contribution per cell.
    pub fn plan_sheet(&mut self, cells: usize) -> Plan {
        self.stop_comparing_dark();
        (self.lacking, self.points_in_rest) = (0, 0);
        let mut plan = Plan::default();
        let mut is_coarse = false;
        for cell in 0..cells {
            let light =
                if cell < self.rig.lights.len() { self.plan_light_beside_others(cell) } else { Plan::default() };
            is_coarse |= self.picture_is_coarse;
            plan.steps.extend(light.steps);
            plan.steps.push(Step::Show { cell, term: light.picture.first().copied() });
        }
        self.picture_is_coarse = is_coarse;
        plan
    }

    /// Splits the tree into focus nodes and the largest subtrees without focus nodes, each with its scale in the
    /// picture.
    fn split(
        &self,
        node: usize,
        above: Vec3,
        focus_terms: &mut Vec<(usize, Vec3)>,
        rest_nodes: &mut Vec<(usize, Vec3)>,
    ) {
        let scale = above * self.scale(node);
        if self.focus.contains(&node) {
            if scale != Vec3::ZERO {
                focus_terms.push((node, scale));
            }
        } else if !self.focus.iter().any(|&f| self.is_below(f, node)) {
            rest_nodes.push((node, scale));
        } else if let Some(children) = self.nodes[node].children {
            for child in children {
                self.split(child, scale, focus_terms, rest_nodes);
            }
        }
    }

    /// Plans the picture of all emitters together.
    pub fn plan_emitters(&mut self) -> Plan {
        self.clock += 1;
        let mut plan = Plan::default();
        let is_emitter = |light: &usize| self.rig.lights[*light].kind == LightKind::Emitter;
        let emitters = (0..self.rig.lights.len()).filter(is_emitter);
        let nodes: Vec<_> = emitters.map(|light| (self.leaf_of[light], self.rig.scale(light))).collect();
        plan.picture = self.make_rest(&nodes, &Advances::default(), &mut plan.steps);
        (self.rest, self.points_in_rest) = (None, 0);
        self.picture_is_coarse = self.rest_is_coarse;
        plan
    }

    /// Plans the rest, the sum of `nodes`; returns its terms. `advances`: see [`Self::ensure_image`].
    fn make_rest(&mut self, nodes: &[(usize, Vec3)], advances: &Advances, steps: &mut Vec<Step>) -> Vec<Term> {
        (self.rest_is_coarse, self.lacking) = (false, 0);
        let mut slots = Vec::new();
        let mut kept = 0.0;
        let mut nodes = nodes.iter().filter(|(_, scale)| *scale != Vec3::ZERO).peekable();
        while let Some(&(node, scale)) = nodes.next() {
            let (slot, lacking) = self.ensure_image(node, advances, steps);
            self.lacking += lacking;
            self.rest_is_coarse |= lacking > 0;
            if let Some(slot) = slot {
                self.rest_is_coarse |= self.nodes[node].coarse;
                self.slots.pin(slot);
                slots.push((slot, scale));
            }
            if slots.len() == BATCH || (nodes.peek().is_none() && !slots.is_empty()) {
                slots.iter().for_each(|(slot, _)| self.slots.unpin(*slot));
                let terms = slots.drain(..).map(|(slot, scale)| Term { source: Source::Slot(slot), scale }).collect();
                steps.push(Step::Sum { target: Source::Rest, terms, kept });
                kept = 1.0;
            }
        }
        let rest = Term { source: Source::Rest, scale: Vec3::ONE };
        if kept > 0.0 { vec![rest] } else { Vec::new() }
    }

    /// Plans `node`'s image unless it is valid. Only the leaves of `advances` get images or more points. Returns its slot, or `None` if no light below the node has an image, and the number of lights that lack one.
    fn ensure_image(&mut self, node: usize, advances: &Advances, steps: &mut Vec<Step>) -> (Option<usize>, usize) {
        let Node { slot, changed, children, light, lacking, .. } = self.nodes[node];
        if let Some(light) = light {
            let is_emitter = self.rig.lights[light].kind == LightKind::Emitter;
            let most = advances.of(node, slot.is_some());
            if changed.is_none() && !self.nodes[node].is_complete() && !is_emitter && most.is_none() {
                slot.inspect(|&slot| self.slots.use_at(slot, self.clock));
                return (slot, usize::from(slot.is_none()));
            }
            return (Some(self.ensure_leaf(node, light, most.unwrap_or(0), steps)), 0);
        }
        if let Some(slot) = slot {
            self.slots.use_at(slot, self.clock);
            return (Some(slot), lacking);
        }
        let children = children.expect("a node without light has children");
        let mut terms = Vec::with_capacity(2);
        let (mut coarse, mut lacking) = (false, 0);
        for child in children {
            let scale = self.scale(child);
            if scale != Vec3::ZERO {
                let (slot, lacking_below) = self.ensure_image(child, advances, steps);
                lacking += lacking_below;
                let Some(slot) = slot else { continue };
                coarse |= self.nodes[child].coarse;
                self.slots.pin(slot);
                terms.push((slot, scale));
            }
        }
        if lacking > 0 && terms.is_empty() {
            return (None, lacking);
        }
        let target = self.take_slot(node);
        (self.nodes[node].coarse, self.nodes[node].lacking) = (coarse || lacking > 0, lacking);
        for (slot, _) in &terms {
            self.slots.unpin(*slot);
        }
        let terms = terms.into_iter().map(|(slot, scale)| Term { source: Source::Slot(slot), scale }).collect();
        steps.push(Step::Sum { target: Source::Slot(target), terms, kept: 0.0 });
        (Some(target), lacking)
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
