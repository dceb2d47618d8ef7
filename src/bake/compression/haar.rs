//! Orthonormal Haar wavelets over the tree of gather samples, one transform for each coefficient index.
//!
//! A node of the tree contains the samples `first..end` and is split at [`middle`]. For coefficient k, only samples
//! that have it take part: l on the left and r on the right. From the bottom up, each node with both sides rotates
//! their sums in the plane,
//!
//! ```text
//! sum  = (√l left + √r right) / √(l + r)
//! term = (√r left - √l right) / √(l + r)
//! ```
//!
//! in place: the sum replaces the left sum, the term the right one. So there are as many terms as coefficients, and
//! rotations preserve squares: λ̂ = H λ with HᵀH = I.

use std::ops::{Add, Sub};

use glam::DVec3;

use crate::shared::Rotation;
use crate::trace::point_tree::middle;

/// The transform of coefficients, of which sample i has `first[i]..first[i + 1]`, as in [`Level`].
///
/// [`Level`]: crate::bake::transport::level::Level
#[derive(Clone, Debug, Default)]
pub struct Haar {
    /// From the bottom of the tree up; rotations of equal height touch disjoint elements.
    pub rotations: Vec<Rotation>,
    /// Rotations of height h: `heights[h]..heights[h + 1]`.
    pub heights: Vec<usize>,
}

/// A transform to selected terms: sums first, then rotations. Other elements have undefined values afterwards.
pub struct Pruned {
    /// Elements of all sums. Each sum, divided by the square root of its length, is stored in its first element.
    pub places: Vec<u32>,
    /// Offset of each sum's elements in `places`, and the end of the last one.
    pub first_place: Vec<u32>,
    /// The remaining rotations.
    pub haar: Haar,
}

/// Maximum number of elements of a sum: one thread adds them up while neighbouring threads with shorter sums are idle.
const LONGEST_SUM: u32 = 32;

/// For each coefficient index: the number of samples of a node that have it, and the element with their sum.
type Sums = Vec<(u32, u32)>;

impl Haar {
    /// The transform for samples with coefficients `first[i]..first[i + 1]`.
    pub fn new(first: &[u32]) -> Self {
        let mut by_height: Vec<Vec<Rotation>> = Vec::new();
        let samples = first.len().saturating_sub(1);
        if samples > 0 {
            collect(first, 0, samples, &mut by_height);
        }
        let mut heights = vec![0];
        heights.extend(by_height.iter().scan(0, |sum, rotations| {
            *sum += rotations.len();
            Some(*sum)
        }));
        Self { rotations: by_height.concat(), heights }
    }

    /// This transform of coefficients, and the same of others that begin at `offset`: they never mix.
    pub fn twice(&self, offset: u32) -> Self {
        let mut twice = Self { rotations: Vec::new(), heights: vec![0] };
        for range in self.heights.windows(2) {
            for offset in [0, offset] {
                let moved = |r: &Rotation| Rotation { sum: r.sum + offset, term: r.term + offset, ..*r };
                twice.rotations.extend(self.rotations[range[0]..range[1]].iter().map(moved));
            }
            twice.heights.push(twice.rotations.len());
        }
        twice
    }

    /// Transforms several vectors: `values[coefficient][vector]`.
    pub fn transform<const WIDTH: usize>(&self, values: &mut [[f32; WIDTH]]) {
        for rotation in &self.rotations {
            let (left, right) = (values[rotation.sum as usize], values[rotation.term as usize]);
            let (c, s) = (rotation.cosine, rotation.sine);
            values[rotation.sum as usize] = std::array::from_fn(|i| c * left[i] + s * right[i]);
            values[rotation.term as usize] = std::array::from_fn(|i| s * left[i] - c * right[i]);
        }
    }

    /// Number of samples that each of `count` terms spans, counting those that have its coefficient: the samples of
    /// both sums that it separates, or all samples for a final sum.
    pub fn spans(&self, count: usize) -> Vec<u32> {
        let mut spans = vec![1; count];
        for rotation in &self.rotations {
            let [sum, term] = [rotation.sum, rotation.term].map(|place| place as usize);
            let both = spans[sum] + spans[term];
            (spans[sum], spans[term]) = (both, both);
        }
        spans
    }

