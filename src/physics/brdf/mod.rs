//! glTF's BRDF [glTF 2.0, Appendix B], in double precision: the only implementation in Rust. Twin of
//! glsl/lib/brdf.glsl.

mod lobes;

use std::f64::consts::FRAC_1_PI;

use glam::{DVec3, Vec3};

pub use self::lobes::{Lobes, Reflected, basis, cosine_direction};

use crate::shared::Brdf;

/// The masking term is constant below this cosine: the BRDF of a narrow lobe has no limit at the horizon.
const MIN_COSINE: f64 = 1e-6;

/// All angles that an isotropic BRDF depends on. The half vector's sine is included, because its cosine is too
/// imprecise for narrow lobes.
#[derive(Clone, Copy, Debug)]
pub struct Angles {
    /// n . wi
    pub ni: f64,
    /// n . wo
    pub no: f64,
    /// n . h
    pub nh: f64,
    /// |n x h|
    pub sine_nh: f64,
    /// wo . h
    pub oh: f64,
}

impl Angles {
    /// All vectors are unit; `wi` and `wo` point away from the surface.
    #[inline]
    pub fn new(n: DVec3, wi: DVec3, wo: DVec3) -> Self {
        let h = (wi + wo).normalize_or(n);
        Self { ni: n.dot(wi), no: n.dot(wo), nh: n.dot(h), sine_nh: n.cross(h).length(), oh: wo.dot(h).clamp(0.0, 1.0) }
    }
}

/// The BRDF, in 1/sr; zero below either horizon. A perfect mirror's specular part is [`mirror`].
#[inline]
pub fn f(brdf: &Brdf, n: DVec3, wi: DVec3, wo: DVec3) -> DVec3 {
    f_of_angles(brdf, &Angles::new(n, wi, wo))
}

/// The BRDF times the cosine at `wi`.
#[inline]
pub fn reflected(brdf: &Brdf, n: DVec3, wi: DVec3, wo: DVec3) -> DVec3 {
    f(brdf, n, wi, wo) * n.dot(wi).max(0.0)
}

/// [`f`] for angles already known.
#[inline]
pub fn f_of_angles(brdf: &Brdf, a: &Angles) -> DVec3 {
    let [diffuse, specular] = parts(brdf, a, half_vector_density(brdf, a));
    diffuse + specular
}

/// Diffuse and specular part of [`f_of_angles`], given the density of half vectors from [`half_vector_density`].
#[inline]
fn parts(brdf: &Brdf, a: &Angles, half_vector_density: f64) -> [DVec3; 2] {
    if a.ni <= 0.0 || a.no <= 0.0 {
        return [DVec3::ZERO; 2];
    }
    let s = schlick(a.oh);
    let (f0, f90) = (f64::from(brdf.dielectric_f0), f64::from(brdf.dielectric_f90));
    let diffuse = brdf.diffuse.as_dvec3() * (FRAC_1_PI * (1.0 - (f0 + (f90 - f0) * s)));
    if !brdf.has_lobe() {
        return [diffuse, DVec3::ZERO];
    }
    [diffuse, fresnel(brdf, s) * (half_vector_density * smith(a.ni, a.no, brdf.alpha.into()))]
}

/// [`ggx`] of the specular lobe; 0 if there is none.
#[inline]
fn half_vector_density(brdf: &Brdf, a: &Angles) -> f64 {
    if brdf.has_lobe() { ggx(a.nh, a.sine_nh, brdf.alpha.into()) } else { 0.0 }
}

/// Weight of the grazing reflectance [Schlick 1994, Eq. 24].
#[inline]
fn schlick(cosine: f64) -> f64 {
    (1.0 - cosine).powi(5)
}

/// Fresnel term of the specular part, mixed from dielectric and metal, at weight `s` of [`schlick`].
#[inline]
fn fresnel(brdf: &Brdf, s: f64) -> DVec3 {
    brdf.f0.as_dvec3().lerp(DVec3::splat(brdf.f90.into()), s)
}

/// Reflectance of a perfect mirror at this cosine, mixed from dielectric and metal.
pub fn mirror(brdf: &Brdf, cosine: f64) -> DVec3 {
    if brdf.has_lobe() { DVec3::ZERO } else { specular_reflectance(brdf, cosine) }
}

/// Fresnel term of the specular lobe or the perfect mirror, mixed from dielectric and metal, at this cosine to the half
/// vector.
pub fn specular_reflectance(brdf: &Brdf, cosine: f64) -> DVec3 {
    fresnel(brdf, schlick(cosine.clamp(0.0, 1.0)))
}

/// Density of half vectors, normalized over projected area [Walter 2007, Eq. 33]: alpha² / (pi cos⁴ (alpha² + tan²)²).
#[inline]
pub fn ggx(nh: f64, sine_nh: f64, alpha: f64) -> f64 {
    let x = alpha / (alpha * alpha * nh * nh + sine_nh * sine_nh);
    x * x * FRAC_1_PI
}

/// Height-correlated masking divided by 4 n.wi n.wo [Heitz 2014, Eq. 99].
#[inline]
pub fn smith(ni: f64, no: f64, alpha: f64) -> f64 {
    let (ni, no) = (ni.max(MIN_COSINE), no.max(MIN_COSINE));
    // 1 + 2 lambda is sqrt(1 + alpha² tan²) [Heitz 2014, Eq. 72]; multiplied by the cosine, it needs no division.
    let a2 = alpha * alpha;
    let root = |cosine: f64| (a2 + (1.0 - a2) * cosine * cosine).sqrt();
    0.5 / (no * root(ni) + ni * root(no))
}

impl Brdf {
    /// Whether any light from a point or a direction is reflected.
    #[inline]
    pub fn reflects_directly(&self) -> bool {
        self.diffuse != Vec3::ZERO || (self.has_lobe() && (self.f0 != Vec3::ZERO || self.f90 != 0.0))
    }

    /// Whether there is a specular lobe of non-zero width.
    #[inline]
    pub fn has_lobe(&self) -> bool {
        self.alpha > 0.0
    }
}
