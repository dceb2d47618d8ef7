//! BRDFs as short sums of products, f(ωo, ωi) ≈ Σ h_i(ωo) k_i(ωi): k_i projects incident light onto the coefficients of
//! a gather sample, and h_i evaluates its outgoing radiance.
//!
//! [`harmonics`] and [`Projection`] are our method: one basis h = B for all materials, hemispherical harmonics, and
//! k_i(ωi) = ∫ B_i f cosθ dω, tabulated once for every roughness. [`svd`] is the method of [Yang 2007, Section 4.4].

pub mod harmonics;
pub mod svd;

use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use self::harmonics::{DEGREES, Harmonics, MAX_FUNCTIONS, RADIAL_COUNT, RADIALS, azimuths, radials_of, spread};
use crate::physics::brdf::{self, Lobes};
use crate::shared::{Brdf, TABLE_COSINES, TABLE_ROUGHNESSES};

pub use crate::shared::ALBEDO_CAP;

/// Rays continue at narrower lobes, of glTF roughness below 0.2: no short sum can represent them.
pub const NEAR_MIRROR_ALPHA: f32 = 0.04;
const ROUGHNESSES: usize = TABLE_ROUGHNESSES as usize;
/// Number of cosines, equidistant in their square root, as k is steep near grazing.
const COSINES: usize = TABLE_COSINES as usize;
/// Facets to integrate an entry, in azimuth and in elevation. Only half of the azimuths are used, as the other half is
/// symmetric.
const FACETS: [usize; 2] = [12, 288];

/// k_i over roughness and angle, without the reflectances of glTF's model: it is linear in all of them.
pub struct Projection {
    /// [roughness][cosine]: radial parts of the specular lobe's k with Fresnel term 1, and with Schlick's weight.
    specular: Vec<[[f32; 2]; RADIAL_COUNT]>,
    /// [cosine]: radial parts of Schlick's weight over pi, which is subtracted from the diffuse lobe.
    schlick: Vec<[f32; RADIAL_COUNT]>,
}

impl Projection {
    /// Number of elements of [`Self::tables`].
    pub const TABLE_LENGTH: usize = (2 * ROUGHNESSES + 1) * COSINES * RADIAL_COUNT;

