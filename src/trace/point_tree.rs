//! A balanced tree over points with normals: nearest-neighbour search, and an order in which neighbours are close.
//!
//! Points have six coordinates: position, and normal times a length that weights differences in orientation. The tree
//! is implicit: a node is a range of the ordered points, and its children are the two halves of the range, split at
//! [`middle`]. Haar wavelets over gather samples use the same tree.

use glam::Vec3;

/// Position, and normal times a length.
pub type Point = [f32; 6];

/// The point of a position and a unit normal.
pub fn point(position: Vec3, normal: Vec3, normal_length: f32) -> Point {
    let normal = normal * normal_length;
    [position.x, position.y, position.z, normal.x, normal.y, normal.z]
}

/// Index at which the node `first..end` is split; the node has at least two points.
pub fn middle(first: usize, end: usize) -> usize {
    first + (end - first) / 2
}

/// The tree; see the module.
pub struct PointTree {
    /// In tree order.
    points: Vec<Point>,
    /// Original index of each of `points`.
    order: Vec<u32>,
    /// For the node that is split at an index: coordinate and axis. Points to the left have no larger coordinate.
    splits: Vec<(f32, u8)>,
}

/// Nodes of up to this many points are searched linearly.
const LEAF: usize = 8;
/// Nodes of up to this many points are split by one thread.
const TASK: usize = 4096;

impl PointTree {
    /// Splits along the longest side of each node's bounds. The result does not depend on the number of threads.
    pub fn new(points: &[Point]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut splits = vec![(0.0, 0); points.len()];
        split(points, &mut order, &mut splits);
        Self { points: order.iter().map(|&i| points[i as usize]).collect(), order, splits }
    }

    /// Original index of each point, in tree order.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// The nearest `K` points whose original indices satisfy `accept`, nearest first; fewer if there are not enough.
    pub fn nearest<const K: usize>(&self, from: &Point, accept: impl Fn(u32) -> bool) -> Nearest<K> {
        self.nearest_within(from, f32::INFINITY, accept)
    }

    /// The same of points that are no further than the square root of `reach2`.
    pub fn nearest_within<const K: usize>(
        &self,
        from: &Point,
        reach2: f32,
        accept: impl Fn(u32) -> bool,
    ) -> Nearest<K> {
        let found = Nearest { items: [(reach2, u32::MAX); K], count: 0 };
        let mut search = Search { tree: self, from, accept, offset: [0.0; 6], found };
        search.visit(0, self.points.len(), 0.0);
        search.found
    }
}

struct Search<'a, const K: usize, A> {
    tree: &'a PointTree,
    from: &'a Point,
    accept: A,
    /// Distance along each axis from `from` to the node, according to the splits above it.
    offset: Point,
    found: Nearest<K>,
}

impl<const K: usize, A: Fn(u32) -> bool> Search<'_, K, A> {
    /// `least` is the squared length of `offset`, a lower bound of the squared distance to the node's points.
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

/// The result of [`PointTree::nearest`].
pub struct Nearest<const K: usize> {
    items: [(f32, u32); K],
    count: usize,
}

impl<const K: usize> Nearest<K> {
    /// Squared distance and original index, nearest first. Points at equal distances are ordered by index, so that the
    /// result does not depend on the shape of the tree.
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
    // The right half does not overwrite the split that was just written, because no node splits at its first index.
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
        /// Compared with brute force; coordinates are on a coarse grid, so that many distances and splits are equal.
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
