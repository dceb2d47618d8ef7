//! Which nodes are the focus of the next plan: those that the user selected, else the edited ones.

use super::{LightCache, MAX_FOCUS};

impl LightCache {
    /// Makes `lights`, the lights that will be edited, the focus of the next plan, whatever else was edited. If
    /// `lights` is empty or covers too many nodes, the focus is empty.
    ///
    /// Rig and focus determine the picture bit by bit, since they determine the order of summation.
    pub fn select(&mut self, lights: &[usize]) {
        let mut nodes = Vec::new();
        match (lights, self.root) {
            ([], _) | (_, None) => {}
            ([one], _) => nodes.push(self.leaf_of[*one]),
            (_, Some(root)) => {
                let mut leaves: Vec<usize> = lights.iter().map(|&light| self.leaf_of[light]).collect();
                leaves.sort_unstable();
                if self.cover(root, &leaves, &mut nodes) {
                    nodes.push(root);
                }
                nodes.sort_unstable();
            }
        }
        if nodes.len() > MAX_FOCUS {
            nodes.clear();
        }
        self.selected = Some(nodes);
    }

    /// Moves the focus to the edited nodes.
    pub(super) fn focus_on(&mut self, mut edited: Vec<usize>) {
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

    /// Whether all lights below `node` are in `leaves`. If not, appends the largest subtrees that are covered to
    /// `nodes`.
    fn cover(&self, node: usize, leaves: &[usize], nodes: &mut Vec<usize>) -> bool {
        let Some(children) = self.nodes[node].children else { return leaves.binary_search(&node).is_ok() };
        let covered = children.map(|child| self.cover(child, leaves, nodes));
        if covered == [true; 2] {
            return true;
        }
        nodes.extend(children.iter().zip(covered).filter(|(_, covered)| *covered).map(|(child, _)| child));
        false
    }
}
