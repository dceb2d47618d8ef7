//! f64 twins of the kernels, written from the physics: what tests hold the GLSL against, and what a path tracer uses.
//!
//! They take the packed inputs of [`crate::shared`], so that both sides start from the same numbers.

pub mod brdf;
pub mod composite;
pub mod light;

use glam::{DVec3, Vec3};

use crate::shared::{Brdf, ExtraPixel, ExtraSample, NO_BRDF, PackedLight, ViewSample};

/// Radiance of one view sample under one light at unit intensity; `visibility` in [0, 1]. Twin of shade_light.comp.
pub fn shade(sample: &ViewSample, brdfs: &[Brdf], visibility: f64, light: &PackedLight) -> DVec3 {
    if sample.brdf == NO_BRDF {
        return DVec3::ZERO;
    }
    let Some(arriving) = light::incident(light, sample.position.as_dvec3()) else { return DVec3::ZERO };
    let (n, wo) = (brdf::octahedral(sample.normal), brdf::octahedral(sample.wo));
    visibility * arriving.irradiance * brdf::reflected(&brdfs[sample.brdf as usize], n, arriving.wi, wo)
}

/// Adds the extra view samples to their pixels of a light's image. Twin of resolve.comp.
///
/// `image` is by pixel, `extras` the radiance of the extra samples; `layers` has bit l set where layer l counts.
pub fn resolve(
    pixels: &[ExtraPixel],
    indices: &[u32],
    samples: &[ExtraSample],
    extras: &[DVec3],
    layers: u32,
    image: &mut [DVec3],
) {
    for p in pixels {
        let listed = &indices[p.first as usize..][..p.count as usize];
        let counted = listed.iter().map(|&i| i as usize).filter(|&i| layers >> samples[i].layer.min(31) & 1 != 0);
        let deeper: DVec3 = counted.map(|i| samples[i].weight.as_dvec3() * extras[i]).sum();
        let pixel = &mut image[p.pixel as usize];
        *pixel = f64::from(p.first_weight) * *pixel + deeper;
    }
}

/// Weighted sum of images, by pixel. Twin of sum_images.comp, and of composite.comp up to the tone map.
pub fn sum_images(terms: &[(Vec3, &[DVec3])], sum: &mut [DVec3]) {
    for (scale, image) in terms {
        for (total, pixel) in sum.iter_mut().zip(*image) {
            *total += scale.as_dvec3() * pixel;
        }
    }
}
