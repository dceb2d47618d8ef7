//! BRDFs as short sums of products, f(ωo, ωi) ≈ Σ h_i(ωo) k_i(ωi): k_i projects incident light onto the coefficients of
//! a gather sample, and h_i evaluates its outgoing radiance.
//!
//! [`harmonics`] and [`HarmonicProjection`] are our method: one basis h = B for all materials, hemispherical harmonics,
//! and k_i(ωi) = ∫ B_i f cosθ dω, tabulated for every roughness. [`svd`] is the method of [Yang 2007, Section 4.4].

pub mod harmonics;
#[cfg(test)]
mod integrals;
pub mod svd;

use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::Vec3;

use self::harmonics::{DEGREES, MAX_FUNCTIONS, RADIAL_COUNT, azimuths, radials_of, spread};
use crate::physics::brdf;
use crate::shared::{Brdf, TABLE_COSINES, TABLE_ROUGHNESSES};

pub use crate::shared::ALBEDO_CAP;

/// Rays continue at narrower lobes, of glTF roughness below 0.2: no short sum can represent them.
pub const NEAR_MIRROR_ALPHA: f32 = 0.04;
const ROUGHNESSES: usize = TABLE_ROUGHNESSES as usize;
/// Number of cosines, equidistant in their square root, as k is steep near grazing.
const COSINES: usize = TABLE_COSINES as usize;
/// k_i over roughness and angle, without the reflectances of glTF's model: it is linear in all of them.
pub struct HarmonicProjection {
    /// [roughness][cosine]: radial parts of the specular lobe's k with Fresnel term 1, and with Schlick's weight.
    specular: Vec<[[f32; 2]; RADIAL_COUNT]>,
    /// [cosine]: radial parts of Schlick's weight over pi, which is subtracted from the diffuse lobe.
    schlick: Vec<[f32; RADIAL_COUNT]>,
}

impl HarmonicProjection {
    /// Number of elements of [`Self::tables`].
    pub const TABLE_LENGTH: usize = (2 * ROUGHNESSES + 1) * COSINES * RADIAL_COUNT;

