//! Double-precision twins of the kernels, derived from the physics, against which tests compare the GLSL; and a path
//! tracer.
//!
//! The twins take the packed structs of [`crate::shared`], so that their inputs equal those of the kernels.

pub mod composite;
pub mod path_tracer;

use glam::{DVec3, Vec2, Vec3};

use crate::physics::{brdf, light};
use crate::shared::{Brdf, LIGHT_DIRECTIONAL, NARROW_ALPHA, NO_BRDF, PackedLight, ViewSample};

/// Radiance of one view sample under one light at unit intensity; `visibility` in [0, 1]; `drawn_area` as
/// [`ShadeLightPush::drawn_area`]. Twin of shade_light.comp.
pub fn shade(sample: &ViewSample, brdfs: &[Brdf], visibility: f64, light: &PackedLight, drawn_area: f64) -> DVec3 {
    if sample.brdf == NO_BRDF {
        return DVec3::ZERO;
    }
    let Some(arriving) = light::incident(light, sample.position.as_dvec3()) else { return DVec3::ZERO };
    let (n, wo) = (octahedral(sample.normal), octahedral(sample.wo));
    let (brdf, wi) = (&widened(&brdfs[sample.brdf as usize], light), arriving.wi);
    let mut share = 1.0;
    if drawn_area > 0.0
        && brdf.alpha < NARROW_ALPHA
        && let Some(lobe) = brdf::Lobes::of_specular_lobe(brdf, n, wo)
    {
        let to_light = light.position.as_dvec3() - sample.position.as_dvec3();
        let solid_angle = match light.kind {
            LIGHT_DIRECTIONAL => drawn_area,
            _ => drawn_area * wi.dot(light.direction.as_dvec3()).abs() / to_light.length_squared(),
        };
        // Power heuristic [Veach 1995, Eq. 15].
        share = 1.0 / (1.0 + (solid_angle * lobe.at(wi).density).powi(2));
    }
    visibility * share * arriving.irradiance * light::color(light) * brdf::reflected(brdf, n, wi, wo)
}

/// With a lobe as wide as if the light had its size; see [`PackedLight::narrowing`].
pub fn widened(brdf: &Brdf, light: &PackedLight) -> Brdf {
    let is_wider = light.kind == LIGHT_DIRECTIONAL && light.narrowing > 0.0 && brdf.alpha > 0.0;
    let wider = (brdf.alpha * brdf.alpha + light.narrowing).min(1.0).sqrt();
    Brdf { alpha: if is_wider { wider } else { brdf.alpha }, ..*brdf }
}

/// Weighted sum of images, by pixel. Twin of sum_images.comp, and of composite.comp up to the tone map.
pub fn sum_images(terms: &[(Vec3, &[DVec3])], sum: &mut [DVec3]) {
    for (scale, image) in terms {
        for (total, pixel) in sum.iter_mut().zip(*image) {
            *total += scale.as_dvec3() * pixel;
        }
    }
}

/// Unit vector from its octahedral map [Cigolle 2014].
pub fn octahedral(e: Vec2) -> DVec3 {
    let e = e.as_dvec2();
    let z = 1.0 - e.x.abs() - e.y.abs();
    let sign = |x: f64| if x >= 0.0 { 1.0 } else { -1.0 };
    let (x, y) = if z >= 0.0 { (e.x, e.y) } else { ((1.0 - e.y.abs()) * sign(e.x), (1.0 - e.x.abs()) * sign(e.y)) };
    DVec3::new(x, y, z).normalize()
}
