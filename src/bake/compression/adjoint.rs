//! Products of Tᵀ with the vectors of a supercluster's basis, in Haar terms.
//!
//! T = Φ_f + Φ_c S. Each vector is multiplied by Φᵀ separately. Light after further bounces is smooth, so Sᵀ multiplies
//! only a few combinations of the vectors.

use faer::{Mat, MatRef};
use rayon::prelude::*;

use super::inputs::Inputs;
use super::terms::cut;
use super::transposed::{Rounded, Transposed};
use super::vector_batch::{self, Panel, VectorBatch, WIDTH};
use crate::bake::linear;
use crate::physics::sequence::Points;

/// Tᵀ, restricted to the rows of a supercluster.
pub struct Adjoint<'a> {
    pub inputs: &'a Inputs,
    pub rows: &'a Transposed<Rounded>,
}

impl Adjoint<'_> {
    /// Significant Haar terms, ascending, and their products with the vectors of `basis`. The squares of the omitted
    /// terms sum to about `negligible`. The squared error of light after further bounces is about as much at most.
    pub fn terms(&self, basis: MatRef<f64>, negligible: f64) -> (Vec<u32>, VectorBatch) {
        let Inputs { bounces, haar, .. } = self.inputs;
        // One for all panels: it is large.
        let mut sums = VectorBatch::zeros(self.rows.columns, basis.ncols().min(WIDTH));
        let one_panel = basis.ncols() <= WIDTH;
        match one_panel {
            true => self.gather(basis, &mut sums),
            false => self.gather(random_sums(basis).as_ref(), &mut sums),
        }
        bounces.to_terms(haar, &mut sums);
        let list = self.significant(&sums, negligible);
        let empty = || VectorBatch { count: basis.ncols(), ..Default::default() };
        let (mut found, mut further) = (empty(), empty());
        if one_panel {
            push(&mut found, &sums, |panel| listed(panel, &list));
            return (list, found);
        }
        for first in (0..basis.ncols()).step_by(WIDTH) {
            self.gather(basis.subcols(first, WIDTH.min(basis.ncols() - first)), &mut sums);
            if bounces.has_two_levels() {
                push(&mut further, &sums, |panel| bounces.further(panel).into());
                bounces.to_direct_terms(haar, &mut sums);
            } else {
                bounces.to_terms(haar, &mut sums);
            }
            push(&mut found, &sums, |panel| listed(panel, &list));
        }
        if !bounces.has_two_levels() {
            return (list, found);
        }
        let mixtures = self.mixtures(&further, negligible);
        for first in (0..mixtures.ncols()).step_by(WIDTH) {
            let mixtures = mixtures.subcols(first, WIDTH.min(mixtures.ncols() - first));
            sums.clear();
            bounces.add_further(&combined(&further, mixtures), &mut sums);
            for (found, sums) in found.channels.iter_mut().zip(&sums.channels) {
                let terms = listed(&sums[0], &list);
                let terms = vector_batch::matrix(&terms).subcols(0, mixtures.ncols());
                for (number, found) in found.iter_mut().enumerate() {
                    let vectors = number * WIDTH..mixtures.nrows().min((number + 1) * WIDTH);
                    let shares = mixtures.subrows(vectors.start, vectors.len());
                    let found = vector_batch::matrix_mut(found).subcols_mut(0, vectors.len());
                    linear::add_product(found, terms, shares.transpose());
                }
            }
        }
        (list, found)
    }

    /// Φᵀ `vectors`, at most a panel of them.
    fn gather(&self, vectors: MatRef<f64>, sums: &mut VectorBatch) {
        let row = |i: usize| std::array::from_fn(|j| if j < vectors.ncols() { vectors[(i, j)] as f32 } else { 0.0 });
        let panel: Panel = (0..vectors.nrows()).into_par_iter().map(row).collect();
        sums.clear();
        self.rows.add_product([std::slice::from_ref(&panel); 3], sums);
    }

    /// The terms whose products with light are not negligible, ascending.
    fn significant(&self, sums: &VectorBatch, negligible: f64) -> Vec<u32> {
        let power = &self.inputs.power;
        let mut squares = vec![0.0f64; power[0].len()];
        for (channel, power) in power.iter().enumerate() {
            let of_channel = sums.row_squares(channel).into_iter().zip(power);
            squares.iter_mut().zip(of_channel).for_each(|(all, (x, power))| *all += f64::from(x * power));
        }
        let mut list: Vec<u32> = (0..squares.len() as u32).collect();
        let square = |j: &u32| squares[*j as usize];
        list.sort_unstable_by(|a, b| square(b).total_cmp(&square(a)).then(a.cmp(b)));
        list.truncate(cut(list.iter().map(square), negligible));
        list.sort_unstable();
        list
    }

    /// The fewest orthonormal combinations of the vectors such that light after further bounces has squares of at most
    /// `negligible` outside their span: vectors x combinations. `further` has what multiplies such light, of each
    /// vector.
    fn mixtures(&self, further: &VectorBatch, negligible: f64) -> Mat<f32> {
        let Inputs { bounces, combinations, .. } = self.inputs;
        let mut gram = Mat::<f64>::zeros(further.count, further.count);
        for (further, lights) in further.channels.iter().zip(&combinations.channels) {
            for lights in lights {
                let lights = vector_batch::matrix(bounces.further(lights));
                let of_panel = |panel: &Panel| linear::product(lights.transpose(), vector_batch::matrix(panel));
                let seen: Vec<Mat<f32>> = further.iter().map(of_panel).collect();
                let seen = Mat::from_fn(WIDTH, gram.ncols(), |l, j| f64::from(seen[j / WIDTH][(l, j % WIDTH)]));
                gram += linear::product(seen.transpose(), seen.as_ref());
            }
        }
        let (squares, vectors) = linear::eigen(&gram);
        let count = cut(squares.iter().copied(), negligible);
        Mat::from_fn(vectors.nrows(), count, |i, j| vectors[(i, j)] as f32)
    }
}

