//! Solvers for all bounces: x = b + G x, for the three channels in parallel.

use faer::Mat;
use faer::linalg::solvers::Solve;
use glam::DVec3;
use rayon::prelude::*;

use crate::bake::csr_matrix::CsrMatrix;

/// Steps between restarts of GMRES.
const STEPS: usize = 40;
/// Maximum number of runs of [`STEPS`] steps.
const RESTARTS: usize = 25;
/// Maximum number of steps of the power iteration.
const ITERATIONS: usize = 100;

/// A solution and its residual.
pub struct Solution {
    pub coefficients: Vec<DVec3>,
    /// |b - (I - G) x| / |b|, maximum over the channels.
    pub residual: f64,
    /// Number of applications of G.
    pub steps: usize,
}

/// GMRES with restarts [Saad 1986], to a relative residual of `tolerance` in every channel.
///
/// Each channel is an independent system. They are solved in parallel, so that G is read once for all three.
pub fn solve(g: &CsrMatrix, b: &[DVec3], tolerance: f64) -> Solution {
    let scale = norm(b);
    let inverse = reciprocal(scale);
    let mut x = b.to_vec();
    let mut steps = 0;
    for _ in 0..RESTARTS {
        let r = residual(g, b, &x);
        steps += 1;
        let size = norm(&r);
        if (size * inverse).max_element() <= tolerance {
            break;
        }
        steps += correct(g, &r, size, tolerance * scale, &mut x);
    }
    let residual = relative_residual(g, b, &x);
    Solution { coefficients: x, residual, steps }
}

/// One run of up to [`STEPS`] steps: adds to `x` the correction that minimizes the residual `r`, whose norm is `size`.
fn correct(g: &CsrMatrix, r: &[DVec3], size: DVec3, goal: DVec3, x: &mut [DVec3]) -> usize {
    let mut basis: Vec<Vec<DVec3>> = vec![r.iter().map(|r| *r * reciprocal(size)).collect()];
    let mut triangle: Vec<Vec<DVec3>> = Vec::new(); // columns of R
    let mut rotations: Vec<(DVec3, DVec3)> = Vec::new();
    let mut right = vec![size];
    for step in 0..STEPS {
        let last = &basis[step];
        let mut w: Vec<DVec3> = last.iter().zip(g.multiply(last)).map(|(v, gv)| v - gv).collect();
        let mut column = Vec::new();
        for v in &basis {
            let share = dot(v, &w);
            w.iter_mut().zip(v).for_each(|(w, v)| *w -= share * v);
            column.push(share);
        }
        let length = norm(&w);
        // Apply all previous rotations to the column, then the one that makes its last entry zero.
        for (i, (c, s)) in rotations.iter().enumerate() {
            (column[i], column[i + 1]) = (c * column[i] + s * column[i + 1], c * column[i + 1] - s * column[i]);
        }
        let diagonal = column[step];
        let radius = (diagonal * diagonal + length * length).map(f64::sqrt);
        let (c, s) = (diagonal * reciprocal(radius), length * reciprocal(radius));
        column[step] = radius;
        rotations.push((c, s));
        triangle.push(column);
        right.push(-s * right[step]);
        right[step] *= c;
        basis.push(w.into_iter().map(|w| w * reciprocal(length)).collect());
        if right[step + 1].abs().cmple(goal).all() {
            break;
        }
    }
    let count = triangle.len();
    let mut shares = vec![DVec3::ZERO; count];
    for i in (0..count).rev() {
        let known: DVec3 = (i + 1..count).map(|j| triangle[j][i] * shares[j]).sum();
        shares[i] = (right[i] - known) * reciprocal(triangle[i][i]);
    }
    for (share, v) in shares.iter().zip(&basis) {
        x.iter_mut().zip(v).for_each(|(x, v)| *x += share * v);
    }
    count
}

/// (I - G)⁻¹ `right`, or the first `terms` terms of (I + G + ...) `right`, as one dense matrix per channel. Only for
/// few coefficients: takes two n² matrices in double precision per channel. `right` has `columns` columns.
pub fn explicit(g: &CsrMatrix, right: &CsrMatrix, columns: usize, terms: Option<u32>) -> [Mat<f64>; 3] {
    let dense = |rows: &CsrMatrix, columns: usize, channel: usize| {
        let mut matrix = Mat::<f64>::zeros(rows.len(), columns);
        for r in 0..rows.len() {
            rows.row(r).for_each(|(column, value)| matrix[(r, column as usize)] += f64::from(value[channel]));
        }
        matrix
    };
    let solve = |channel: usize| {
        let (g_dense, right) = (dense(g, g.len(), channel), dense(right, columns, channel));
        match terms {
            None => (Mat::<f64>::identity(g.len(), g.len()) - g_dense).partial_piv_lu().solve(right),
            Some(terms) => (0..terms).fold(Mat::zeros(g.len(), columns), |sum, _| &g_dense * sum + &right),
        }
    };
    let channels: Vec<_> = (0..3).into_par_iter().map(solve).collect();
    channels.try_into().expect("there are three")
}

/// b + G b + ... + G^(terms - 1) b.
pub fn sum_of_powers(g: &CsrMatrix, b: &[DVec3], terms: u32) -> Vec<DVec3> {
    let mut x = vec![DVec3::ZERO; b.len()];
    for _ in 0..terms {
        x = g.multiply(&x).iter().zip(b).map(|(gx, b)| gx + b).collect();
    }
    x
}

/// The largest absolute eigenvalue of G over all channels, by power iteration from a uniform vector.
pub fn spectral_radius(g: &CsrMatrix) -> f64 {
    let mut x = vec![DVec3::ONE; g.len()];
    let mut radius = 0.0;
    for _ in 0..ITERATIONS {
        let scale = reciprocal(norm(&x));
        x.iter_mut().for_each(|x| *x *= scale);
        x = g.multiply(&x);
        let before = std::mem::replace(&mut radius, norm(&x).max_element());
        if (radius - before).abs() <= 1e-6 * radius {
            break;
        }
    }
    radius
}

