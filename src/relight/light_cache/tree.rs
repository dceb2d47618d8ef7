//! The tree of partial sums, and what stays of it when lights come, go or change groups.

use std::collections::HashMap;

use super::slots::Slots;
use super::{LightCache, Node, same_image};
use crate::scene::{Light, Rig};

impl LightCache {
    /// Builds the tree of the rig: a balanced one below each group.
    pub(super) fn build_tree(&mut self) {
        let leaf = |light| Node { light: Some(light), ..Node::default() };
        self.nodes = (0..self.rig.lights.len()).map(leaf).collect();
        self.leaf_of = (0..self.rig.lights.len()).collect();
        self.node_of_group = vec![None; self.rig.groups.len()];
        let mut top = Vec::new();
        for group in 0..self.rig.groups.len() {
            let lights: Vec<usize> =
                (0..self.rig.lights.len()).filter(|&i| self.rig.lights[i].group == Some(group)).collect();
            if let Some(node) = self.balance(&lights) {
                self.nodes[node].group = Some(group);
                self.node_of_group[group] = Some(node);
                top.push(node);
            }
        }
        top.extend((0..self.rig.lights.len()).filter(|&i| self.rig.lights[i].group.is_none()));
        self.root = self.balance(&top);
    }

    /// A balanced tree over `nodes`; returns its root.
    fn balance(&mut self, nodes: &[usize]) -> Option<usize> {
        match nodes {
            [] => None,
            [one] => Some(*one),
            _ => {
                let (left, right) = nodes.split_at(nodes.len() / 2);
                let children = [self.balance(left)?, self.balance(right)?];
                let this = self.nodes.len();
                self.nodes.push(Node { children: Some(children), ..Node::default() });
                for child in children {
                    self.nodes[child].parent = Some(this);
                }
                Some(this)
            }
        }
    }

    /// Rebuilds the tree after lights are added, removed or change groups. Images of unmoved lights stay valid.
    pub(super) fn rebuild_tree(&mut self, old: &Rig) {
        let kept: HashMap<&str, (&Light, usize, Node)> = old
            .lights
            .iter()
            .enumerate()
            .filter_map(|(i, light)| {
                let leaf = &self.nodes[self.leaf_of[i]];
                Some((light.name.as_str(), (light, leaf.slot?, leaf.clone())))
            })
            .collect();
        self.build_tree();
        let same_sets = self.rig.sets == old.sets;
        let mut slots = Slots::new(self.slots.len());
        for (i, light) in self.rig.lights.iter().enumerate() {
            if let Some((was, slot, node)) = kept.get(light.name.as_str())
                && same_image(was, light, same_sets)
            {
                let (leaf, slot) = (self.leaf_of[i], *slot);
                let Node { coarse, is_interleaved, needed, needed_by_whole, .. } = *node;
                // An image that grows begins again.
                let points = if is_interleaved { 0 } else { node.points };
                let new = self.nodes[leaf].clone();
                self.nodes[leaf] =
                    Node { slot: Some(slot), coarse, is_interleaved, points, needed, needed_by_whole, ..new };
                slots.set(slot, leaf, self.slots.last_used(slot));
            }
        }
        self.slots = slots;
        self.focus.clear();
        self.edited.clear();
        self.selected = None;
        self.edited_before.clear();
        self.rest = None;
        self.compared = None;
    }
}
