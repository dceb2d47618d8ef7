//! Direct light at gather samples: λ0 [Yang 2007, Section 4.3], with the cosine factor that is missing there.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::gather_samples::GatherSamples;
use crate::bake::gather_samples::light_rays::{per_solid_angle, weight_of_rays};
use crate::bake::transport::level::{Level, local};
use crate::physics::light;
use crate::shared::PackedLight;
use crate::trace::bvh::TracedScene;
use crate::trace::packet::{PACKET_SIZE, trace_all};

/// Coefficients of a level's samples under a light of unit intensity: the mean over each sample's points, plus the
/// contribution of rays from the light between them.
pub fn shade(scene: &TracedScene, level: &Level, light: &PackedLight) -> Vec<DVec3> {
    let per_solid_angle = per_solid_angle(light).unwrap_or(0.0);
    let project = |sample: usize, wi: Vec3, irradiance: f64, values: &mut [Vec3]| {
        let sample = &level.samples.samples[sample];
        let share = (irradiance / f64::from(light.strength)) as f32 * sample.area * per_solid_angle;
        let rays = weight_of_rays(share);
        HarmonicProjection::get().project(&sample.direct_brdf, wi, values);
        values.iter_mut().for_each(|k| *k *= 1.0 - rays);
    };
    let mut coefficients = shade_with(scene, &level.samples, &level.first, project, light);
    level.light_rays.shade(
        scene,
        &level.light_samples,
        HarmonicProjection::get(),
        std::slice::from_ref(light),
        None,
        |index, value| {
            coefficients[index as usize] += value.as_dvec3();
        },
    );
    coefficients
}

/// `project` computes k of a sample from a direction in its frame and the point's contribution to the sample's
/// irradiance if all of the light is seen; the sample's coefficients are `first[i]..first[i + 1]`.
pub(in crate::bake) fn shade_with(
    scene: &TracedScene,
    samples: &GatherSamples,
    first: &[u32],
    project: impl Fn(usize, Vec3, f64, &mut [Vec3]) + Sync,
    light: &PackedLight,
) -> Vec<DVec3> {
    let packets = samples.packets();
    let mut visibility = vec![0; packets.len() * PACKET_SIZE];
    trace_all(scene, light, &packets, &mut visibility);
    let coefficients = |i: usize| {
        let sample = &samples.samples[i];
        let mut k = vec![Vec3::ZERO; (first[i + 1] - first[i]) as usize];
        let mut sum = vec![DVec3::ZERO; k.len()];
        for (p, point) in samples.points_of(i).iter().enumerate() {
            let seen = f64::from(visibility[i * samples.points_per_sample + p]) / 255.0;
            if seen == 0.0 {
                continue;
            }
            let Some(arriving) = light::incident(light, point.position.as_dvec3()) else { continue };
            let wi = arriving.wi.as_vec3();
            if point.normal.dot(wi) <= 0.0 {
                continue;
            }
            let wi_l = local(&point.frame(sample), wi);
            let irradiance = arriving.irradiance * f64::from(wi_l.z) / samples.points_per_sample as f64;
            project(i, wi_l, irradiance, &mut k);
            let irradiance = seen * irradiance * light::color(light);
            sum.iter_mut().zip(&k).for_each(|(sum, k)| *sum += irradiance * k.as_dvec3());
        }
        sum
    };
    (0..samples.len()).into_par_iter().flat_map_iter(coefficients).collect()
}