/// Number of bounces after which the rest is negligible, each of which costs as much as the first; unlimited if light
/// grows.
pub fn bounces_that_matter(radius: f64) -> u32 {
    if radius < 1.0 { (NEGLIGIBLE_ENERGY.ln() / radius.ln()).ceil() as u32 + 2 } else { u32::MAX }
}

/// Share of light that remains after these bounces.
const NEGLIGIBLE_ENERGY: f64 = 1e-12;

/// |b - (I - G) x| / |b|, maximum over the channels.
pub fn relative_residual(g: &CsrMatrix, b: &[DVec3], x: &[DVec3]) -> f64 {
    (norm(&residual(g, b, x)) * reciprocal(norm(b))).max_element()
}

fn residual(g: &CsrMatrix, b: &[DVec3], x: &[DVec3]) -> Vec<DVec3> {
    g.multiply(x).iter().zip(x).zip(b).map(|((gx, x), b)| b - x + gx).collect()
}

/// 1/v, or 0 for a black channel.
fn reciprocal(v: DVec3) -> DVec3 {
    DVec3::select(v.cmpgt(DVec3::ZERO), v.recip(), DVec3::ZERO)
}

fn dot(a: &[DVec3], b: &[DVec3]) -> DVec3 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[DVec3]) -> DVec3 {
    dot(a, a).map(f64::sqrt)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::sequence::Points;

    /// Rows with random entries; those of channel c sum to `sums[c]`.
    fn random(size: usize, sums: [f32; 3]) -> CsrMatrix {
        let points = Points::new(1, 0);
        let mut g = CsrMatrix::empty(0);
        for i in 0..size as u32 {
            let entries: Vec<[f64; 4]> = (0..size as u32).map(|j| points.at(j, i)).collect();
            let total: f64 = entries.iter().map(|e| e[0]).sum();
            g.columns.extend(0..size as u32);
            g.values.extend(entries.iter().map(|e| sums.map(|sum| sum * (e[0] / total) as f32)));
            g.first.push(g.columns.len());
        }
        g
    }

    #[test]
    fn solutions_solve_and_powers_add_up_to_them() {
        let g = random(60, [0.999, 0.5, 0.0]);
        let b: Vec<DVec3> = (0..60).map(|i| DVec3::new((i % 7) as f64, 1.0, f64::from(i == 3))).collect();
        let solution = solve(&g, &b, 1e-9);
        assert!(solution.residual <= 1e-9, "residual {} after {} steps", solution.residual, solution.steps);
        assert!(residual(&g, &b, &solution.coefficients).iter().all(|r| r.abs().max_element() < 1e-6));
        let sum = sum_of_powers(&g, &b, 40);
        // The remainder is 2^-40 in green; blue has no second term.
        let errors = sum.iter().zip(&solution.coefficients).map(|(s, x)| (s - x).abs());
        errors.for_each(|e| assert!(e.y < 1e-7 && e.z < 1e-9, "{e}"));
        assert!(sum_of_powers(&g, &b, 0).iter().all(|x| *x == DVec3::ZERO));
        assert_eq!(sum_of_powers(&g, &b, 1), b);
    }

    #[test]
    fn the_explicit_matrix_is_what_gmres_applies() {
        let (g, right) = (random(60, [0.999, 0.5, 0.0]), random(60, [0.7, 1.0, 0.2]));
        let b: Vec<DVec3> = (0..60).map(|i| DVec3::new((i % 7) as f64, 1.0, f64::from(i == 3))).collect();
        let solution = solve(&g, &right.multiply(&b), 1e-12);
        let matrices = explicit(&g, &right, 60, None);
        for (i, x) in solution.coefficients.iter().enumerate() {
            for (channel, matrix) in matrices.iter().enumerate() {
                let got: f64 = (0..60).map(|j| matrix[(i, j)] * b[j][channel]).sum();
                assert!((got - x[channel]).abs() < 1e-7 * got.abs().max(1.0), "{got} and {}", x[channel]);
            }
        }
    }

    #[test]
    fn explicit_series_are_truncated_like_sums() {
        let (g, right) = (random(30, [0.9, 0.5, 0.0]), random(30, [0.7, 1.0, 0.2]));
        let b: Vec<DVec3> = (0..30).map(|i| DVec3::new((i % 7) as f64, 1.0, f64::from(i == 3))).collect();
        for terms in [0, 1, 5] {
            let want = sum_of_powers(&g, &right.multiply(&b), terms);
            let matrices = explicit(&g, &right, 30, Some(terms));
            for (i, want) in want.iter().enumerate() {
                let of_channel = |c: usize| (0..30).map(|j| matrices[c][(i, j)] * b[j][c]).sum::<f64>();
                let got = DVec3::new(of_channel(0), of_channel(1), of_channel(2));
                assert!((got - want).abs().max_element() < 1e-9, "{terms} terms: {got}, {want}");
            }
        }
    }

    #[test]
    fn darkness_stays_dark() {
        let g = random(10, [0.5; 3]);
        let solution = solve(&g, &[DVec3::ZERO; 10], 1e-9);
        assert!(solution.residual == 0.0 && solution.coefficients.iter().all(|x| *x == DVec3::ZERO));
    }

    #[test]
    fn the_spectral_radius_is_that_of_the_brightest_channel() {
        let radius = spectral_radius(&random(40, [0.2, 0.9, 0.1]));
        assert!((radius - 0.9).abs() < 1e-5, "{radius}");
    }
}
