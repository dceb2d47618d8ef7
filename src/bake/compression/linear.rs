//! Dense linear algebra on one thread, so that results do not depend on how many there are.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::lu::partial_pivoting::{factor, inverse};
use faer::{Accum, Mat, MatMut, MatRef, Par};

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

/// Eigenvalues of a symmetric matrix, largest first, none below zero, and their vectors as columns.
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

/// The inverse by LU, in single precision once it is found.
pub fn inverse_of(mut matrix: Mat<f64>) -> Mat<f32> {
    let n = matrix.nrows();
    let (mut order, mut back) = (vec![0usize; n], vec![0usize; n]);
    let scratch = factor::lu_in_place_scratch::<usize, f64>(n, n, Par::Seq, Default::default())
        .or(inverse::inverse_scratch::<usize, f64>(n, Par::Seq));
    let mut memory = MemBuffer::new(scratch);
    let stack = MemStack::new(&mut memory);
    let (_, rows) = factor::lu_in_place(matrix.as_mut(), &mut order, &mut back, Par::Seq, stack, Default::default());
    let mut inverted = Mat::<f64>::zeros(n, n);
    inverse::inverse(inverted.as_mut(), matrix.as_ref(), matrix.as_ref(), rows, Par::Seq, stack);
    Mat::from_fn(n, n, |i, j| inverted[(i, j)] as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::Points;

    #[test]
    fn inverses_and_eigenvectors() {
        let n = 70;
        let points = Points::new(1, 0);
        let random = Mat::from_fn(n, n, |i, j| points.at(i as u32, j as u32)[0] - 0.5);
        let inverted = inverse_of(random.clone());
        let inverted = Mat::from_fn(n, n, |i, j| f64::from(inverted[(i, j)]));
        let identity = product(random.as_ref(), inverted.as_ref());
        let off = |i: usize, j: usize| (identity[(i, j)] - f64::from(u8::from(i == j))).abs();
        assert!((0..n).all(|i| (0..n).all(|j| off(i, j) < 1e-4)));

        let gram = product(random.transpose(), random.as_ref());
        let (values, vectors) = eigen(&gram);
        let turned = product(gram.as_ref(), vectors.as_ref());
        for j in 0..n {
            assert!(j == 0 || values[j] <= values[j - 1]);
            (0..n).for_each(|i| assert!((turned[(i, j)] - values[j] * vectors[(i, j)]).abs() < 1e-10));
        }
    }
}
