//! A balanced tree over points with normals: who is near, and an order in which neighbours stay together.
//!
//! Points have six coordinates: position, and normal times a length that says how far apart opposite faces count. The
//! tree is implicit: a node is a range of the ordered points, its children are the two halves of the range, split at
//! [`middle`]. Haar wavelets over gather samples use the same tree.

use glam::Vec3;

/// Position, and normal times a length.
pub type Point = [f32; 6];

pub fn point(position: Vec3, normal: Vec3, normal_length: f32) -> Point {
    let normal = normal * normal_length;
    [position.x, position.y, position.z, normal.x, normal.y, normal.z]
}

/// Where the node that holds `first..end` is split; for at least two points.
pub fn middle(first: usize, end: usize) -> usize {
    first + (end - first) / 2
}

pub struct PointTree {
    /// In tree order.
    points: Vec<Point>,
    /// Index that each of `points` had before.
    order: Vec<u32>,
    /// Of the node split at an index: where, and along which axis. What lies left of it is no larger.
    splits: Vec<(f32, u8)>,
}

/// A node with so many points is searched through.
const LEAF: usize = 8;
/// A node with fewer points is split by one thread.
const TASK: usize = 4096;

impl PointTree {
    /// Splits along the longest side of each node's bounds. The same points give the same tree, whatever the threads.
    pub fn new(points: &[Point]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut splits = vec![(0.0, 0); points.len()];
        split(points, &mut order, &mut splits);
        Self { points: order.iter().map(|&i| points[i as usize]).collect(), order, splits }
    }

    /// Index that each point had, in tree order.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// The nearest `K` points whose indices before ordering `accept` takes, nearest first; fewer if there are not so many.
    pub fn nearest<const K: usize>(&self, from: &Point, accept: impl Fn(u32) -> bool) -> Nearest<K> {
        let found = Nearest { items: [(f32::INFINITY, u32::MAX); K], count: 0 };
        let mut search = Search { tree: self, from, accept, offset: [0.0; 6], found };
        search.visit(0, self.points.len(), 0.0);
        search.found
    }
}

struct Search<'a, const K: usize, A> {
    tree: &'a PointTree,
    from: &'a Point,
    accept: A,
    /// Distance along each axis between `from` and the node's side of the splits above.
    offset: Point,
    found: Nearest<K>,
}

impl<const K: usize, A: Fn(u32) -> bool> Search<'_, K, A> {
    /// `least` is the square of `offset`'s length: no point of the node is nearer.
    fn visit(&mut self, first: usize, end: usize, least: f32) {
        if end - first <= LEAF {
            for (point, &index) in self.tree.points[first..end].iter().zip(&self.tree.order[first..end]) {
                let distance2 = point.iter().zip(self.from).map(|(a, b)| (a - b) * (a - b)).sum();
                if (distance2, index) < self.found.items[K - 1] && (self.accept)(index) {
                    self.found.insert(distance2, index);
                }
            }
            return;
        }
        let mid = middle(first, end);
        let (value, axis) = self.tree.splits[mid];
        let beyond = self.from[axis as usize] - value;
        let (near, far) = if beyond < 0.0 { ((first, mid), (mid, end)) } else { ((mid, end), (first, mid)) };
        self.visit(near.0, near.1, least);
        let before = self.offset[axis as usize];
        let least = least - before * before + beyond * beyond;
        if least <= self.found.items[K - 1].0 {
            self.offset[axis as usize] = beyond;
            self.visit(far.0, far.1, least);
            self.offset[axis as usize] = before;
        }
    }
}

/// What [`PointTree::nearest`] found.
pub struct Nearest<const K: usize> {
    items: [(f32, u32); K],
    count: usize,
}

impl<const K: usize> Nearest<K> {
    /// Squared distance, and the index that the point had before ordering; nearest first. Of equally near points the
    /// one with the smaller index comes first, so that the answer does not depend on the shape of the tree.
    pub fn items(&self) -> &[(f32, u32)] {
        &self.items[..self.count]
    }

    fn insert(&mut self, distance2: f32, index: u32) {
        let place = self.items.partition_point(|&item| item < (distance2, index));
        self.items[place..].rotate_right(1);
        self.items[place] = (distance2, index);
        self.count = (self.count + 1).min(K);
    }
}

fn split(points: &[Point], order: &mut [u32], splits: &mut [(f32, u8)]) {
    if order.len() < 2 {
        return;
    }
    let (mut low, mut high) = ([f32::INFINITY; 6], [f32::NEG_INFINITY; 6]);
    for &i in order.iter() {
        for axis in 0..6 {
            low[axis] = low[axis].min(points[i as usize][axis]);
            high[axis] = high[axis].max(points[i as usize][axis]);
        }
    }
    let longer = |a: usize, b: usize| if high[b] - low[b] > high[a] - low[a] { b } else { a };
    let axis = (1..6).fold(0, longer);
    let mid = middle(0, order.len());
    order.select_nth_unstable_by(mid, |&a, &b| {
        points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
    });
    splits[mid] = (points[order[mid] as usize][axis], axis as u8);
    let parallel = order.len() > TASK;
    let (left, right) = order.split_at_mut(mid);
    // The right half begins with the split that was just written: it has no split of its own at its first index.
    let (left_splits, right_splits) = splits.split_at_mut(mid);
    if parallel {
        rayon::join(|| split(points, left, left_splits), || split(points, right, right_splits));
    } else {
        split(points, left, left_splits);
        split(points, right, right_splits);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against trying every point; coordinates on a coarse grid, so that many distances and splits are equal.
        #[test]
        fn finds_what_a_search_through_all_finds(
            points in prop::collection::vec(prop::array::uniform6(-3i8..4), 0..200),
            from in prop::array::uniform6(-4i8..5),
        ) {
            let points: Vec<Point> = points.into_iter().map(|p| p.map(f32::from)).collect();
            let from = from.map(f32::from);
            let accept = |p: &Point| p[3] >= 0.0;
            let accept_index = |i: u32| accept(&points[i as usize]);
            let distance2 = |p: &Point| p.iter().zip(&from).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
            let mut all: Vec<(f32, u32)> = Vec::new();
            all.extend(points.iter().enumerate().filter(|(_, p)| accept(p)).map(|(i, p)| (distance2(p), i as u32)));
            all.sort_by(|a, b| a.partial_cmp(b).expect("no distance is NaN"));
            all.truncate(5);
            let tree = PointTree::new(&points);
            let nearest = tree.nearest::<5>(&from, accept_index);
            prop_assert_eq!(nearest.items(), &all[..]);
            let mut order = tree.order().to_vec();
            order.sort_unstable();
            prop_assert_eq!(order, (0..points.len() as u32).collect::<Vec<_>>());
        }
    }
}
