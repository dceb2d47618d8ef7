//! Directions for gathering at a view sample, drawn from its BRDF in SIMD batches: [`crate::physics::brdf::Lobes`] in
//! single precision.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;
use pulp::{Simd, WithSimd};

use crate::physics::sequence::{BLOCK, SharedPoints};
use crate::shared::Brdf;

/// The lobes of a view sample that reflect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Lobe {
    All,
    /// For the pass `indirect_glossy`.
    Specular,
}

/// Directions in the frame of a view sample, where the eye has y = 0 and x >= 0.
#[derive(Default)]
pub struct Directions {
    blocks: Vec<Block>,
}

/// A block of directions, by component.
#[derive(Clone, Copy, Default)]
pub struct Block {
    wi: [[f32; BLOCK]; 3],
    weights: [[f32; BLOCK]; 3],
}

impl Directions {
    /// Draws one direction for each of `points`. `cosine` is n.wo, and `specular` the share of directions from the
    /// specular lobe, [`crate::physics::brdf::Lobes::specular_share`].
    pub fn draw(
        &mut self,
        brdf: &Brdf,
        (cosine, specular): (f32, f32),
        lobe: Lobe,
        points: &SharedPoints,
        shifts: [u32; 3],
    ) {
        let eye = Eye::new(brdf, (cosine, specular), lobe, points.len());
        let count = points.len();
        self.blocks.resize(count.div_ceil(BLOCK), Block::default());
        pulp::Arch::new().dispatch(Draw { eye, points, shifts, directions: self });
        let spare = self.blocks.len() * BLOCK - count;
        if let Some(last) = self.blocks.last_mut() {
            last.weights.iter_mut().for_each(|weights| weights[BLOCK - spare..].fill(0.0));
        }
    }

    /// Blocks of directions; unused entries of the last block have weight 0.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }
}

impl Block {
    /// A direction of about unit length, and its RGB weight: BRDF times cosine over the density and over the number of
    /// directions. Weights sum to the albedo; they are 0 below the horizon.
    #[inline(always)]
    pub fn get(&self, i: usize) -> (Vec3, Vec3) {
        let at = |v: &[[f32; BLOCK]; 3]| Vec3::new(v[0][i], v[1][i], v[2][i]);
        (at(&self.wi), at(&self.weights))
    }
}

struct Draw<'a> {
    eye: Eye,
    points: &'a SharedPoints,
    shifts: [u32; 3],
    directions: &'a mut Directions,
}

impl WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { eye, points, shifts, directions } = self;
        for (block, [u, v, w]) in directions.blocks.iter_mut().zip(points.blocks(shifts)) {
            // Simple enough for the compiler to vectorize.
            for i in 0..BLOCK {
                let wi = eye.sample([u[i], v[i], w[i]]);
                let weight = eye.weight(wi);
                (0..3).for_each(|c| block.wi[c][i] = wi[c]);
                (0..3).for_each(|c| block.weights[c][i] = weight[c]);
            }
        }
    }
}

/// A BRDF with a fixed direction to the eye.
#[derive(Clone, Copy)]
struct Eye {
    alpha: f32,
    /// Sine and cosine of the eye's direction.
    wo: [f32; 2],
    /// The same after stretching to the hemisphere configuration (alpha = 1).
    stretched: [f32; 2],
    /// Share of directions drawn from the specular lobe.
    specular: f32,
    /// Masking of the eye's direction, lambda [Heitz 2014, Eq. 72].
    masked: f32,
    /// Factor 1/(2 (n.wo + root)) of the density of visible normals.
    visible: f32,
    /// Divided by pi and by the number of directions.
    diffuse: [f32; 3],
    dielectric_f0: f32,
    dielectric_rise: f32,
    f0: [f32; 3],
    rise: [f32; 3],
}

/// As in [`crate::physics::brdf`].
const MIN_COSINE: f32 = 1e-6;

