//! Rays from lights, for light that falls between the points of gather samples.
//!
//! Points tell what a light leaves in gather samples as long as each stands for a small part of it. Where a light is so near
//! or so narrow that it would all fall on few points, or between them, rays from the light tell instead: they are spread
//! evenly over its solid angle, and each brings its power to the sample that it meets. At every place the weights of the two
//! sum to one, as in multiple importance sampling [Veach 1995]; where many points share the light, that of rays
//! is zero.

use std::f32::consts::TAU;

use glam::Vec3;
use rayon::prelude::*;

use super::{carries_light, is_back, normal_length, turned};
use crate::bake::brdf_factors::Projection;
use crate::bake::brdf_factors::harmonics::MAX_FUNCTIONS;
use crate::physics::light::{cone, window};
use crate::shared::{EVEN_SHARE, LIGHT_DIRECTIONAL, LIGHT_SPOT, LightSample, PackedLight};
use crate::trace::bvh::TracedScene;
use crate::trace::point_tree::{PointTree, point};
use crate::trace::surface::SurfacePoint;

/// Rays of each light: one for each point where they begin to tell. Twice as many change nothing (docs/accuracy.md).
pub const RAYS: usize = 512;
/// How far from the nearest point a ray may end, in widths of its sample. No sample lies where nobody looks: what rays
/// meet there is nobody's.
const REACH: f32 = 2.0;
/// A ray counts for the ratio of its cosines to the shading normal and the geometric one, but never for more than this.
const MOST_COSINES: f32 = 8.0;
/// From one ray to the next about the light's axis, in radians: what is left of a turn by the golden ratio.
const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// Knows which gather sample a place belongs to.
pub struct LightRays {
    /// Over the points of gather samples.
    tree: PointTree,
    /// Of each point, unit.
    normals: Vec<Vec3>,
    normal_length: f32,
    points_per_sample: usize,
}

/// What a ray brings to a gather sample.
#[derive(Clone, Copy)]
struct LightRayHit {
    /// [`NOTHING`] for a ray that brings nothing to any.
    sample: usize,
    /// Unit, towards the light, in the sample's frame.
    wi: Vec3,
    /// Of the sample's surface, by a light of unit intensity; mesh space.
    irradiance: f32,
}

const NOTHING: usize = usize::MAX;

impl LightRays {
    /// `points` are position and unit normal of as many points of each sample in turn.
    pub fn new(samples: &[LightSample], points: impl ExactSizeIterator<Item = (Vec3, Vec3)>) -> Self {
        let points_per_sample = points.len() / samples.len().max(1);
        let normal_length = normal_length(samples.iter().map(|s| s.area));
        let (places, normals): (Vec<_>, _) =
            points.map(|(p, normal)| (point(p, normal, normal_length), normal)).unzip();
        Self { tree: PointTree::new(&places), normals, normal_length, points_per_sample }
    }

    /// What rays of `light` at unit intensity leave in coefficients of `samples`: calls `add` with the index of each
    /// coefficient that gets some, in ascending order.
    pub fn shade(
        &self,
        scene: &TracedScene,
        samples: &[LightSample],
        projection: &Projection,
        light: &PackedLight,
        mut add: impl FnMut(u32, Vec3),
    ) {
        let Some(per_solid_angle) = per_solid_angle(light).filter(|_| !samples.is_empty()) else { return };
        let mut rays = [LightRayHit { sample: NOTHING, wi: Vec3::ZERO, irradiance: 0.0 }; RAYS];
        rays.par_iter_mut().with_min_len(16).enumerate().for_each(|(i, ray)| {
            if let Some(caught) = self.cast(scene, samples, light, per_solid_angle, i) {
                *ray = caught;
            }
        });
        rays.sort_by_key(|ray| ray.sample);
        for of_sample in rays.chunk_by(|a, b| a.sample == b.sample) {
            let Some(sample) = samples.get(of_sample[0].sample) else { break };
            let (mut k, mut sums) = ([Vec3::ZERO; MAX_FUNCTIONS], [Vec3::ZERO; MAX_FUNCTIONS]);
            let count = (sample.degrees * sample.degrees) as usize;
            for ray in of_sample {
                projection.project(&sample.brdf, ray.wi, &mut k[..count]);
                sums.iter_mut().zip(&k[..count]).for_each(|(sum, k)| *sum += ray.irradiance * k);
            }
            (sample.first..).zip(&sums[..count]).for_each(|(index, sum)| add(index, *sum));
        }
    }

