//! Which lights a plan shades: images of thousands of lights, and the points of area lights, come over several
//! pictures.

use std::cmp::Reverse;

use glam::Vec3;

use super::{Detail, LightCache, Node, POINTS_A_STEP};
use crate::scene::LightKind;

/// What a plan may shade.
pub(super) struct Limit {
    /// Images of lights that it may begin.
    images: usize,
    /// Steps of [`POINTS_A_STEP`] that it may add to images of area lights; `None` for those that
    /// [`Detail`] allows for each.
    steps: Option<usize>,
}

impl Limit {
    pub fn none() -> Self {
        Self { images: usize::MAX, steps: None }
    }
}

/// The leaves that get an image or more points.
#[derive(Default)]
pub(super) struct Advances {
    /// Each with the steps of [`POINTS_A_STEP`] that it gets at most; ascending.
    leaves: Vec<(usize, u32)>,
    /// The same of any other leaf that has no image when it is needed, if those are not limited.
    others: Option<u32>,
}

impl Advances {
    /// Steps that a leaf gets at most; `None`: it stays as it is.
    pub fn of(&self, leaf: usize, has_image: bool) -> Option<u32> {
        let found = self.leaves.binary_search_by_key(&leaf, |(leaf, _)| *leaf);
        found.map(|i| self.leaves[i].1).ok().or(self.others.filter(|_| !has_image))
    }

    pub fn leaves(&self) -> impl Iterator<Item = usize> {
        self.leaves.iter().map(|(leaf, _)| *leaf)
    }
}

impl LightCache {
    /// The limit of lights outside of the focus; see [`Self::plan`].
    pub(super) fn limit(&self, most: usize, is_edited: bool) -> Limit {
        let is_scarce = self.slots.len() < Self::slot_range(self.rig.lights.len()).1;
        // An image that is evicted before it has all its points never gets them.
        if most == usize::MAX || (is_scarce && self.rig.has_sizes()) {
            return Limit::none();
        }
        // Images and the sums above them must stay until the next picture.
        let images = if self.was_whole { usize::MAX } else { most.min((self.slots.len() / 4).max(1)) };
        let steps = if is_edited || !self.was_whole { 0 } else { most.div_ceil(POINTS_A_STEP as usize) };
        Limit { images, steps: Some(steps) }
    }

    /// What the leaves below `nodes` get, as far as the limit allows. Images that are the least complete go first, one
    /// after another: few grow beside the ones that are shown.
    pub(super) fn advances(&self, nodes: &[(usize, Vec3)], limit: &Limit) -> Advances {
        let mut leaves = self.advance(nodes, limit);
        leaves.sort_unstable();
        Advances { leaves, others: (limit.images == usize::MAX).then_some(self.steps_of_each()) }
    }

    /// Steps that [`Detail`] allows for one leaf.
    pub(super) fn steps_of_each(&self) -> u32 {
        if self.detail == Detail::Progressive { 1 } else { u32::MAX }
    }

    fn advance(&self, nodes: &[(usize, Vec3)], limit: &Limit) -> Vec<(usize, u32)> {
        let (mut missing, mut incomplete) = (Vec::new(), Vec::new());
        for (node, _) in nodes.iter().filter(|(_, scale)| *scale != Vec3::ZERO) {
            self.find_incomplete(*node, &mut missing, &mut incomplete);
        }
        let each = self.steps_of_each();
        let mut leaves: Vec<_> = missing.into_iter().take(limit.images).map(|leaf| (leaf, each)).collect();
        let Some(mut left) = limit.steps else {
            leaves.extend(incomplete.into_iter().map(|leaf| (leaf, each)));
            return leaves;
        };
        let stage = |leaf: usize| self.stage(leaf);
        incomplete.sort_by_key(|&leaf| (stage(leaf), Reverse(self.nodes[leaf].points)));
        let mut is_comparing = false;
        for leaf in incomplete {
            if self.nodes[leaf].is_at_checkpoint() && std::mem::replace(&mut is_comparing, true) {
                continue; // one at a time
            }
            let steps = (stage(leaf) - self.nodes[leaf].points) / POINTS_A_STEP;
            let most = left.min(steps as usize);
            if most == 0 {
                break;
            }
            left -= most;
            leaves.push((leaf, most as u32));
        }
        leaves
    }

    /// Appends the leaves below `node` that have no image to `missing`, and those whose images can get more points now
    /// to `incomplete`.
    fn find_incomplete(&self, node: usize, missing: &mut Vec<usize>, incomplete: &mut Vec<usize>) {
        let Node { slot, changed, coarse, children, light, .. } = self.nodes[node];
        match light {
            // They cost a sum at most.
            Some(light) if changed.is_some() || self.rig.lights[light].kind == LightKind::Emitter => {}
            Some(_) if slot.is_none() => missing.push(node),
            Some(_) if self.gets_points(node) => incomplete.push(node),
            None if slot.is_none() || coarse => {
                let children = children.into_iter().flatten().filter(|&child| self.scale(child) != Vec3::ZERO);
                children.for_each(|child| self.find_incomplete(child, missing, incomplete));
            }
            _ => {}
        }
    }
}
