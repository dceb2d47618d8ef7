//! Dense linear algebra on one thread, so that results do not depend on the number of threads.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::lu::partial_pivoting::{factor, solve};
use faer::perm::PermRef;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use serde::{Deserialize, Serialize};

use crate::storage::pods;

/// `target += left * right`.
pub fn add_product(target: MatMut<'_, f32>, left: MatRef<'_, f32>, right: MatRef<'_, f32>) {
    faer::linalg::matmul::matmul(target, Accum::Add, left, right, 1.0, Par::Seq);
}

/// left * right.
pub fn product<T: faer::traits::ComplexField>(left: MatRef<'_, T>, right: MatRef<'_, T>) -> Mat<T> {
    let mut product = Mat::zeros(left.nrows(), right.ncols());
    faer::linalg::matmul::matmul(product.as_mut(), Accum::Replace, left, right, T::one_impl(), Par::Seq);
    product
}

/// The same matrix in double precision.
pub fn widened(matrix: MatRef<'_, f32>) -> Mat<f64> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| f64::from(matrix[(i, j)]))
}

/// A square matrix in a file: its elements, column by column.
#[derive(Serialize, Deserialize)]
pub struct Square {
    size: usize,
    #[serde(with = "pods")]
    elements: Vec<f32>,
}

impl Square {
    pub fn of(matrix: &Mat<f32>) -> Self {
        let elements = matrix.col_iter().flat_map(|column| column.iter().copied()).collect();
        Self { size: matrix.ncols(), elements }
    }

    pub fn restore(self) -> Mat<f32> {
        MatRef::from_column_major_slice(&self.elements, self.size, self.size).to_owned()
    }
}

/// Eigenvalues of a symmetric matrix in descending order, clamped to 0 from below, and their vectors as columns.
pub fn eigen(matrix: &Mat<f64>) -> (Vec<f64>, Mat<f64>) {
    let n = matrix.nrows();
    let (mut values, mut vectors) = (Diag::zeros(n), Mat::zeros(n, n));
    let scratch = self_adjoint_evd_scratch::<f64>(n, ComputeEigenvectors::Yes, Par::Seq, Default::default());
    let mut memory = MemBuffer::new(scratch);
    self_adjoint_evd(
        matrix.as_ref(),
        values.as_mut(),
        Some(vectors.as_mut()),
        Par::Seq,
        MemStack::new(&mut memory),
        Default::default(),
    )
    .expect("the matrix is finite");
    let descending = values.column_vector().iter().rev().map(|v| v.max(0.0)).collect();
    (descending, Mat::from_fn(n, n, |i, j| vectors[(i, n - 1 - j)]))
}

/// Eigenvalues below this share of the largest are indistinguishable from zero in single precision.
pub const CERTAIN: f64 = 1e-12;

/// An orthonormal basis of the span of a tall matrix's columns, ordered by decreasing energy; and the sum of their
/// squares.
pub fn orthonormal(columns: &Mat<f64>) -> (Mat<f64>, f64) {
    let (values, vectors) = eigen(&product(columns.transpose(), columns.as_ref()));
    let certain = values.iter().take_while(|v| **v > CERTAIN * values[0]).count();
    let scaled = Mat::from_fn(columns.ncols(), certain, |i, j| vectors[(i, j)] / values[j].sqrt());
    (product(columns.as_ref(), scaled.as_ref()), values.iter().sum())
}

/// LU factorization of a square matrix.
pub struct Lu {
    factors: Mat<f64>,
    order: Vec<usize>,
    back: Vec<usize>,
}

impl Lu {
    pub fn new(mut matrix: Mat<f64>) -> Self {
        let n = matrix.nrows();
        let (mut order, mut back) = (vec![0; n], vec![0; n]);
        let scratch = factor::lu_in_place_scratch::<usize, f64>(n, n, Par::Seq, Default::default());
        let stack = &mut MemBuffer::new(scratch);
        let stack = MemStack::new(stack);
        factor::lu_in_place(matrix.as_mut(), &mut order, &mut back, Par::Seq, stack, Default::default());
        Self { factors: matrix, order, back }
    }

    /// Solves for the columns of `right`.
    pub fn solve(&self, right: MatRef<'_, f32>) -> Mat<f64> {
        let n = right.nrows();
        let rows = PermRef::new_checked(&self.order, &self.back, n);
        let mut solution = widened(right);
        let scratch = solve::solve_in_place_scratch::<usize, f64>(n, right.ncols(), Par::Seq);
        let stack = &mut MemBuffer::new(scratch);
        let lu = self.factors.as_ref();
        solve::solve_in_place(lu, lu, rows, solution.as_mut(), Par::Seq, MemStack::new(stack));
        solution
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::sequence::Points;

    #[test]
    fn solutions_and_eigenvectors() {
        let n = 70;
        let points = Points::new(1, 0);
        let random = Mat::from_fn(n, n, |i, j| points.at(i as u32, j as u32)[0] - 0.5);
        let lu = Lu::new(random.clone());
        let right = Mat::from_fn(n, 3, |i, j| points.at(i as u32, 100 + j as u32)[0] as f32);
        let got = product(random.as_ref(), lu.solve(right.as_ref()).as_ref());
        assert!((0..n).all(|i| (0..3).all(|j| (got[(i, j)] - f64::from(right[(i, j)])).abs() < 1e-10)));

        let gram = product(random.transpose(), random.as_ref());
        let (values, vectors) = eigen(&gram);
        let turned = product(gram.as_ref(), vectors.as_ref());
        for j in 0..n {
            assert!(j == 0 || values[j] <= values[j - 1]);
            (0..n).for_each(|i| assert!((turned[(i, j)] - values[j] * vectors[(i, j)]).abs() < 1e-10));
        }
    }
}
