//! Spherical harmonics, orthonormalized over one hemisphere under projected solid angle: ∫ B_i B_j cosθ dω = δ_ij.
//!
//! A function of degree l and order m is `R_lm(z) Re (x + iy)^m` or `R_lm(z) Im (x + iy)^m`. Its radial part R_lm is a
//! polynomial in z of degree l - m. The first n² functions span all polynomials of degree below n on the sphere, so a
//! smaller basis is a prefix of a larger one.

use std::sync::OnceLock;

use glam::{DVec3, Vec3};

use crate::shared::HARMONIC_DEGREES;

/// Number of degrees: the largest basis has all degrees below this.
pub const DEGREES: usize = HARMONIC_DEGREES as usize;
/// Maximum number of functions.
pub const MAX_FUNCTIONS: usize = DEGREES * DEGREES;
/// Number of radial parts: one for each degree and each order up to the degree.
pub const RADIAL_COUNT: usize = radials_of(MAX_FUNCTIONS);

/// Degree and order of each radial part; parts of equal degree are adjacent.
pub const RADIALS: [(usize, usize); RADIAL_COUNT] = {
    let mut radials = [(0, 0); RADIAL_COUNT];
    let mut i = 1;
    while i < RADIAL_COUNT {
        let (degree, order) = radials[i - 1];
        radials[i] = if order < degree { (degree, order + 1) } else { (degree + 1, 0) };
        i += 1;
    }
    radials
};

/// Number of radial parts of the first `functions` functions, which are all those below some degree.
pub const fn radials_of(functions: usize) -> usize {
    (functions + functions.isqrt()) / 2
}

/// The basis.
pub struct Harmonics {
    /// Coefficients of R_lm, ascending powers of z.
    radials: [[f64; DEGREES]; RADIAL_COUNT],
    /// The same for every function, in single precision, by power, padded with zeros.
    by_function: [[f32; MAX_FUNCTIONS.next_multiple_of(LANES)]; DEGREES],
}

/// Number of functions evaluated together.
const LANES: usize = 16;

/// Radial part of each function, its order, and whether it has the imaginary part of the azimuth.
const PARTS_OF: [(usize, u8, bool); MAX_FUNCTIONS] = {
    let mut parts = [(0, 0, false); MAX_FUNCTIONS];
    let (mut function, mut radial) = (0, 0);
    while radial < RADIAL_COUNT {
        let order = RADIALS[radial].1;
        parts[function] = (radial, order as u8, false);
        if order > 0 {
            parts[function + 1] = (radial, order as u8, true);
        }
        function += if order > 0 { 2 } else { 1 };
        radial += 1;
    }
    parts
};

impl Harmonics {
    /// The only instance, computed at first use.
    pub fn get() -> &'static Self {
        static HARMONICS: OnceLock<Harmonics> = OnceLock::new();
        HARMONICS.get_or_init(Self::new)
    }

    fn new() -> Self {
        let mut radials = [[0.0; DEGREES]; RADIAL_COUNT];
        for (i, &(degree, order)) in RADIALS.iter().enumerate() {
            let mut radial = [0.0; DEGREES];
            radial[degree - order] = 1.0;
            // Two passes suffice against loss of precision [Giraud 2005].
            for _ in 0..2 {
                for (lower, &(_, of_order)) in radials[..i].iter().zip(&RADIALS) {
                    if of_order == order {
                        let share = inner(&radial, lower, order);
                        radial.iter_mut().zip(lower).for_each(|(r, l)| *r -= share * l);
                    }
                }
            }
            let norm = inner(&radial, &radial, order).sqrt();
            radials[i] = radial.map(|r| r / norm);
        }
        let mut by_function = [[0.0; MAX_FUNCTIONS.next_multiple_of(LANES)]; DEGREES];
        for (function, (radial, ..)) in PARTS_OF.into_iter().enumerate() {
            (0..DEGREES).for_each(|power| by_function[power][function] = radials[radial][power] as f32);
        }
        Self { radials, by_function }
    }

    /// The first `values.len()` functions in a unit direction of the local frame. A direction below the horizon is
    /// projected onto the horizon.
    #[inline(always)]
    pub fn evaluate(&self, direction: Vec3, values: &mut [f32]) {
        let mut d = direction;
        if d.z < 0.0 {
            d = d.with_z(0.0).try_normalize().unwrap_or(Vec3::X);
        }
        let azimuths = azimuths(d.x, d.y);
        // By function rather than by radial part: neighbouring functions share a vector register.
        let mut start = 0;
        while start < values.len() {
            let mut sums = [0.0; LANES];
            for power in self.by_function.iter().rev() {
                for i in 0..LANES {
                    sums[i] = sums[i] * d.z + power[start + i];
                }
            }
            let end = values.len().min(start + LANES);
            for (i, value) in values[start..end].iter_mut().enumerate() {
                let (_, order, imaginary) = PARTS_OF[start + i];
                let azimuth = azimuths[order as usize];
                *value = sums[i] * if imaginary { azimuth.1 } else { azimuth.0 };
            }
            start = end;
        }
    }

    /// [`Self::evaluate`] of all functions in double precision, for directions above the horizon.
    pub fn evaluate_exactly(&self, d: DVec3) -> [f64; MAX_FUNCTIONS] {
        let mut values = [0.0; MAX_FUNCTIONS];
        let radial = |i: usize| self.radials[i].iter().rev().fold(0.0, |sum, c| sum * d.z + c);
        spread(&mut values, radial, azimuths(d.x, d.y));
        values
    }
}

