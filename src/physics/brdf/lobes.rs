//! Sampling the BRDF: visible normals for the specular lobe, cosine-weighted directions for the diffuse lobe.

use std::f64::consts::{FRAC_1_PI, TAU};

use glam::{DMat3, DVec3};

use super::{Angles, fresnel, half_vector_density, parts, schlick};
use crate::shared::Brdf;

/// A BRDF for one `wo`, ready to sample directions from a mixture of its two lobes.
///
/// Reflection by a perfect mirror is not included: see [`super::mirror`].
#[derive(Clone, Copy, Debug)]
pub struct Lobes<'a> {
    brdf: &'a Brdf,
    /// Columns: two tangents and the normal.
    world_from_local: DMat3,
    wo: DVec3,
    /// Probability of the specular lobe in the mixture.
    specular: f64,
}

/// BRDF and sampling density of [`Lobes`] for a direction.
#[derive(Clone, Copy, Debug)]
pub struct Reflected {
    /// Diffuse part of BRDF times cosine, 1/sr.
    pub diffuse: DVec3,
    /// Specular part of BRDF times cosine, 1/sr.
    pub specular: DVec3,
    /// Density of sampling the direction, 1/sr.
    pub density: f64,
}

impl Reflected {
    /// BRDF times cosine, 1/sr.
    #[inline]
    pub fn sum(&self) -> DVec3 {
        self.diffuse + self.specular
    }
}

impl<'a> Lobes<'a> {
    /// `normal` and `wo` are unit. `None` if nothing is reflected: seen from below, black, or a perfect mirror.
    #[inline]
    pub fn new(brdf: &'a Brdf, normal: DVec3, wo: DVec3) -> Option<Self> {
        let no = normal.dot(wo);
        if no <= 0.0 || !brdf.reflects_directly() {
            return None;
        }
        let diffuse = f64::from(brdf.diffuse.max_element());
        let specular = if brdf.has_lobe() {
            // Facets visible at grazing angles tilt towards the eye, more on rougher surfaces, and their Fresnel term
            // is smaller.
            let oh = no + 0.6 * f64::from(brdf.alpha) * (1.0 - no);
            fresnel(brdf, schlick(oh.min(1.0))).max_element().max(f64::MIN_POSITIVE)
        } else {
            0.0
        };
        let specular = specular / (specular + diffuse);
        Some(Self { brdf, world_from_local: basis(normal), wo, specular })
    }

    /// The same with directions of the specular lobe alone.
    #[inline]
    pub fn of_specular_lobe(brdf: &'a Brdf, normal: DVec3, wo: DVec3) -> Option<Self> {
        Self::new(brdf, normal, wo).filter(|_| brdf.has_lobe()).map(|lobes| Self { specular: 1.0, ..lobes })
    }

    /// Probability of sampling the specular lobe.
    pub fn specular_share(&self) -> f64 {
        self.specular
    }

    /// Samples a unit direction from three numbers in [0, 1). `None` if it is below the horizon, which the specular
    /// lobe can reach: such a sample contributes zero.
    #[inline]
    pub fn sample(&self, u: [f64; 3]) -> Option<DVec3> {
        let normal = self.world_from_local.z_axis;
        let wi = if u[2] < self.specular {
            let wo = self.world_from_local.transpose() * self.wo;
            let h = self.world_from_local * visible_normal(wo, self.brdf.alpha.into(), u[0], u[1]);
            (2.0 * self.wo.dot(h) * h - self.wo).normalize()
        } else {
            self.world_from_local * cosine_direction(u[0], u[1])
        };
        (normal.dot(wi) > 0.0).then_some(wi)
    }

    /// BRDF times cosine, and the density of [`Self::sample`], at a unit direction; zero below the horizon.
    #[inline]
    pub fn at(&self, wi: DVec3) -> Reflected {
        let a = Angles::new(self.world_from_local.z_axis, wi, self.wo);
        if a.ni <= 0.0 {
            return Reflected { diffuse: DVec3::ZERO, specular: DVec3::ZERO, density: 0.0 };
        }
        let half_vector_density = half_vector_density(self.brdf, &a);
        let [diffuse, specular] = parts(self.brdf, &a, half_vector_density).map(|part| part * a.ni);
        let mut density = (1.0 - self.specular) * a.ni * FRAC_1_PI;
        if self.brdf.has_lobe() {
            density += self.specular * half_vector_density * visible_normal_ratio(&a, self.brdf.alpha.into());
        }
        Reflected { diffuse, specular, density }
    }
}

/// An orthonormal frame whose third column is the unit vector `n` [Duff 2017, Listing 3].
#[inline]
pub fn basis(n: DVec3) -> DMat3 {
    let sign = 1f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let tangent = DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    DMat3::from_cols(tangent, DVec3::new(b, sign + n.y * n.y * a, -n.y), n)
}

/// Cosine-weighted direction in the local frame; its density is the cosine over pi.
#[inline]
pub fn cosine_direction(u: f64, v: f64) -> DVec3 {
    let (sine, cosine) = (TAU * u).sin_cos();
    let r = v.sqrt();
    DVec3::new(r * cosine, r * sine, (1.0 - v).sqrt())
}

