//! Direct light at gather samples: λ0 [Yang 2007, Section 4.3], with the cosine that is missing there.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::light;
use crate::bake::brdf_factors::Projection;
use crate::bake::brdf_factors::harmonics::MAX_FUNCTIONS;
use crate::bake::bvh::Bvh;
use crate::bake::packet::{PACKET_SIZE, SamplePacket, trace_all};
use crate::bake::transfer::level::{Level, local};
use crate::scene::Scene;
use crate::shared::PackedLight;

/// Coefficients that a light at unit intensity leaves in a level's samples: the mean over each sample's points.
pub fn shade(scene: &Scene, bvh: &Bvh, level: &Level, light: &PackedLight) -> Vec<DVec3> {
    let samples = &level.samples;
    let visibility = trace(scene, bvh, level, light);
    let coefficients = |i: usize| {
        let sample = &samples.samples[i];
        let count = level.coefficients(i).len();
        let mut sum = [DVec3::ZERO; MAX_FUNCTIONS];
        let mut k = [Vec3::ZERO; MAX_FUNCTIONS];
        for (p, point) in samples.points_of(i).iter().enumerate() {
            let Some(arriving) = light::incident(light, point.position.as_dvec3()) else { continue };
            if visibility[i * samples.points_per_sample + p] == 0 {
                continue;
            }
            let wi = local(&point.frame(sample), arriving.wi.as_vec3());
            if wi.z <= 0.0 {
                continue;
            }
            Projection::get().project(&sample.brdf, wi, &mut k[..count]);
            let irradiance = arriving.irradiance * f64::from(wi.z) / samples.points_per_sample as f64;
            sum.iter_mut().zip(&k[..count]).for_each(|(sum, k)| *sum += irradiance * k.as_dvec3());
        }
        sum.into_iter().take(count)
    };
    (0..samples.len()).into_par_iter().flat_map_iter(coefficients).collect()
}

/// 255 for every point of every sample that sees the light and faces it.
fn trace(scene: &Scene, bvh: &Bvh, level: &Level, light: &PackedLight) -> Vec<u8> {
    let packets: Vec<SamplePacket> = level
        .samples
        .points
        .chunks(PACKET_SIZE)
        .map(|points| {
            let mut packet = SamplePacket::default();
            for (lane, point) in points.iter().enumerate() {
                for axis in 0..3 {
                    packet.position[axis][lane] = point.position[axis];
                    packet.normal[axis][lane] = point.normal[axis];
                    packet.geometric_normal[axis][lane] = point.geometric_normal[axis];
                }
            }
            packet
        })
        .collect();
    let mut visibility = vec![0; packets.len() * PACKET_SIZE];
    trace_all(bvh, scene, light, &packets, &mut visibility);
    visibility
}
