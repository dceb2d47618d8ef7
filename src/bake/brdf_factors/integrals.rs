//! The tables of [`HarmonicProjection`], by integration. `BLESS=1 cargo test` writes them.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::harmonics::{Harmonics, RADIAL_COUNT, RADIALS};
use super::{COSINES, HarmonicProjection, NEAR_MIRROR_ALPHA, ROUGHNESSES};
use crate::physics::brdf::{Lobes, Reflected};
use crate::shared::Brdf;

/// Facets to integrate an entry, in azimuth and in elevation. Only half of the azimuths are used, as the other half is
/// symmetric.
const FACETS: [usize; 2] = [12, 288];

impl HarmonicProjection {
    fn integrated() -> Self {
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
fn integrate(brdf: &Brdf, wi: DVec3, parts: impl Fn(&Reflected) -> [f64; 2]) -> [[f64; 2]; RADIAL_COUNT] {
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

#[test]
fn the_tables_are_the_integrals() {
    let tables = HarmonicProjection::integrated().tables();
    if std::env::var_os("BLESS").is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/bake/brdf_factors/projection.f32");
        let bytes: Vec<u8> = tables.iter().flat_map(|value| value.to_le_bytes()).collect();
        return std::fs::write(path, bytes).unwrap();
    }
    let stored = HarmonicProjection::get().tables();
    assert_eq!(stored.len(), tables.len());
    // Sines differ in their last bit between systems.
    let error = stored.iter().zip(&tables).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(error < 1e-6, "BLESS=1 writes tables that are off by {error}");
}