    /// Omits rotations on which no needed term depends; `needed` has one flag per coefficient. Subtrees without needed
    /// terms become sums.
    pub fn pruned(&self, needed: &[bool]) -> Pruned {
        // From the top down: whether any needed term depends on an element.
        let mut used = needed.to_vec();
        let mut kept = vec![false; self.rotations.len()];
        for (i, rotation) in self.rotations.iter().enumerate().rev() {
            let [sum, term] = [rotation.sum, rotation.term].map(|place| place as usize);
            kept[i] = used[sum] || used[term];
            (used[sum], used[term]) = (kept[i], kept[i]);
        }
        // From the bottom up: linked lists of the elements of sums.
        let mut next: Vec<u32> = (0..needed.len() as u32).collect();
        let mut last = next.clone();
        let mut count = vec![1; needed.len()];
        let mut rotated = vec![false; needed.len()];
        let mut haar = Self { rotations: Vec::new(), heights: vec![0] };
        for range in self.heights.windows(2) {
            for rotation in (range[0]..range[1]).filter(|&i| kept[i]).map(|i| self.rotations[i]) {
                let [sum, term] = [rotation.sum, rotation.term].map(|place| place as usize);
                let all = count[sum] + count[term];
                if rotated[sum] || rotated[term] || needed[term] || all > LONGEST_SUM {
                    haar.rotations.push(rotation);
                    (rotated[sum], rotated[term]) = (true, true);
                } else {
                    next[last[sum] as usize] = rotation.term;
                    (last[sum], count[sum], count[term]) = (last[term], all, 0);
                }
            }
            haar.heights.push(haar.rotations.len());
        }
        let (mut places, mut first_place) = (Vec::new(), vec![0]);
        for place in (0..needed.len()).filter(|&p| count[p] > 1) {
            let mut at = place as u32;
            for _ in 0..count[place] {
                places.push(at);
                at = next[at as usize];
            }
            first_place.push(places.len() as u32);
        }
        Pruned { places, first_place, haar }
    }

    /// The Haar terms of RGB coefficients, in double precision.
    pub fn terms(&self, coefficients: &[DVec3]) -> Vec<DVec3> {
        let mut values = coefficients.to_vec();
        for rotation in &self.rotations {
            let (left, right) = (values[rotation.sum as usize], values[rotation.term as usize]);
            let (c, s) = (f64::from(rotation.cosine), f64::from(rotation.sine));
            values[rotation.sum as usize] = (c * left).add(s * right);
            values[rotation.term as usize] = (s * left).sub(c * right);
        }
        values
    }
}

impl Pruned {
    /// Transforms several vectors, as [`Haar::transform`] does; twin of haar_sums.comp and haar.comp.
    pub fn transform<const WIDTH: usize>(&self, values: &mut [[f32; WIDTH]]) {
        for range in self.first_place.windows(2) {
            let places = &self.places[range[0] as usize..range[1] as usize];
            let scale = 1.0 / (places.len() as f32).sqrt();
            values[places[0] as usize] =
                std::array::from_fn(|i| scale * places.iter().map(|&p| values[p as usize][i]).sum::<f32>());
        }
        self.haar.transform(values);
    }
}

