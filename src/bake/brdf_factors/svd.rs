//! BRDF factorization by singular values, as published [Yang 2007, Section 4.4; Kautz 1999].
//!
//! f is tabulated for all pairs of 812 directions: the texels of a 32x32 map of the disc that directions project to
//! [Yang 2007, Figure 4.2 b]. The largest singular values and their vectors, M ≈ (U Σ^½)(V Σ^½)ᵀ, give h and k at the
//! texels, with interpolation between them. This is optimal in the cosine-weighted mean square for a given number of
//! terms. However, grazing peaks dominate that norm, and truncation adds energy.

use faer::Mat;
use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use crate::physics::brdf::f;
use crate::shared::{Brdf, DISC_SIDE};

/// Texels along each side of the map.
const SIDE: usize = DISC_SIDE as usize;
/// Number of texels whose centre lies on the disc.
pub const DIRECTIONS: usize = 812;

/// Number of terms of a BRDF.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub enum Terms {
    Count(usize),
    /// The fewest terms with at most this relative error, root mean square over all pairs of directions and RGB.
    Error(f64),
}

/// h and k of one BRDF, separate for each channel.
pub struct Factors {
    /// δ, the number of terms.
    pub terms: usize,
    /// [texel][term], RGB.
    h: Vec<Vec3>,
    k: Vec<Vec3>,
    /// Relative error of the truncated sum, root mean square.
    pub error: f64,
}

impl Factors {
    pub fn new(brdf: &Brdf, terms: Terms) -> Self {
        let directions = directions();
        let table: Vec<DVec3> =
            directions.par_iter().flat_map_iter(|wo| directions.iter().map(|wi| f(brdf, DVec3::Z, *wi, *wo))).collect();
        let channel = |c: usize| {
            let matrix = Mat::from_fn(DIRECTIONS, DIRECTIONS, |o, i| table[o * DIRECTIONS + i][c]);
            matrix.thin_svd().expect("the BRDF is finite")
        };
        let grey = table.iter().all(|f| f.x == f.y && f.x == f.z);
        let channels: Vec<_> = if grey { vec![channel(0)] } else { (0..3).map(channel).collect() };
        let of = |c: usize| &channels[c.min(channels.len() - 1)];
        let singular = |c: usize, i: usize| of(c).S().column_vector()[i];
        let squares = |from: usize| -> f64 {
            (0..3).flat_map(|c| (from..DIRECTIONS).map(move |i| (c, i))).map(|(c, i)| singular(c, i).powi(2)).sum()
        };
        let all = squares(0);
        let error = |terms: usize| if all > 0.0 { (squares(terms) / all).sqrt() } else { 0.0 };
        let terms = match terms {
            Terms::Count(count) => count.clamp(1, DIRECTIONS),
            Terms::Error(goal) => (1..DIRECTIONS).find(|&count| error(count) <= goal).unwrap_or(DIRECTIONS),
        };
        let factor = |left: bool| -> Vec<Vec3> {
            let entry = |texel: usize, term: usize| {
                let of_channel = |c: usize| {
                    let vectors = if left { of(c).U() } else { of(c).V() };
                    (vectors[(texel, term)] * singular(c, term).sqrt()) as f32
                };
                Vec3::new(of_channel(0), of_channel(1), of_channel(2))
            };
            (0..DIRECTIONS)
                .flat_map(|texel| (0..terms).map(move |term| (texel, term)))
                .map(|(t, i)| entry(t, i))
                .collect()
        };
        Self { terms, h: factor(true), k: factor(false), error: error(terms) }
    }

    /// h in a unit direction of the local frame.
    pub fn h(&self, wo: Vec3, values: &mut [Vec3]) {
        self.interpolate(&self.h, wo, values);
    }

    /// k in a unit direction of the local frame.
    pub fn k(&self, wi: Vec3, values: &mut [Vec3]) {
        self.interpolate(&self.k, wi, values);
    }

    /// k over the square around the disc, `[texel][term]`: RGB and 1, or 0 outside the disc.
    pub fn k_map(&self) -> Vec<Vec4> {
        let of_texel = |texel: &Option<u32>| match texel {
            Some(texel) => self.k[*texel as usize * self.terms..][..self.terms].iter().map(|k| k.extend(1.0)).collect(),
            None => vec![Vec4::ZERO; self.terms],
        };
        texels().iter().flat_map(of_texel).collect()
    }