    /// The only instance, computed at first use.
    pub fn get() -> &'static Self {
        static PROJECTION: OnceLock<Projection> = OnceLock::new();
        PROJECTION.get_or_init(Self::new)
    }

    fn new() -> Self {
        let white = Brdf {
            diffuse: Vec3::ZERO,
            alpha: 0.0,
            f0: Vec3::X, // red has Fresnel term 1, green Schlick's weight
            f90: 1.0,
            dielectric_f0: 0.0,
            dielectric_f90: 0.0,
        };
        let alpha = |row: usize| {
            let narrowest = NEAR_MIRROR_ALPHA.sqrt();
            (narrowest + (1.0 - narrowest) * row as f32 / (ROUGHNESSES - 1) as f32).powi(2)
        };
        let row = |row: usize| {
            let brdf = Brdf { alpha: alpha(row), ..white };
            column(|wi| integrate(&brdf, wi, |reflected| [reflected.specular.x, reflected.specular.y]))
        };
        let specular = (0..ROUGHNESSES).into_par_iter().flat_map_iter(row).map(|k| k.map(|k| k.map(|k| k as f32)));
        // Its diffuse lobe is 1/pi minus Schlick's weight over pi.
        let lambert = Brdf { diffuse: Vec3::ONE, f0: Vec3::ZERO, f90: 0.0, dielectric_f90: 1.0, ..white };
        let missing = |wi| integrate(&lambert, wi, |r| [r.density - r.diffuse.x, 0.0]);
        let schlick = column(missing).into_iter().map(|k| k.map(|[missing, _]| missing as f32)).collect();
        Self { specular: specular.collect(), schlick }
    }

    /// k_i of `brdf` for light from the unit direction `wi` of the local frame, above the horizon: the first
    /// `values.len()` coefficients for irradiance 1 on a plane perpendicular to `wi`. The cosine is not included.
    /// Scaled down where necessary so that at most [`ALBEDO_CAP`] of the light is reflected in any channel, including a
    /// perfect mirror's reflection.
    pub fn project(&self, brdf: &Brdf, wi: Vec3, values: &mut [Vec3]) {
        let radials = self.radials(brdf, wi.z, radials_of(values.len()));
        let albedo = radials[0] * PI.sqrt() as f32;
        let cap = (left_by_mirror(brdf, wi.z, ALBEDO_CAP) / albedo.max(Vec3::splat(1e-6))).min(Vec3::ONE);
        spread(values, |i| radials[i] * cap, azimuths(wi.x, wi.y));
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
    pub fn from_tables(tables: &[f32]) -> Self {
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

/// Entries for all cosines: `integrate` applied to directions of light.
fn column(integrate: impl Fn(DVec3) -> [[f64; 2]; RADIAL_COUNT]) -> Vec<[[f64; 2]; RADIAL_COUNT]> {
    let entry = |i: usize| {
        // Never exactly on the horizon, where nothing is reflected.
        let z = ((i as f64 / (COSINES - 1) as f64).powi(2)).clamp(1e-6, 1.0);
        integrate(DVec3::new((1.0 - z * z).sqrt(), 0.0, z))
    };
    let mut entries: Vec<_> = (0..COSINES).map(entry).collect();
    // At normal incidence radial parts of higher orders are 0/0: they are extrapolated.
    let [.., before, last, top] = &mut entries[..] else { unreachable!("there are {COSINES}") };
    for (i, &(_, order)) in RADIALS.iter().enumerate() {
        if order > 0 {
            top[i] = std::array::from_fn(|part| 2.0 * last[i][part] - before[i][part]);
        }
    }
    entries
}

/// Radial parts of ∫ B_i(ωo) f cosθo dωo for light from `wi`, by sampling facets; `parts` selects two parts of BRDF
/// times cosine.
fn integrate(
    brdf: &Brdf,
    wi: DVec3,
    parts: impl Fn(&crate::physics::brdf::Reflected) -> [f64; 2],
) -> [[f64; 2]; RADIAL_COUNT] {
    let mut sums = [[0.0; 2]; RADIAL_COUNT];
    let Some(lobes) = Lobes::new(brdf, DVec3::Z, wi) else { return sums };
    for facet in 0..FACETS[0] * FACETS[1] {
        let around = 0.5 * ((facet / FACETS[1]) as f64 + 0.5) / FACETS[0] as f64;
        let along = ((facet % FACETS[1]) as f64 + 0.5) / FACETS[1] as f64;
        let Some(wo) = lobes.sample([around, along, 0.5]) else { continue };
        let reflected = lobes.at(wo);
        let values = Harmonics::get().evaluate_exactly(wo);
        let mut next = 0;
        for (sum, &(_, order)) in sums.iter_mut().zip(&RADIALS) {
            // The other function of this order is odd in the azimuth: its integral is zero.
            for (sum, part) in sum.iter_mut().zip(parts(&reflected)) {
                *sum += values[next] * part / reflected.density / (FACETS[0] * FACETS[1]) as f64;
            }
            next += if order > 0 { 2 } else { 1 };
        }
    }
    let sine = wi.x.max(1e-9);
    for (sum, &(_, order)) in sums.iter_mut().zip(&RADIALS) {
        *sum = sum.map(|s| s / sine.powi(order as i32));
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
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
                Projection::get().project(&brdf, wi.as_vec3(), &mut got);
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
        assert!(Projection::get().albedo(&brdf, 0.087).x > 1.2, "glTF's BRDF exceeds 1 at 85 degrees");
        for brdf in [brdf, Brdf { alpha: 0.0, ..brdf }] {
            let mut values = [Vec3::ZERO; 1];
            for i in 1..=1000 {
                let z = i as f32 / 1000.0;
                Projection::get().project(&brdf, Vec3::new((1.0 - z * z).sqrt(), 0.0, z), &mut values);
                let mirrored = brdf::mirror(&brdf, z.into()).max_element() as f32;
                assert!(values[0].max_element() * PI.sqrt() as f32 + mirrored <= ALBEDO_CAP.max(mirrored) + 1e-6);
            }
        }
    }
}
