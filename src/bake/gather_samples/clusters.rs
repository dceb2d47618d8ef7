//! Centroidal clusters of points with normals [Lloyd 1982]: compact pieces of surface of about equal area.

use rayon::prelude::*;

use crate::trace::point_tree::{Point, PointTree};

/// Lloyd iterations. Few suffice, as the initial pieces come from the tree.
const ROUNDS: usize = 8;

/// A partition of points.
pub struct Clusters {
    /// Mean of each cluster's points.
    pub means: Vec<Point>,
    /// Members of cluster c: `members[first[c]..first[c + 1]]`.
    first: Vec<u32>,
    members: Vec<u32>,
}

impl Clusters {
    /// At most `count` clusters of `points`, none of them empty. The result does not depend on the number of threads.
    pub fn new(points: &[Point], count: usize) -> Self {
        let count = count.min(points.len());
        let tree = PointTree::new(points);
        // Seeds are points of pieces of the tree, not means: a piece that bends around an edge has no point near its
        // mean.
        let seed = |c: usize| points[tree.order()[(2 * c + 1) * points.len() / (2 * count)] as usize];
        let means = (0..count).map(seed).collect();
        let mut clusters = Self { means, first: Vec::new(), members: tree.order().to_vec() };
        for _ in 0..ROUNDS {
            clusters.assign(points);
            clusters.average(points);
        }
        clusters
    }

    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Indices of a cluster's points.
    pub fn members(&self, cluster: usize) -> &[u32] {
        &self.members[self.first[cluster] as usize..self.first[cluster + 1] as usize]
    }

    /// Assigns every point to the cluster with the nearest mean; clusters without points are removed.
    fn assign(&mut self, points: &[Point]) {
        let tree = PointTree::new(&self.means);
        // In tree order, so that searches of neighbours touch the same nodes.
        let nearest: Vec<u32> =
            self.members.par_iter().map(|&i| tree.nearest::<1>(&points[i as usize], |_| true).items()[0].1).collect();
        let mut counts = vec![0u32; self.means.len()];
        nearest.iter().for_each(|&c| counts[c as usize] += 1);
        let mut next = vec![0; self.means.len()];
        let mut total = 0;
        self.first.clear();
        for (next, count) in next.iter_mut().zip(counts) {
            *next = total;
            total += count;
            if count > 0 {
                self.first.push(*next);
            }
        }
        self.first.push(total);
        let mut members = vec![0; points.len()];
        for (&i, &c) in self.members.iter().zip(&nearest) {
            members[next[c as usize] as usize] = i;
            next[c as usize] += 1;
        }
        self.members = members;
    }

    fn average(&mut self, points: &[Point]) {
        let mean = |members: &[u32]| {
            let mut sum = [0.0f64; 6];
            for &i in members {
                sum.iter_mut().zip(points[i as usize]).for_each(|(s, x)| *s += f64::from(x));
            }
            sum.map(|s| (s / members.len() as f64) as f32)
        };
        self.means =
            self.first.par_windows(2).map(|range| mean(&self.members[range[0] as usize..range[1] as usize])).collect();
    }
}
