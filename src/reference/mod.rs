//! Double-precision twins of the kernels, derived from the physics, against which tests compare the GLSL; and a path
//! tracer.
//!
//! The twins take the packed structs of [`crate::shared`], so that their inputs equal those of the kernels.

pub mod composite;
pub mod path_tracer;

use glam::{DVec3, Vec2, Vec3};

use crate::physics::{brdf, light};
use crate::shared::{Brdf, NO_BRDF, PackedLight, ViewSample};

/// Radiance of one view sample under one light at unit intensity; `visibility` in [0, 1]. Twin of shade_light.comp.
pub fn shade(sample: &ViewSample, brdfs: &[Brdf], visibility: f64, light: &PackedLight) -> DVec3 {
    if sample.brdf == NO_BRDF {
        return DVec3::ZERO;
    }
    let Some(arriving) = light::incident(light, sample.position.as_dvec3()) else { return DVec3::ZERO };
    let (n, wo) = (octahedral(sample.normal), octahedral(sample.wo));
    visibility * arriving.irradiance * brdf::reflected(&brdfs[sample.brdf as usize], n, arriving.wi, wo)
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
