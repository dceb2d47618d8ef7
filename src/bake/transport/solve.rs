//! Solvers for all bounces: x = b + G x, for the three channels in parallel.

use faer::{Mat, MatRef};
use glam::DVec3;
use rayon::prelude::*;

use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::linear::{self, Lu};

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

/// GMRES with restarts [Saad 1986], to a relative residual of `tolerance` in every channel. For one light, and for more
/// coefficients than a [`Resolvent`] can have.
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

/// (I - G)⁻¹ = I + G + G² + ... of one channel, factorized; or its first terms, which have no factorization, where the
/// number of bounces is limited.
///
/// For many right sides, but only for few coefficients: takes n² numbers in double precision. [`solve`] reads nothing
/// but the sparse G, again for each light.
pub enum Resolvent {
    Inverse(Lu),
    /// G.
    Terms(Mat<f64>),
}

impl Resolvent {
    /// One for each channel, for all terms or for some.
    pub fn new(g: &CsrMatrix, all: bool) -> [Self; 3] {
        let of_channel = |channel: usize| {
            let g = linear::widened(g.to_dense(g.len(), channel).as_ref());
            match all {
                true => Self::Inverse(Lu::new(Mat::<f64>::identity(g.nrows(), g.nrows()) - g)),
                false => Self::Terms(g),
            }
        };
        let channels: Vec<Self> = (0..3).into_par_iter().map(of_channel).collect();
        channels.try_into().ok().expect("there are three")
    }

    /// The operator times the columns of `right`. `terms`: the number of them, where it is limited.
    pub fn times(&self, right: MatRef<'_, f32>, terms: u32) -> Mat<f64> {
        match self {
            Self::Inverse(lu) => lu.solve(right),
            Self::Terms(g) => {
                let right = linear::widened(right);
                let zero = Mat::zeros(right.nrows(), right.ncols());
                (0..terms).fold(zero, |sum, _| linear::product(g.as_ref(), sum.as_ref()) + &right)
            }
        }
    }

    /// The operator as a matrix of `n` rows. Products with it take half the time of those with the factorization, and
    /// their rounding errors are far below those of factors in half precision.
    pub fn matrix(&self, n: usize, terms: u32) -> Mat<f32> {
        let mut matrix = Mat::<f32>::identity(n, n);
        matrix.par_col_chunks_mut(COLUMNS_AT_ONCE).for_each(|mut columns| {
            let product = self.times(columns.as_ref(), terms);
            columns.copy_from(Mat::from_fn(n, product.ncols(), |i, j| product[(i, j)] as f32));
        });
        matrix
    }
}

/// Columns of [`Resolvent::matrix`] that are made together.
const COLUMNS_AT_ONCE: usize = 256;

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

    /// The resolvents of `g` times `right` times `b`.
    fn resolved(g: &CsrMatrix, terms: Option<u32>, right: &CsrMatrix, b: &[DVec3]) -> Vec<DVec3> {
        let resolvents = Resolvent::new(g, terms.is_none());
        let matrices =
            [0, 1, 2].map(|c: usize| resolvents[c].times(right.to_dense(b.len(), c).as_ref(), terms.unwrap_or(0)));
        let sum = |c: usize, i: usize| (0..b.len()).map(|j| matrices[c][(i, j)] * b[j][c]).sum::<f64>();
        (0..g.len()).map(|i| DVec3::from_array([0, 1, 2].map(|c| sum(c, i)))).collect()
    }

    #[test]
    fn the_resolvent_is_what_gmres_applies() {
        let (g, right) = (random(60, [0.999, 0.5, 0.0]), random(60, [0.7, 1.0, 0.2]));
        let b: Vec<DVec3> = (0..60).map(|i| DVec3::new((i % 7) as f64, 1.0, f64::from(i == 3))).collect();
        let solution = solve(&g, &right.multiply(&b), 1e-12);
        for (got, x) in resolved(&g, None, &right, &b).iter().zip(&solution.coefficients) {
            assert!((got - x).abs().cmplt(1e-7 * got.abs().max(DVec3::ONE)).all(), "{got} and {x}");
        }
    }

    #[test]
    fn resolvents_are_truncated_like_sums() {
        let (g, right) = (random(30, [0.9, 0.5, 0.0]), random(30, [0.7, 1.0, 0.2]));
        let b: Vec<DVec3> = (0..30).map(|i| DVec3::new((i % 7) as f64, 1.0, f64::from(i == 3))).collect();
        for terms in [0, 1, 5] {
            let want = sum_of_powers(&g, &right.multiply(&b), terms);
            for (got, want) in resolved(&g, Some(terms), &right, &b).iter().zip(&want) {
                assert!((got - want).abs().max_element() < 1e-9, "{terms} terms: {got}, {want}");
            }
        }
    }

    #[test]
    fn resolvents_as_matrices() {
        // More columns than are made together.
        let n = COLUMNS_AT_ONCE + 44;
        let (g, right) = (random(n, [0.9999, 0.5, 0.0]), random(n, [0.2; 3]));
        for terms in [None, Some(4)] {
            for (channel, resolvent) in Resolvent::new(&g, terms.is_none()).iter().enumerate() {
                let (right, terms) = (right.to_dense(n, channel), terms.unwrap_or(0));
                let want = resolvent.times(right.as_ref(), terms);
                let got = linear::product(resolvent.matrix(n, terms).as_ref(), right.as_ref());
                let error = (linear::widened(got.as_ref()) - &want).norm_max();
                assert!(error < 1e-5 * want.norm_max(), "{terms} terms, channel {channel}: {error}");
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
