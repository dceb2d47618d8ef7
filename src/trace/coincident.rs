//! Triangles that lie on each other, kept apart from the search for good trees.
//!
//! Where many boxes share their centre, every pair of them is as good as any other: obvhs then merges one pair a pass,
//! and its reinsertion prunes nothing, so that n of them take n² steps and make a tree n deep. Here each such heap is one
//! leaf while the tree is searched for, and becomes a balanced tree afterwards.

use std::collections::HashSet;
use std::hash::Hash;

use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use rayon::prelude::*;

/// Smaller heaps are no trouble, and are left as they are: 64 passes over a scene are nothing.
const MIN_HEAP: usize = 64;

/// Triangles by leaf of the tree that is searched for.
pub struct Heaps {
    /// Box of each leaf.
    pub boxes: Vec<Aabb>,
    /// Triangles of each leaf, and their boxes.
    triangles: Vec<Vec<u32>>,
}

impl Heaps {
    /// `None` if no heap is worth it. Of a heap's triangles that are `same` one is enough: no ray tells them apart, and each
    /// would be tested.
    pub fn find<K: Hash + Eq>(boxes: &[Aabb], same: impl Fn(u32) -> Option<K>) -> Option<Self> {
        // -0 becomes 0.
        let centre = |aabb: &Aabb| (aabb.min + aabb.max).to_array().map(|x| (x + 0.0).to_bits());
        let mut by_centre: Vec<([u32; 3], u32)> = boxes.iter().map(centre).zip(0..).collect();
        by_centre.par_sort_unstable();
        let runs = || by_centre.chunk_by(|a, b| a.0 == b.0);
        if runs().all(|run| run.len() < MIN_HEAP) {
            return None;
        }
        let mut triangles: Vec<Vec<u32>> = Vec::new();
        for run in runs() {
            let heap = run.iter().map(|&(_, triangle)| triangle);
            match run.len() {
                MIN_HEAP.. => {
                    let mut seen = HashSet::new();
                    triangles.push(heap.filter(|&i| same(i).is_none_or(|key| seen.insert(key))).collect());
                }
                _ => triangles.extend(heap.map(|triangle| vec![triangle])),
            }
        }
        triangles.sort_unstable_by_key(|heap| heap[0]);
        for heap in &mut triangles {
            // Boxes around one centre lie in each other: neighbours in size make the smallest unions.
            heap.sort_by(|&a, &b| boxes[a as usize].half_area().total_cmp(&boxes[b as usize].half_area()));
        }
        let boxes = triangles.iter().map(|heap| union(heap, boxes)).collect();
        Some(Self { boxes, triangles })
    }

    /// `tree` over the heaps as a tree over triangles with one in each leaf.
    pub fn expand(self, tree: &mut Bvh2, boxes: &[Aabb]) {
        let mut indices = Vec::with_capacity(boxes.len());
        let mut deepest = 0;
        for leaf in 0..tree.nodes.len() {
            if !tree.nodes[leaf].is_leaf() {
                continue;
            }
            let heap = &self.triangles[tree.primitive_indices[tree.nodes[leaf].first_index as usize] as usize];
            deepest = deepest.max(heap.len().next_power_of_two().ilog2() as usize);
            // Nodes that are to hold a range of the heap.
            let mut open = vec![(leaf, 0..heap.len())];
            while let Some((node, range)) = open.pop() {
                let aabb = union(&heap[range.clone()], boxes);
                if range.len() == 1 {
                    tree.nodes[node] = Bvh2Node::new(aabb, 1, indices.len() as u32);
                    indices.push(heap[range.start]);
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

fn union(heap: &[u32], boxes: &[Aabb]) -> Aabb {
    heap.iter().fold(Aabb::empty(), |sum, &i| sum.union(&boxes[i as usize]))
}