/// Facet normal in the local frame, distributed as the normals visible from `wo` [Heitz 2018], by reflection at a point
/// of a spherical cap [Dupuy 2023, Listing 3].
#[inline]
fn visible_normal(wo: DVec3, alpha: f64, u: f64, v: f64) -> DVec3 {
    let stretched = DVec3::new(alpha * wo.x, alpha * wo.y, wo.z).normalize();
    let z = (1.0 - v) * (1.0 + stretched.z) - stretched.z;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (sine, cosine) = (TAU * u).sin_cos();
    let h = DVec3::new(r * cosine, r * sine, z) + stretched;
    DVec3::new(alpha * h.x, alpha * h.y, h.z.max(0.0)).normalize_or(DVec3::Z)
}

/// Density of directions mirrored at visible normals, divided by the density of all normals: G1 / (4 n.wo) [Heitz 2018,
/// Eq. 17], rearranged to stay finite at the horizon.
#[inline]
fn visible_normal_ratio(a: &Angles, alpha: f64) -> f64 {
    let root = (alpha * alpha + (1.0 - alpha * alpha) * a.no * a.no).sqrt();
    0.5 / (a.no + root)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::physics::sequence::Points;

    fn brdfs() -> Vec<Brdf> {
        let mut brdfs = Vec::new();
        for alpha in [0.0, 1e-12, 1e-4, 0.09, 0.3, 1.0] {
            for (diffuse, f0) in [(0.73f32, 0.04f32), (0.0, 0.9), (0.3, 0.5), (0.8, 0.0)] {
                let (f90, dielectric_f90) = if f0 > 0.0 { (1.0, 1.0) } else { (0.0, 0.0) };
                let dielectric_f0 = f0.min(0.04);
                let diffuse = Vec3::new(diffuse, 0.5 * diffuse, diffuse);
                brdfs.push(Brdf { diffuse, alpha, f0: Vec3::splat(f0), f90, dielectric_f0, dielectric_f90 });
            }
        }
        brdfs
    }

    fn towards(cosine: f64) -> DVec3 {
        DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine)
    }

    /// Sample weights are bounded, even for lobes and angles that have no width in float32. The largest, 4, occurs
    /// where Fresnel's term exceeds the estimate in the mixture.
    #[test]
    fn weights_are_bounded() {
        let normal = DVec3::new(0.3, -0.8, 0.2).normalize();
        let points = Points::new(1, 0);
        for brdf in brdfs() {
            for no in [1.0, 0.7, 0.1, 1e-3, 1e-7, 1e-12] {
                let Some(lobes) = Lobes::new(&brdf, normal, basis(normal) * towards(no)) else { continue };
                for i in 0..4096 {
                    let [u, v, w, _] = points.at(i, 0);
                    let Some(wi) = lobes.sample([u, v, w]) else { continue };
                    let at = lobes.at(wi);
                    let weight = at.sum() / at.density;
                    assert!((wi.length() - 1.0).abs() < 1e-12 && weight.is_finite(), "{brdf:?}, {no}: {weight}");
                    assert!(weight.max_element() < 8.0, "{brdf:?}, n.wo {no}, n.wi {}: {weight}", normal.dot(wi));
                }
            }
        }
    }

    /// Sampled albedos compared with a grid over the hemisphere, for lobes that a grid can resolve.
    #[test]
    fn sampling_finds_the_albedo() {
        for brdf in brdfs().into_iter().filter(|b| !b.has_lobe() || b.alpha > 0.05) {
            for no in [1.0, 0.6, 0.1] {
                let Some(lobes) = Lobes::new(&brdf, DVec3::Z, towards(no)) else { continue };
                let mut want = DVec3::ZERO;
                const HEIGHTS: usize = 400;
                const AZIMUTHS: usize = 2000; // a lobe at grazing angles is narrow in azimuth
                for i in 0..HEIGHTS * AZIMUTHS {
                    let z = ((i / AZIMUTHS) as f64 + 0.5) / HEIGHTS as f64;
                    let (sine, cosine) = (TAU * ((i % AZIMUTHS) as f64 + 0.5) / AZIMUTHS as f64).sin_cos();
                    let r = (1.0 - z * z).sqrt();
                    want += lobes.at(DVec3::new(r * cosine, r * sine, z)).sum();
                }
                want *= TAU / (HEIGHTS * AZIMUTHS) as f64;
                let points = Points::new(1, 0);
                let mut got = DVec3::ZERO;
                for i in 0..1 << 14 {
                    let [u, v, w, _] = points.at(i, 0);
                    if let Some(at) = lobes.sample([u, v, w]).map(|wi| lobes.at(wi)) {
                        got += at.sum() / at.density / f64::from(1 << 14);
                    }
                }
                assert!((got - want).abs().max_element() < 2e-3, "{brdf:?}, n.wo {no}: {got}, want {want}");
            }
        }
    }
}