/// Sums of all vectors with random signs, whose mean square equals the sum of the vectors' squares.
fn random_sums(vectors: MatRef<f64>) -> Mat<f64> {
    let points = Points::new(0, 0);
    let sign = |vector: usize, sum: usize| if points.at(vector as u32, sum as u32)[0] < 0.5 { 1.0 } else { -1.0 };
    let signs = Mat::from_fn(vectors.ncols(), WIDTH, |vector, sum| sign(vector, sum) / (WIDTH as f64).sqrt());
    linear::product(vectors, signs.as_ref())
}

/// The rows of a panel that `list` names.
fn listed(panel: &[[f32; WIDTH]], list: &[u32]) -> Panel {
    list.iter().map(|&j| panel[j as usize]).collect()
}

/// Appends what `make` makes of the only panel of each channel, if there is one.
fn push(all: &mut VectorBatch, one: &VectorBatch, make: impl Fn(&Panel) -> Panel) {
    all.channels.iter_mut().zip(&one.channels).for_each(|(all, one)| all.extend(one.first().map(&make)));
}

/// Combinations of vectors, at most a panel of them. `shares`: vectors x combinations.
fn combined(vectors: &VectorBatch, shares: MatRef<f32>) -> VectorBatch {
    let mut all = VectorBatch::zeros(vectors.rows(), shares.ncols());
    for (all, panels) in all.channels.iter_mut().zip(&vectors.channels) {
        for (number, panel) in panels.iter().enumerate() {
            let some = number * WIDTH..shares.nrows().min((number + 1) * WIDTH);
            let shares = shares.subrows(some.start, some.len());
            let all = vector_batch::matrix_mut(&mut all[0]).subcols_mut(0, shares.ncols());
            linear::add_product(all, vector_batch::matrix(panel).subcols(0, some.len()), shares);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows without light have a basis without vectors.
    #[test]
    fn no_panel_is_none() {
        let (mut all, none) = (VectorBatch::default(), VectorBatch::zeros(5, 0));
        push(&mut all, &none, |panel| listed(panel, &[1, 4]));
        assert!(all.channels.iter().all(Vec::is_empty));
        assert_eq!(random_sums(Mat::zeros(7, 0).as_ref()), Mat::<f64>::zeros(7, WIDTH));
    }

    #[test]
    fn combinations_are_sums_of_vectors() {
        let count = WIDTH + 3;
        let vectors = VectorBatch::from_fn(4, count, |c, i, j| (c * 1000 + i * 100 + j) as f32);
        let shares = Mat::from_fn(count, 2, |j, k| if j == 0 || j == WIDTH + k { 1.0 } else { 0.0 });
        let sums = combined(&vectors, shares.as_ref());
        for (channel, row, k) in [(0, 0, 0), (2, 3, 1)] {
            let want = vectors.get(channel, row, 0) + vectors.get(channel, row, WIDTH + k);
            assert_eq!(sums.get(channel, row, k), want);
        }
    }
}
