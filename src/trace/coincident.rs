//! Coincident triangles, treated separately in the construction of the hierarchy.
//!
//! If many boxes have the same centre, all pairs of them have the same cost. obvhs then merges one pair per pass, and
//! its reinsertion prunes nothing, so n of them take n² steps and make a tree of depth n. Here each such set is
//! one leaf during construction, and a balanced tree afterwards.

use std::collections::HashSet;
use std::hash::Hash;

use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use rayon::prelude::*;

/// Smaller sets are left as they are: 64 passes over a scene are cheap.
const MIN_SET_SIZE: usize = 64;

/// The triangles in each leaf of the tree under construction.
pub struct CoincidentSets {
    /// Box of each leaf.
    pub boxes: Vec<Aabb>,
    /// Triangles of each leaf, in order of box size.
    triangles: Vec<Vec<u32>>,
}

impl CoincidentSets {
    /// Returns `None` if no set is large enough. Of a set's triangles with equal `same` only one is retained: no ray
    /// distinguishes them, and each would be tested.
    pub fn find<K: Hash + Eq>(boxes: &[Aabb], same: impl Fn(u32) -> Option<K>) -> Option<Self> {
        // -0 becomes 0.
        let centre = |aabb: &Aabb| (aabb.min + aabb.max).to_array().map(|x| (x + 0.0).to_bits());
        let mut by_centre: Vec<([u32; 3], u32)> = boxes.iter().map(centre).zip(0..).collect();
        by_centre.par_sort_unstable();
        let runs = || by_centre.chunk_by(|a, b| a.0 == b.0);
        if runs().all(|run| run.len() < MIN_SET_SIZE) {
            return None;
        }
        let mut triangles: Vec<Vec<u32>> = Vec::new();
        for run in runs() {
            let set = run.iter().map(|&(_, triangle)| triangle);
            match run.len() {
                MIN_SET_SIZE.. => {
                    let mut seen = HashSet::new();
                    triangles.push(set.filter(|&i| same(i).is_none_or(|key| seen.insert(key))).collect());
                }
                _ => triangles.extend(set.map(|triangle| vec![triangle])),
            }
        }
        triangles.sort_unstable_by_key(|set| set[0]);
        for set in &mut triangles {
            // Boxes with one centre overlap: neighbours in size have the smallest unions.
            set.sort_by(|&a, &b| boxes[a as usize].half_area().total_cmp(&boxes[b as usize].half_area()));
        }
        let boxes = triangles.iter().map(|set| union(set, boxes)).collect();
        Some(Self { boxes, triangles })
    }

    /// Converts `tree` over the sets to a tree over triangles, with one triangle per leaf.
    pub fn expand(self, tree: &mut Bvh2, boxes: &[Aabb]) {
        let mut indices = Vec::with_capacity(boxes.len());
        let mut deepest = 0;
        for leaf in 0..tree.nodes.len() {
            if !tree.nodes[leaf].is_leaf() {
                continue;
            }
            let set = &self.triangles[tree.primitive_indices[tree.nodes[leaf].first_index as usize] as usize];
            deepest = deepest.max(set.len().next_power_of_two().ilog2() as usize);
            // Nodes to create, each with its range of the set.
            let mut open = vec![(leaf, 0..set.len())];
            while let Some((node, range)) = open.pop() {
                let aabb = union(&set[range.clone()], boxes);
                if range.len() == 1 {
                    tree.nodes[node] = Bvh2Node::new(aabb, 1, indices.len() as u32);
                    indices.push(set[range.start]);
                    continue;
                }
                let children = tree.nodes.len();
                tree.nodes[node] = Bvh2Node::new(aabb, 0, children as u32);
                tree.nodes.extend([Bvh2Node::default(); 2]);
                let middle = range.start + range.len() / 2;
                open.extend([(children, range.start..middle), (children + 1, middle..range.end)]);
            }
        }
        tree.primitive_indices = indices;
        tree.primitives_to_nodes.clear();
        tree.parents.clear();
        tree.children_are_ordered_after_parents = false;
        tree.max_depth += deepest;
    }
}

fn union(set: &[u32], boxes: &[Aabb]) -> Aabb {
    set.iter().fold(Aabb::empty(), |sum, &i| sum.union(&boxes[i as usize]))
}