impl Eye {
    fn new(brdf: &Brdf, (cosine, specular): (f32, f32), lobe: Lobe, count: usize) -> Self {
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let length = (brdf.alpha * sine).hypot(cosine);
        let share = 1.0 / count as f32;
        let diffuse = if lobe == Lobe::All { brdf.diffuse * (FRAC_1_PI * share) } else { Vec3::ZERO };
        let lobe = if brdf.has_lobe() { share } else { 0.0 };
        Self {
            // Never 0; a BRDF without a lobe has no specular reflectance here either.
            alpha: brdf.alpha.max(1e-12),
            wo: [sine, cosine],
            stretched: [brdf.alpha * sine / length, cosine / length],
            specular,
            masked: lambda(brdf.alpha, cosine.max(MIN_COSINE)),
            visible: 0.5 / (cosine + length),
            diffuse: diffuse.to_array(),
            dielectric_f0: brdf.dielectric_f0,
            dielectric_rise: brdf.dielectric_f90 - brdf.dielectric_f0,
            f0: (brdf.f0 * lobe).to_array(),
            rise: ((Vec3::splat(brdf.f90) - brdf.f0) * lobe).to_array(),
        }
    }

    /// [`crate::physics::brdf::Lobes::sample`].
    #[inline(always)]
    fn sample(&self, [u, v, w]: [f32; 3]) -> [f32; 3] {
        let (sine, cosine) = sin_cos_of_turns(u);
        let z = (1.0 - v) * (1.0 + self.stretched[1]) - self.stretched[1];
        let specular = w < self.specular;
        // A point of the spherical cap around the stretched eye direction, or of the disc below the hemisphere.
        let r = if specular { (1.0 - z * z).max(0.0) } else { v }.sqrt();
        let (x, y) = (r * cosine, r * sine);
        let up = if specular { (z + self.stretched[1]).max(0.0) } else { (1.0 - v).sqrt() };
        let (hx, hy) = (self.alpha * (x + self.stretched[0]), self.alpha * y);
        let length = (hx * hx + hy * hy + up * up).max(f32::MIN_POSITIVE).sqrt();
        let (hx, hy, hz) = (hx / length, hy / length, up / length);
        let twice = 2.0 * (self.wo[0] * hx + self.wo[1] * hz);
        let mirrored = [twice * hx - self.wo[0], twice * hy, twice * hz - self.wo[1]];
        if specular { mirrored } else { [x, y, up] }
    }

    /// BRDF times cosine over the density: [`crate::physics::brdf::Lobes::at`]. Zero below the horizon.
    #[inline(always)]
    fn weight(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let (hx, hy, hz) = (x + self.wo[0], y, z + self.wo[1]);
        let length2 = (hx * hx + hy * hy + hz * hz).max(f32::MIN_POSITIVE);
        let oh = ((self.wo[0] * hx + self.wo[1] * hz) / length2.sqrt()).clamp(0.0, 1.0);
        let (nh2, sine2) = (hz * hz / length2, (hx * hx + hy * hy) / length2);
        let miss = 1.0 - oh;
        let schlick = miss * miss * (miss * miss) * miss;
        let ni = z.max(MIN_COSINE);
        let slope = self.alpha / (self.alpha * self.alpha * nh2 + sine2);
        let half_vector_density = slope * slope * FRAC_1_PI;
        // The cosine at `ni` cancels.
        let masking = 0.25 / ((1.0 + lambda(self.alpha, ni) + self.masked) * self.wo[1].max(MIN_COSINE));
        let density = (1.0 - self.specular) * z * FRAC_1_PI + self.specular * (half_vector_density * self.visible);
        let inverse = if z > 0.0 && density > 0.0 { 1.0 / density } else { 0.0 };
        let diffuse = (1.0 - (self.dielectric_f0 + self.dielectric_rise * schlick)) * z * inverse;
        let specular = half_vector_density * masking * inverse;
        [0, 1, 2].map(|c| self.diffuse[c] * diffuse + (self.f0[c] + self.rise[c] * schlick) * specular)
    }
}

#[inline(always)]
fn lambda(alpha: f32, cosine: f32) -> f32 {
    0.5 * ((1.0 + alpha * alpha * (1.0 / (cosine * cosine) - 1.0)).max(0.0).sqrt() - 1.0)
}