/// Real and imaginary part of (x + iy)^m for every order m.
#[inline(always)]
pub fn azimuths<T>(x: T, y: T) -> [(T, T); DEGREES]
where
    T: Copy + std::ops::Mul<Output = T> + std::ops::Sub<Output = T> + std::ops::Add<Output = T> + From<u8>,
{
    let times = |(a, b): (T, T)| (a * x - b * y, a * y + b * x);
    let mut powers = [(T::from(1), T::from(0)); DEGREES];
    for m in 1..DEGREES {
        powers[m] = times(powers[m - 1]);
    }
    powers
}

/// Functions from their radial and azimuthal parts: by degree, then by order; for orders above 0 the real part first.
pub fn spread<R, A>(values: &mut [R], radial: impl Fn(usize) -> R, azimuths: [(A, A); DEGREES])
where
    A: Copy,
    R: Copy + std::ops::Mul<A, Output = R>,
{
    let mut next = 0;
    for (i, &(_, order)) in RADIALS[..radials_of(values.len())].iter().enumerate() {
        let (real, imaginary) = azimuths[order];
        let radial = radial(i);
        values[next] = radial * real;
        next += 1;
        if order > 0 {
            values[next] = radial * imaginary;
            next += 1;
        }
    }
}

/// ∫ over the hemisphere of `a b (1 - z²)^m cos²(mφ) cosθ dω`, in closed form: ∫ z^(n+1) (1 - z²)^m dz over [0, 1] is
/// m! / (2 s (s + 1) ... (s + m)) with s = (n + 2) / 2.
fn inner(a: &[f64; DEGREES], b: &[f64; DEGREES], order: usize) -> f64 {
    let around = if order == 0 { 2.0 } else { 1.0 } * std::f64::consts::PI;
    let moment = |n: usize| {
        let s = (n + 2) as f64 / 2.0;
        (0..order).fold(0.5 / s, |value, i| value * (i + 1) as f64 / (s + (i + 1) as f64))
    };
    let terms = (0..DEGREES).flat_map(|i| (0..DEGREES).map(move |j| (i, j)));
    around * terms.map(|(i, j)| a[i] * b[j] * moment(i + j)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Midpoint rule, whose error decreases with the square of its step.
    #[test]
    fn functions_are_orthonormal_under_projected_solid_angle() {
        let (heights, around) = (4000, 32);
        let mut gram = [[0.0; MAX_FUNCTIONS]; MAX_FUNCTIONS];
        for i in 0..heights * around {
            let z = ((i / around) as f64 + 0.5) / heights as f64;
            let (sine, cosine) = ((i % around) as f64 * std::f64::consts::TAU / around as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let values = Harmonics::get().evaluate_exactly(DVec3::new(r * cosine, r * sine, z));
            for (a, row) in values.iter().zip(&mut gram) {
                for (b, sum) in values.iter().zip(row) {
                    *sum += a * b * z * std::f64::consts::TAU / (heights * around) as f64;
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                let want = if i == j { 1.0 } else { 0.0 };
                assert!((value - want).abs() < 1e-4, "<B_{i}, B_{j}> = {value}");
            }
        }
    }

    #[test]
    fn single_precision_agrees_and_stays_at_the_horizon_below_it() {
        for direction in [Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.48, 0.6, 0.64), Vec3::new(0.6, -0.8, 0.0)] {
            let exact = Harmonics::get().evaluate_exactly(direction.as_dvec3());
            for count in [1, 4, 9, 16] {
                let mut values = [0.0; MAX_FUNCTIONS];
                Harmonics::get().evaluate(direction, &mut values[..count]);
                for (i, (value, exact)) in values[..count].iter().zip(exact).enumerate() {
                    assert!((f64::from(*value) - exact).abs() < 1e-5, "B_{i} at {direction}: {value}, {exact}");
                }
            }
        }
        let (mut below, mut at) = ([0.0; 9], [0.0; 9]);
        Harmonics::get().evaluate(Vec3::new(0.48, -0.64, -0.6), &mut below);
        Harmonics::get().evaluate(Vec3::new(0.6, -0.8, 0.0), &mut at);
        assert!(below.iter().zip(at).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}