    /// Bilinear interpolation between the four nearest texels, excluding those outside the disc.
    fn interpolate(&self, table: &[Vec3], direction: Vec3, values: &mut [Vec3]) {
        values.fill(Vec3::ZERO);
        let texels = texels();
        let place = |x: f32| ((x + 1.0) * 0.5 * SIDE as f32 - 0.5).clamp(0.0, (SIDE - 1) as f32);
        let (x, y) = (place(direction.x), place(direction.y));
        let (column, row) = ((x as usize).min(SIDE - 2), (y as usize).min(SIDE - 2));
        let (u, v) = (x - column as f32, y - row as f32);
        let mut sum = 0.0;
        for (dx, dy, weight) in
            [(0, 0, (1.0 - u) * (1.0 - v)), (1, 0, u * (1.0 - v)), (0, 1, (1.0 - u) * v), (1, 1, u * v)]
        {
            if let Some(texel) = texels[(row + dy) * SIDE + column + dx] {
                sum += weight;
                let entries = &table[texel as usize * self.terms..][..self.terms];
                values.iter_mut().zip(entries).for_each(|(value, entry)| *value += weight * entry);
            }
        }
        if sum > 0.0 {
            values.iter_mut().for_each(|value| *value /= sum);
        }
    }
}

/// Unit directions of the texels, in the local frame.
pub fn directions() -> Vec<DVec3> {
    let middle = |i: usize| (i as f64 + 0.5) / SIDE as f64 * 2.0 - 1.0;
    let all = (0..SIDE * SIDE).map(|i| (middle(i % SIDE), middle(i / SIDE)));
    let on_disc = all.filter(|(x, y)| x * x + y * y < 1.0);
    on_disc.map(|(x, y)| DVec3::new(x, y, (1.0 - x * x - y * y).sqrt())).collect()
}

/// Index of the direction of each texel of the square map.
fn texels() -> &'static [Option<u32>] {
    static TEXELS: std::sync::OnceLock<Vec<Option<u32>>> = std::sync::OnceLock::new();
    TEXELS.get_or_init(|| {
        let middle = |i: usize| (i as f64 + 0.5) / SIDE as f64 * 2.0 - 1.0;
        let mut count = 0;
        (0..SIDE * SIDE)
            .map(|i| {
                let inside = middle(i % SIDE).powi(2) + middle(i / SIDE).powi(2) < 1.0;
                count += u32::from(inside);
                inside.then(|| count - 1)
            })
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metal(roughness: f32) -> Brdf {
        Brdf {
            diffuse: Vec3::ZERO,
            alpha: roughness * roughness,
            f0: Vec3::new(0.9, 0.8, 0.4),
            f90: 1.0,
            dielectric_f0: 0.0,
            dielectric_f90: 0.0,
        }
    }

    #[test]
    fn the_map_has_812_directions() {
        assert_eq!(directions().len(), DIRECTIONS);
    }

    /// One term is exact for a constant BRDF.
    #[test]
    fn lambert_has_rank_one() {
        let lambert = Brdf { diffuse: Vec3::new(0.7, 0.5, 0.2), alpha: 0.0, f0: Vec3::ZERO, f90: 0.0, ..metal(1.0) };
        let factors = Factors::new(&lambert, Terms::Error(1e-6));
        assert_eq!(factors.terms, 1);
        let (mut h, mut k) = ([Vec3::ZERO], [Vec3::ZERO]);
        factors.h(Vec3::new(0.3, -0.5, 0.8).normalize(), &mut h);
        factors.k(Vec3::new(-0.9, 0.1, 0.2).normalize(), &mut k);
        assert!((h[0] * k[0] * std::f32::consts::PI - lambert.diffuse).abs().max_element() < 1e-5, "{}", h[0] * k[0]);
    }

    /// At the texels h · k equals f up to the reported error.
    #[test]
    fn terms_add_up_to_the_brdf() {
        let brdf = metal(0.8);
        let factors = Factors::new(&brdf, Terms::Count(40));
        let directions = directions();
        let (mut error, mut norm) = (0.0, 0.0);
        let (mut h, mut k) = (vec![Vec3::ZERO; 40], vec![Vec3::ZERO; 40]);
        for wo in directions.iter().step_by(7) {
            factors.h(wo.as_vec3(), &mut h);
            for wi in directions.iter().step_by(5) {
                factors.k(wi.as_vec3(), &mut k);
                let got: Vec3 = h.iter().zip(&k).map(|(h, k)| *h * *k).sum();
                let want = f(&brdf, DVec3::Z, *wi, *wo);
                error += (got.as_dvec3() - want).length_squared();
                norm += want.length_squared();
            }
        }
        let got = (error / norm).sqrt();
        assert!(got < 2.0 * factors.error && factors.error < 0.1, "{got}, reported {}", factors.error);
    }
}