    /// Ray number `i` of a spherical Fibonacci lattice [Keinert 2015]: each stands for as much of the solid angle.
    fn cast(
        &self,
        scene: &TracedScene,
        samples: &[LightSample],
        light: &PackedLight,
        per_solid_angle: f32,
        i: usize,
    ) -> Option<LightRayHit> {
        let widest = versine(light);
        let versine = widest * (i as f32 + 0.5) / RAYS as f32;
        let (sin, cos) = (GOLDEN_ANGLE * i as f32).sin_cos();
        let axis = light.direction.try_normalize().unwrap_or(Vec3::NEG_Z);
        let (s, t) = axis.any_orthonormal_pair();
        let direction = axis * (1.0 - versine) + (s * cos + t * sin) * (versine * (2.0 - versine)).sqrt();
        let hit = scene.closest_hit(light.position, direction, f32::INFINITY)?;
        if is_back(scene, &hit, direction) {
            return None;
        }
        let surface = SurfacePoint::new(scene, &hit, direction, self.normal_length / 2.0);
        let [cosine, geometric] = [surface.normal, surface.geometric_normal].map(|normal| -normal.dot(direction));
        if cosine <= 0.0 || geometric <= 0.0 || !carries_light(&surface) {
            return None;
        }
        let place = point(surface.position, surface.normal, self.normal_length);
        let nearest = self.tree.nearest::<1>(&place, |i| self.normals[i as usize].dot(surface.normal) > 0.0);
        let &(distance2, nearest) = nearest.items().first()?;
        let index = nearest as usize / self.points_per_sample;
        let sample = &samples[index];
        let mean_width = 0.5 * self.normal_length;
        if distance2 > REACH * REACH * sample.area.max(mean_width * mean_width) {
            return None;
        }
        let smooth = if light.kind == LIGHT_SPOT { cone(light, (2.0 * f64::from(versine)).sqrt()) } else { 1.0 };
        let intensity = (smooth * window(light, hit.distance.into())) as f32;
        let area_of_point = sample.area / self.points_per_sample as f32;
        let share = intensity * cosine / (hit.distance * hit.distance) * area_of_point * per_solid_angle;
        let power = light.strength * intensity * TAU * widest / RAYS as f32;
        let irradiance = weight_of_rays(share) * power * (cosine / geometric).min(MOST_COSINES) / sample.area;
        let [s, t, n] = turned([sample.tangent, sample.normal.cross(sample.tangent), sample.normal], surface.normal);
        let wi = -Vec3::new(s.dot(direction), t.dot(direction), n.dot(direction));
        (irradiance > 0.0).then_some(LightRayHit { sample: index, wi, irradiance })
    }
}

/// Weight of rays at a place whose point answers for `share` of a light's power, range and shadows not counted. Twin of
/// glsl/shade_gather.comp.
pub fn weight_of_rays(share: f32) -> f32 {
    let x = (share / EVEN_SHARE - 0.5).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// A light's intensity along its axis over its power, in 1/sr; `None` for lights that cast no rays, directional ones and those
/// that light nothing.
pub fn per_solid_angle(light: &PackedLight) -> Option<f32> {
    let widest = versine(light);
    // Up to where it is 1 throughout, then along a parabola down to 0.
    let fall = if light.kind == LIGHT_SPOT { widest.min(1.0 / light.cone_scale) } else { 0.0 };
    let inner = widest - fall;
    let inverse = 1.0 / (TAU * (inner + (fall * light.cone_scale).powi(2) * fall / 3.0));
    (light.kind != LIGHT_DIRECTIONAL && inverse.is_finite()).then_some(inverse)
}

/// 1 - cos of the angle between a light's axis and the edge of what it shines into.
fn versine(light: &PackedLight) -> f32 {
    if light.kind == LIGHT_SPOT { light.cone_versine } else { 2.0 }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use glam::DVec3;

    use super::*;
    use crate::physics::light::incident;
    use crate::scene::{Light, LightKind, MeshSpace};

    /// Against what arrives on a sphere about the light.
    #[test]
    fn power_is_all_that_a_light_sends() {
        let space = MeshSpace { unit: 3.0, ..MeshSpace::WORLD };
        let point = Light::point("l", DVec3::new(1.0, -2.0, 0.5));
        let spot =
            |inner_angle, outer_angle| Light { kind: LightKind::Spot, inner_angle, outer_angle, ..point.clone() };
        for light in [point.clone(), spot(0.0, 0.3), spot(0.2, 1.5), spot(0.5, 0.5), spot(0.0, 0.01), spot(1.0, 3.1)] {
            let packed = light.pack(space);
            let axis = packed.direction.as_dvec3();
            let side = axis.any_orthonormal_vector();
            let steps = 1 << 20;
            let of_band = |i: usize| {
                let versine = f64::from(versine(&packed)) * (i as f64 + 0.5) / f64::from(steps);
                let direction = axis * (1.0 - versine) + side * (versine * (2.0 - versine)).sqrt();
                incident(&packed, packed.position.as_dvec3() + direction).unwrap().irradiance
            };
            let sum: f64 = (0..steps as usize).map(of_band).sum();
            let want = sum * 2.0 * PI * f64::from(versine(&packed)) / f64::from(steps);
            let got = f64::from(packed.strength) / f64::from(per_solid_angle(&packed).unwrap());
            assert!((got / want - 1.0).abs() < 1e-3, "{light:?}: {got}, want {want}");
        }
        assert!((1.0 / per_solid_angle(&point.pack(space)).unwrap() - 4.0 * PI as f32).abs() < 1e-5);
        // Of a narrow spot in a scene so large that its power is none that single precision holds.
        assert!(per_solid_angle(&spot(0.0, 0.01).pack(MeshSpace { unit: 1e18, ..MeshSpace::WORLD })).is_some());
    }
}