    /// The only instance. Its tables take 1.4 CPU seconds and are part of the program; a test computes them anew.
    pub fn get() -> &'static Self {
        static PROJECTION: OnceLock<HarmonicProjection> = OnceLock::new();
        PROJECTION.get_or_init(|| {
            let (words, _) = include_bytes!("projection.f32").as_chunks();
            Self::from_tables(&words.iter().copied().map(f32::from_le_bytes).collect::<Vec<_>>())
        })
    }

    /// k_i of `brdf` for light from the unit direction `wi` of the local frame, above the horizon: the first
    /// `values.len()` coefficients for irradiance 1 on a plane perpendicular to `wi`. The cosine is not included.
    /// Scaled down where necessary so that at most [`ALBEDO_CAP`] of the light is reflected in any channel, including a
    /// perfect mirror's reflection.
    pub fn project(&self, brdf: &Brdf, wi: Vec3, values: &mut [Vec3]) {
        let radials = self.radials(brdf, wi.z, radials_of(values.len()));
        let capped = capped(brdf, wi.z, radials[0] * PI.sqrt() as f32);
        spread(values, |i| radials[i] * capped, azimuths(wi.x, wi.y));
    }

    /// What [`Self::project`] multiplies light at this cosine by, so that no more than [`ALBEDO_CAP`] is reflected.
    pub fn cap(&self, brdf: &Brdf, cosine: f32) -> Vec3 {
        capped(brdf, cosine, self.albedo(brdf, cosine))
    }

    /// Directional albedo of `brdf` at this cosine, without the cap.
    pub fn albedo(&self, brdf: &Brdf, cosine: f32) -> Vec3 {
        self.radials(brdf, cosine, 1)[0] * PI.sqrt() as f32
    }

    /// The mean of [`Self::albedo`] under uniform illumination; together with a perfect mirror's reflection it is
    /// limited to `cap` in every direction.
    pub fn hemispherical_albedo(&self, brdf: &Brdf, cap: f32) -> Vec3 {
        let steps = 256;
        let cosine = |i: usize| (i as f32 + 0.5) / steps as f32;
        let at = |i: usize| {
            let z = cosine(i);
            self.albedo(brdf, z).min(left_by_mirror(brdf, z, cap)) * (2.0 * z / steps as f32)
        };
        (0..steps).map(at).sum()
    }

    /// Mean energy of the outgoing light in the functions of each degree, averaged over RGB and over lights from all
    /// directions with equal irradiance at normal incidence. Lights near the horizon contribute little, however sharply
    /// they are reflected.
    pub fn energy_by_degree(&self, brdf: &Brdf) -> [f32; DEGREES] {
        let steps = 256;
        let mut energy = [0.0; DEGREES];
        let mut values = [Vec3::ZERO; MAX_FUNCTIONS];
        for i in 0..steps {
            let z = (i as f32 + 0.5) / steps as f32;
            self.project(brdf, Vec3::new((1.0 - z * z).sqrt(), 0.0, z), &mut values);
            for (degree, sum) in energy.iter_mut().enumerate() {
                let of_degree = &values[degree * degree..(degree + 1) * (degree + 1)];
                *sum += of_degree.iter().map(|k| k.dot(*k)).sum::<f32>() / 3.0 * z * z / steps as f32;
            }
        }
        energy
    }

    /// All tables in the layout of shade_gather.comp: `[roughness][cosine][radial part]` of the specular lobe, two
    /// values per part, then `[cosine][radial part]` of the diffuse one.
    pub fn tables(&self) -> Vec<f32> {
        let specular = self.specular.iter().flatten().flatten();
        specular.chain(self.schlick.iter().flatten()).copied().collect()
    }

    /// The inverse of [`Self::tables`]; `tables` has [`Self::TABLE_LENGTH`] elements.
    fn from_tables(tables: &[f32]) -> Self {
        let (specular, schlick) = tables.split_at(2 * ROUGHNESSES * COSINES * RADIAL_COUNT);
        Self { specular: bytemuck::cast_slice(specular).to_vec(), schlick: bytemuck::cast_slice(schlick).to_vec() }
    }

    fn radials(&self, brdf: &Brdf, cosine: f32, count: usize) -> [Vec3; RADIAL_COUNT] {
        let (column, along) = place(cosine.clamp(0.0, 1.0).sqrt(), COSINES);
        let weights = [1.0 - along, along];
        let mut radials = [Vec3::ZERO; RADIAL_COUNT];
        if brdf.diffuse != Vec3::ZERO {
            let fall = brdf.dielectric_f90 - brdf.dielectric_f0;
            for (radial, c) in radials.iter_mut().zip(0..count) {
                let schlick = weights[0] * self.schlick[column][c] + weights[1] * self.schlick[column + 1][c];
                *radial = -fall * schlick * brdf.diffuse;
            }
            // Uniform outgoing light is a multiple of the first function.
            radials[0] += (1.0 - brdf.dielectric_f0) / PI.sqrt() as f32 * brdf.diffuse;
        }
        if brdf.has_lobe() {
            let (row, across) = place(roughness_coordinate(brdf), ROUGHNESSES);
            let mut sums = [[0.0; 2]; RADIAL_COUNT];
            for (row, share) in [(row, 1.0 - across), (row + 1, across)] {
                for (column, weight) in [(column, weights[0]), (column + 1, weights[1])] {
                    let entry = &self.specular[row * COSINES + column];
                    for (sum, k) in sums.iter_mut().zip(&entry[..count]) {
                        sum[0] += share * weight * k[0];
                        sum[1] += share * weight * k[1];
                    }
                }
            }
            for (radial, [all, schlick]) in radials.iter_mut().zip(sums) {
                *radial += brdf.f0 * (all - schlick) + Vec3::splat(brdf.f90 * schlick);
            }
        }
        radials
    }
}

/// The share of light that may be reflected, beside a perfect mirror's reflection, of what an albedo says.
fn capped(brdf: &Brdf, cosine: f32, albedo: Vec3) -> Vec3 {
    (left_by_mirror(brdf, cosine, ALBEDO_CAP) / albedo.max(Vec3::splat(1e-6))).min(Vec3::ONE)
}

/// The part of `cap` that remains after a perfect mirror's reflection.
fn left_by_mirror(brdf: &Brdf, cosine: f32, cap: f32) -> Vec3 {
    (Vec3::splat(cap) - brdf::mirror(brdf, cosine.into()).as_vec3()).max(Vec3::ZERO)
}