/// Sine and cosine of `u` turns, 0 to 1, accurate to 2e-7: a series at half the angle, then doubled.
#[inline(always)]
fn sin_cos_of_turns(u: f32) -> (f32, f32) {
    let a = (u - 0.5) * PI;
    let b = a * a;
    let series = |c: [f32; 6]| c.iter().rev().fold(0.0, |sum, c| sum * b + c);
    let sine = a * series([1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0]);
    let cosine =
        1.0 + b * series([-0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0, -1.0 / 3_628_800.0, 1.0 / 479_001_600.0]);
    (-2.0 * sine * cosine, sine * sine - cosine * cosine)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::physics::brdf::Lobes;

    fn brdfs() -> Vec<Brdf> {
        let mut brdfs = Vec::new();
        for alpha in [0.0, 1e-12, 0.001, 0.04, 0.3, 1.0] {
            for (diffuse, f0, dielectric) in [(0.73f32, 0.04f32, 0.04), (0.0, 0.9, 0.0), (0.3, 0.5, 0.04)] {
                let diffuse = Vec3::new(diffuse, 0.5 * diffuse, diffuse);
                let f0 = Vec3::new(f0, 0.8 * f0, f0);
                brdfs.push(Brdf { diffuse, alpha, f0, f90: 1.0, dielectric_f0: dielectric, dielectric_f90: 1.0 });
            }
        }
        brdfs
    }

    #[test]
    fn turns() {
        for i in 0..=10_000 {
            let u = i as f32 / 10_000.0;
            let (sine, cosine) = sin_cos_of_turns(u);
            let want = (f64::from(u) * std::f64::consts::TAU).sin_cos();
            let off = (f64::from(sine) - want.0).abs().max((f64::from(cosine) - want.1).abs());
            assert!(off < 4e-7, "{u} turns: off by {off}");
        }
    }

    /// Directions and weights equal those of double precision, except for lobes too narrow for single precision.
    #[test]
    fn draws_what_double_precision_draws() {
        let points = SharedPoints::new(1, 4096);
        let mut directions = Directions::default();
        for brdf in brdfs() {
            for cosine in [1.0, 0.9, 0.3, 0.05f32] {
                let wo = DVec3::new((1.0 - f64::from(cosine).powi(2)).sqrt(), 0.0, cosine.into());
                let Some(lobes) = Lobes::new(&brdf, DVec3::Z, wo) else { continue };
                let shifts = points.shifts(7);
                for lobe in [Lobe::All, Lobe::Specular] {
                    directions.draw(&brdf, (cosine, lobes.specular_share() as f32), lobe, &points, shifts);
                    let (mut got_sum, mut want_sum) = (DVec3::ZERO, DVec3::ZERO);
                    let numbers = points.blocks(shifts).flat_map(|block| (0..BLOCK).map(move |i| block.map(|d| d[i])));
                    let drawn = directions.blocks().iter().flat_map(|block| (0..BLOCK).map(|i| block.get(i)));
                    for (u, (wi, weight)) in numbers.zip(drawn) {
                        let (u, wi, weight) = (u.map(f64::from), wi.as_dvec3(), weight.as_dvec3());
                        let at = lobes.sample(u).map(|wi| lobes.at(wi));
                        let reflected = at.map_or(DVec3::ZERO, |at| match lobe {
                            Lobe::All => at.sum() / at.density,
                            Lobe::Specular => at.specular / at.density,
                        });
                        (got_sum, want_sum) = (got_sum + weight, want_sum + reflected / points.len() as f64);
                        assert!(weight.is_finite() && weight.max_element() <= 8.0 / points.len() as f64);
                        if brdf.alpha >= 0.001 || brdf.alpha == 0.0 {
                            let off = lobes.sample(u).map_or(0.0, |want| want.distance(wi));
                            // Far in the lobe's tail 1 - v has few significant digits.
                            assert!(off < 1e-4, "{brdf:?}, n.wo {cosine}: {wi} is off by {off}");
                        }
                    }
                    // Directions have errors of 1e-7, which become 1e-4 for lobes of this width.
                    let off = (got_sum - want_sum).abs().max_element();
                    assert!(off < 1e-3, "{brdf:?}, n.wo {cosine}, {lobe:?}: {got_sum}, want {want_sum}");
                }
            }
        }
    }
}
