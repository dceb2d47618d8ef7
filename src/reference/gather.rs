//! Direct light at gather samples: λ0 [Yang 2007, Section 4.3], with the cosine that is missing there.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::light;
use crate::bake::brdf_factors::Projection;
use crate::bake::bvh::Bvh;
use crate::bake::gather_samples::GatherSamples;
use crate::bake::packet::{PACKET_SIZE, trace_all};
use crate::bake::transfer::level::{Level, local};
use crate::bake::transfer::thesis::Thesis;
use crate::scene::Scene;
use crate::shared::PackedLight;

/// Coefficients that a light at unit intensity leaves in a level's samples: the mean over each sample's points.
pub fn shade(scene: &Scene, bvh: &Bvh, level: &Level, light: &PackedLight) -> Vec<DVec3> {
    let project = |sample: usize, wi: Vec3, values: &mut [Vec3]| {
        Projection::get().project(&level.samples.samples[sample].brdf, wi, values);
    };
    shade_with(scene, bvh, &level.samples, &level.first, project, light)
}

/// [`shade`] with the thesis's factors.
pub fn shade_thesis(scene: &Scene, bvh: &Bvh, thesis: &Thesis, light: &PackedLight) -> Vec<DVec3> {
    let project = |sample: usize, wi: Vec3, values: &mut [Vec3]| thesis.project(sample, wi, values);
    shade_with(scene, bvh, &thesis.samples, &thesis.first, project, light)
}

/// `project` gives k of a sample for a direction in its frame; its coefficients are `first[i]..first[i + 1]`.
fn shade_with(
    scene: &Scene,
    bvh: &Bvh,
    samples: &GatherSamples,
    first: &[u32],
    project: impl Fn(usize, Vec3, &mut [Vec3]) + Sync,
    light: &PackedLight,
) -> Vec<DVec3> {
    let packets = samples.packets();
    let mut visibility = vec![0; packets.len() * PACKET_SIZE];
    trace_all(bvh, scene, light, &packets, &mut visibility);
    let coefficients = |i: usize| {
        let sample = &samples.samples[i];
        let mut k = vec![Vec3::ZERO; (first[i + 1] - first[i]) as usize];
        let mut sum = vec![DVec3::ZERO; k.len()];
        for (p, point) in samples.points_of(i).iter().enumerate() {
            let Some(arriving) = light::incident(light, point.position.as_dvec3()) else { continue };
            let wi = local(&point.frame(sample), arriving.wi.as_vec3());
            if visibility[i * samples.points_per_sample + p] == 0 || wi.z <= 0.0 {
                continue;
            }
            project(i, wi, &mut k);
            let irradiance = arriving.irradiance * f64::from(wi.z) / samples.points_per_sample as f64;
            sum.iter_mut().zip(&k).for_each(|(sum, k)| *sum += irradiance * k.as_dvec3());
        }
        sum
    };
    (0..samples.len()).into_par_iter().flat_map_iter(coefficients).collect()
}