/// Position of a BRDF's roughness between the first and the last row of the tables, 0 to 1.
pub fn roughness_coordinate(brdf: &Brdf) -> f32 {
    let narrowest = NEAR_MIRROR_ALPHA.sqrt();
    ((brdf.alpha.sqrt() - narrowest) / (1.0 - narrowest)).clamp(0.0, 1.0)
}

/// For a number in [0, 1]: the first of the two entries around it, out of `count`, and the interpolation weight.
fn place(x: f32, count: usize) -> (usize, f32) {
    let x = x * (count - 1) as f32;
    let index = (x as usize).min(count - 2);
    (index, x - index as f32)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::harmonics::Harmonics;
    use super::*;
    use crate::physics::brdf::Lobes;
    use crate::physics::sequence::Points;

    fn brdf(diffuse: f32, roughness: f32, f0: f32, metal: bool) -> Brdf {
        let (dielectric_f0, dielectric_f90) = if metal { (0.0, 0.0) } else { (f0, 1.0) };
        Brdf {
            diffuse: Vec3::new(diffuse, 0.5 * diffuse, 0.0),
            alpha: roughness * roughness,
            f0: Vec3::new(f0, f0, 0.5 * f0),
            f90: 1.0,
            dielectric_f0,
            dielectric_f90,
        }
    }

    /// Compares k with integration by BRDF sampling, at angles and roughnesses between the table's entries.
    #[test]
    fn tabulated_factors_are_the_integrals() {
        for brdf in [brdf(0.73, 1.0, 0.04, false), brdf(0.5, 0.31, 0.04, false), brdf(0.0, 0.417, 0.5, true)] {
            for cosine in [1.0, 0.93, 0.61, 0.2, 0.05f64] {
                let (sine, turn) = ((1.0 - cosine * cosine).sqrt(), 0.7f64);
                let wi = DVec3::new(sine * turn.cos(), sine * turn.sin(), cosine);
                let lobes = Lobes::new(&brdf, DVec3::Z, wi).unwrap();
                let points = Points::new(1, 0);
                let mut want = [DVec3::ZERO; MAX_FUNCTIONS];
                let count = 1 << 15;
                for i in 0..count {
                    let [u, v, w, _] = points.at(i, 0);
                    let Some(wo) = lobes.sample([u, v, w]) else { continue };
                    let at = lobes.at(wo);
                    for (want, value) in want.iter_mut().zip(Harmonics::get().evaluate_exactly(wo)) {
                        *want += at.sum() * value / at.density / f64::from(count);
                    }
                }
                let cap = (f64::from(ALBEDO_CAP) / (want[0] * PI.sqrt())).min(DVec3::ONE);
                let mut got = [Vec3::ZERO; MAX_FUNCTIONS];
                HarmonicProjection::get().project(&brdf, wi.as_vec3(), &mut got);
                for (i, (got, want)) in got.iter().zip(want).enumerate() {
                    // Light at grazing angles counts by its cosine. White reflects 0.56 in k_0: linear interpolation
                    // has an error of 0.4 % of that.
                    let error = (got.as_dvec3() - want * cap).abs().max_element() * cosine;
                    assert!(error < 2e-3, "k_{i} of {brdf:?} at {cosine}: {got}, want {want}");
                }
            }
        }
    }

    #[test]
    fn no_more_light_leaves_than_the_cap_allows() {
        let brdf = brdf(1.0, 0.3, 0.04, false);
        assert!(HarmonicProjection::get().albedo(&brdf, 0.087).x > 1.2, "glTF's BRDF exceeds 1 at 85 degrees");
        for brdf in [brdf, Brdf { alpha: 0.0, ..brdf }] {
            let mut values = [Vec3::ZERO; 1];
            for i in 1..=1000 {
                let z = i as f32 / 1000.0;
                HarmonicProjection::get().project(&brdf, Vec3::new((1.0 - z * z).sqrt(), 0.0, z), &mut values);
                let mirrored = brdf::mirror(&brdf, z.into()).max_element() as f32;
                assert!(values[0].max_element() * PI.sqrt() as f32 + mirrored <= ALBEDO_CAP.max(mirrored) + 1e-6);
            }
        }
    }
}
