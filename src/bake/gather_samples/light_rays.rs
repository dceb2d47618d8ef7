//! Rays from lights, for light that falls between the points of gather samples.
//!
//! The points of gather samples give the incident light accurately if each accounts for a small part of it. If a light
//! is so near or so narrow that its power falls on few points, or between them, rays from the light are used instead.
//! They are spread evenly over its solid angle, and each adds its power to the sample that it hits. At every place the
//! weights of the two techniques sum to one, as in multiple importance sampling [Veach 1995]. Where many points share
//! the light, the weight of rays is zero.

use std::f32::consts::{PI, TAU};

use glam::Vec3;
use rayon::prelude::*;

use super::{carries_light, is_back, normal_length, turned};
use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::brdf_factors::harmonics::MAX_FUNCTIONS;
use crate::physics::light::{cone, facet, window};
use crate::scene::light_filter::PosedFilter;
use crate::shared::{
    EVEN_SHARE, LIGHT_DIRECTIONAL, LIGHT_FACET, LIGHT_SPOT, LIGHT_TWO_SIDED_FACET, LightSample, PackedLight,
};
use crate::trace::linked::LinkedScene;
use crate::trace::point_tree::{PointTree, point};
use crate::trace::surface::SurfacePoint;

/// Rays per light: 2 / [`EVEN_SHARE`], the number of points per light at which the weight of rays becomes zero. Twice
/// as many change nothing (docs/accuracy.md).
pub const RAYS: usize = 512;
/// Maximum distance of a hit from the nearest point, in widths of its sample. Regions that do not contribute to the
/// picture have no samples: rays that hit there are discarded.
const REACH: f32 = 2.0;
/// Maximum ratio of the cosines to the shading normal and to the geometric normal, by which a ray is weighted.
const MAX_COSINES: f32 = 8.0;
/// Rotation about the light's axis between successive rays, in radians: 2 pi (1 - 1 / golden ratio).
const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// Finds the gather sample of a surface point.
pub struct LightRays {
    /// Over the points of all gather samples.
    tree: PointTree,
    /// Unit normal of each point.
    normals: Vec<Vec3>,
    normal_length: f32,
    points_per_sample: usize,
}

/// The contribution of a ray to a gather sample.
#[derive(Clone, Copy)]
struct LightRayHit {
    sample: usize,
    /// Unit, towards the light, in the sample's frame.
    wi: Vec3,
    /// At the sample, from a light of unit intensity; mesh space.
    irradiance: Vec3,
}

impl LightRays {
    /// `points` lists position and unit normal of each point, sample by sample; all samples have equally many points.
    pub fn new(samples: &[LightSample], points: impl ExactSizeIterator<Item = (Vec3, Vec3)>) -> Self {
        let points_per_sample = points.len() / samples.len().max(1);
        let normal_length = normal_length(samples.iter().map(|s| s.area));
        let (places, normals): (Vec<_>, _) =
            points.map(|(p, normal)| (point(p, normal, normal_length), normal)).unzip();
        Self { tree: PointTree::new(&places), normals, normal_length, points_per_sample }
    }