/// Adds the rotations of a node to `by_height`. Returns its sums and its height.
fn collect(first: &[u32], begin: usize, end: usize, by_height: &mut Vec<Vec<Rotation>>) -> (Sums, usize) {
    if end - begin == 1 {
        return ((first[begin]..first[end]).map(|place| (1, place)).collect(), 0);
    }
    let split = middle(begin, end);
    let (mut left, below_left) = collect(first, begin, split, by_height);
    let (mut right, below_right) = collect(first, split, end, by_height);
    let height = below_left.max(below_right);
    if by_height.len() <= height {
        by_height.resize(height + 1, Vec::new());
    }
    if left.len() < right.len() {
        // Coefficients of only one side pass through unchanged.
        left.extend(right.drain(left.len()..));
    }
    for ((count, sum), (others, term)) in left.iter_mut().zip(right) {
        let all = f64::from(*count + others);
        let [cosine, sine] = [*count, others].map(|n| (f64::from(n) / all).sqrt() as f32);
        by_height[height].push(Rotation { sum: *sum, term, cosine, sine });
        *count += others;
    }
    (left, height + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Haar terms by definition: explicit sums over samples, one term at a time.
    fn slowly(first: &[u32], values: &[f64], k: u32, begin: usize, end: usize) -> Vec<f64> {
        let with: Vec<usize> = (begin..end).filter(|&i| first[i] + k < first[i + 1]).collect();
        if end - begin == 1 || with.is_empty() {
            return Vec::new();
        }
        let split = middle(begin, end);
        let sum = |right: bool| -> (f64, f64) {
            let of_side = with.iter().filter(|&&i| (i >= split) == right);
            of_side.fold((0.0, 0.0), |(n, sum), &i| (n + 1.0, sum + values[(first[i] + k) as usize]))
        };
        let ((l, left), (r, right)) = (sum(false), sum(true));
        let mut terms = slowly(first, values, k, begin, split);
        terms.extend(slowly(first, values, k, split, end));
        if l > 0.0 && r > 0.0 {
            terms.push((left / l - right / r) * (l * r / (l + r)).sqrt());
        }
        terms
    }

    proptest! {
        #[test]
        fn terms_are_as_defined_and_keep_all_squares(
            counts in prop::collection::vec(prop::sample::select(vec![1u32, 4, 9, 16]), 1..70),
            seed in 1u64..1000,
        ) {
            let mut first = vec![0];
            counts.iter().for_each(|c| first.push(first[first.len() - 1] + c));
            let points = crate::physics::sequence::Points::new(seed, 0);
            let values: Vec<f64> = (0..first[counts.len()]).map(|i| points.at(i, 0)[0] - 0.5).collect();
            let haar = Haar::new(&first);
            let terms: Vec<f64> = haar.terms(&values.iter().map(|v| DVec3::splat(*v)).collect::<Vec<_>>())
                .iter().map(|t| t.y).collect();
            let square = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
            prop_assert!((square(&terms) - square(&values)).abs() < 1e-5 * square(&values));

            let mut want: Vec<f64> = Vec::new();
            for k in 0..*counts.iter().max().unwrap() {
                want.extend(slowly(&first, &values, k, 0, counts.len()));
                let with: Vec<f64> = (0..counts.len()).filter(|&i| first[i] + k < first[i + 1])
                    .map(|i| values[(first[i] + k) as usize]).collect();
                if !with.is_empty() {
                    want.push(with.iter().sum::<f64>() / (with.len() as f64).sqrt());
                }
            }
            let mut got = terms.clone();
            got.sort_by(f64::total_cmp);
            want.sort_by(f64::total_cmp);
            prop_assert_eq!(got.len(), want.len());
            for (got, want) in got.iter().zip(&want) {
                prop_assert!((got - want).abs() < 1e-5, "{} {}", got, want);
            }

            let mut side_by_side: Vec<[f32; 2]> = values.iter().map(|v| [*v as f32, -*v as f32]).collect();
            let some = (0..side_by_side.len() as u32).map(|i| points.at(i, 1)[0] < 0.2).collect();
            for needed in [some, vec![true; terms.len()], vec![false; terms.len()]] {
                let pruned = haar.pruned(&needed);
                let mut values = side_by_side.clone();
                pruned.transform(&mut values);
                for (place, _) in needed.iter().enumerate().filter(|n| *n.1) {
                    prop_assert!((f64::from(values[place][0]) - terms[place]).abs() < 1e-5);
                }
                let work = pruned.places.len() + 1 - pruned.first_place.len() + pruned.haar.rotations.len();
                prop_assert!(work <= haar.rotations.len() && (work == 0 || needed.contains(&true)));
            }
            haar.transform(&mut side_by_side);
            for (pair, want) in side_by_side.iter().zip(&terms) {
                prop_assert!((f64::from(pair[0]) - want).abs() < 1e-5 && pair[0] == -pair[1]);
            }
            for range in haar.heights.windows(2) {
                let mut places: Vec<u32> =
                    haar.rotations[range[0]..range[1]].iter().flat_map(|r| [r.sum, r.term]).collect();
                let count = places.len();
                places.sort_unstable();
                places.dedup();
                prop_assert_eq!(places.len(), count, "rotations of one height touch a place twice");
            }
        }
    }

    #[test]
    fn one_term_is_made_of_sums_and_what_lies_above_it() {
        let first: Vec<u32> = (0..=256).collect();
        let haar = Haar::new(&first);
        // Term 1 belongs to the lowest rotation, which separates the first two samples; term 128 to the highest, which
        // separates the halves.
        for (needed, sums, rotations) in [(1, 0, 1), (128, 8, 7)] {
            let pruned = haar.pruned(&(0..256).map(|place| place == needed).collect::<Vec<_>>());
            let mut values: Vec<[f32; 1]> = (0..256).map(|i| [(i as f32 * 0.37).sin()]).collect();
            let mut want = values.clone();
            haar.transform(&mut want);
            pruned.transform(&mut values);
            assert!((values[needed][0] - want[needed][0]).abs() < 1e-5);
            assert_eq!((pruned.first_place.len() - 1, pruned.haar.rotations.len()), (sums, rotations), "term {needed}");
        }
    }
}