    /// Computes the coefficients of `samples` due to rays of a light at unit intensity, which start at its points
    /// `lights` in turn. Calls `add` with the index of
    /// each nonzero coefficient, in ascending order within a sample.
    pub fn shade<'a>(
        &self,
        scene: impl Into<LinkedScene<'a>>,
        samples: &[LightSample],
        projection: &HarmonicProjection,
        lights: &[PackedLight],
        filter: Option<&PosedFilter>,
        mut add: impl FnMut(u32, Vec3),
    ) {
        let Some(per_solid_angle) = per_solid_angle(&lights[0]).filter(|_| !samples.is_empty()) else { return };
        let scene = scene.into();
        let cast = |i| self.cast(scene, samples, (lights, filter), per_solid_angle, i);
        let mut rays: Vec<LightRayHit> = (0..RAYS).into_par_iter().with_min_len(16).flat_map_iter(cast).collect();
        rays.sort_by_key(|ray| ray.sample);
        // More samples than rays would need several surfaces along most rays.
        for of_sample in rays.chunk_by(|a, b| a.sample == b.sample).take(RAYS) {
            let sample = &samples[of_sample[0].sample];
            let (mut k, mut sums) = ([Vec3::ZERO; MAX_FUNCTIONS], [Vec3::ZERO; MAX_FUNCTIONS]);
            let count = (sample.degrees * sample.degrees) as usize;
            for ray in of_sample {
                projection.project(&sample.brdf, ray.wi, &mut k[..count]);
                sums.iter_mut().zip(&k[..count]).for_each(|(sum, k)| *sum += ray.irradiance * k);
            }
            (sample.first..).zip(&sums[..count]).for_each(|(index, sum)| add(index, *sum));
        }
    }

    /// Ray `i` of a spherical Fibonacci lattice [Keinert 2015]: all rays represent equal solid angles. Contributes to
    /// each surface up to the first that casts a shadow.
    fn cast(
        &self,
        scene: LinkedScene,
        samples: &[LightSample],
        (lights, filter): (&[PackedLight], Option<&PosedFilter>),
        per_solid_angle: f32,
        i: usize,
    ) -> impl Iterator<Item = LightRayHit> {
        let light = &lights[i % lights.len()];
        let widest = versine(light);
        let versine = widest * (i as f32 + 0.5) / RAYS as f32;
        let (sin, cos) = (GOLDEN_ANGLE * i as f32).sin_cos();
        let mut axis = light.direction.try_normalize().unwrap_or(Vec3::NEG_Z);
        if light.kind == LIGHT_TWO_SIDED_FACET && i / lights.len() % 2 == 1 {
            axis = -axis;
        }
        let (s, t) = axis.any_orthonormal_pair();
        let direction = axis * (1.0 - versine) + (s * cos + t * sin) * (versine * (2.0 - versine)).sqrt();
        scene.surfaces_met(light.position, direction).filter_map(move |hit| {
            if is_back(&scene, &hit, direction) {
                return None;
            }
            let surface = SurfacePoint::new(&scene, &hit, direction, self.normal_length / 2.0);
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
            let smooth = match light.kind {
                LIGHT_SPOT => cone(light, (2.0 * f64::from(versine)).sqrt()),
                LIGHT_FACET | LIGHT_TWO_SIDED_FACET => facet(light, 1.0 - f64::from(versine)),
                _ => 1.0,
            };
            let intensity = (smooth * window(light, hit.distance.into())) as f32;
            let area_of_point = sample.area / self.points_per_sample as f32;
            let share = intensity * cosine / (hit.distance * hit.distance) * area_of_point * per_solid_angle;
            let sides = if light.kind == LIGHT_TWO_SIDED_FACET { 2.0 } else { 1.0 };
            let power = light.strength * intensity * sides * TAU * widest / RAYS as f32 * scene.factor(hit.triangle);
            let irradiance = weight_of_rays(share) * power * (cosine / geometric).min(MAX_COSINES) / sample.area;
            let [s, t, n] =
                turned([sample.tangent, sample.normal.cross(sample.tangent), sample.normal], surface.normal);
            let wi = -Vec3::new(s.dot(direction), t.dot(direction), n.dot(direction));
            let irradiance = irradiance * filter.map_or(Vec3::ONE, |filter| filter.factor(direction));
            (irradiance != Vec3::ZERO).then_some(LightRayHit { sample: index, wi, irradiance })
        })
    }
}

/// Weight of rays at a place whose point receives the share `share` of a light's power, ignoring range and shadows.
/// Twin of glsl/shade_gather.comp.
pub fn weight_of_rays(share: f32) -> f32 {
    let x = (share / EVEN_SHARE - 0.5).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// A light's intensity along its axis divided by its power, in 1/sr. `None` for lights that cast no rays: directional
/// lights and cones of zero solid angle.
pub fn per_solid_angle(light: &PackedLight) -> Option<f32> {
    let power = match light.kind {
        LIGHT_DIRECTIONAL => 0.0,
        LIGHT_FACET | LIGHT_TWO_SIDED_FACET => {
            let edge = half_spread(light);
            let (sin, cos) = edge.sin_cos();
            // Integral of cos - sin / tan(edge) over the cone.
            let one_side = PI * (sin * sin - light.narrowing * (edge - sin * cos));
            if light.kind == LIGHT_TWO_SIDED_FACET { 2.0 * one_side } else { one_side }
        }
        _ => {
            let widest = versine(light);
            // The falloff is 1 inside the inner cone, then decreases to 0 along a parabola.
            let fall = if light.kind == LIGHT_SPOT { widest.min(1.0 / light.cone_scale) } else { 0.0 };
            TAU * (widest - fall + (fall * light.cone_scale).powi(2) * fall / 3.0)
        }
    };
    let inverse = 1.0 / power;
    inverse.is_finite().then_some(inverse)
}

/// 1 - cos of the angle between a light's axis and the edge of its cone; 2 if it has no cone.
pub fn versine(light: &PackedLight) -> f32 {
    match light.kind {
        LIGHT_SPOT => light.cone_versine,
        LIGHT_FACET | LIGHT_TWO_SIDED_FACET => 2.0 * (half_spread(light) / 2.0).sin().powi(2),
        _ => 2.0,
    }
}

/// Half of the angle into which a facet shines, in radians.
fn half_spread(light: &PackedLight) -> f32 {
    1f32.atan2(light.narrowing)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use glam::DVec3;

    use super::*;
    use crate::physics::light::incident;
    use crate::scene::{Light, LightKind, LightUnit, MeshSpace};

    /// Compares with the irradiance integrated over a sphere around the light.
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
            let lumens = light.per_intensity(LightUnit::Lumen).unwrap() * f64::from(packed.strength);
            assert!((got / lumens - 1.0).abs() < 1e-3, "{light:?}: {got}, lumens {lumens}");
        }
        assert!((1.0 / per_solid_angle(&point.pack(space)).unwrap() - 4.0 * PI as f32).abs() < 1e-5);
        // A narrow spot in a scene so large that its power overflows or underflows in single precision.
        assert!(per_solid_angle(&spot(0.0, 0.01).pack(MeshSpace { unit: 1e18, ..MeshSpace::WORLD })).is_some());
    }
}
