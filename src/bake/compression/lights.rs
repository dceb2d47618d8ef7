//! Random lights, placed as a user might: in free space and near surfaces, points and spots, some grazing.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};

use crate::bake::gather_samples::{GatherSample, GatherSamples};
use crate::bake::transport::LightTransport;
use crate::physics::sequence::Points;
use crate::scene::{Light, LightKind, MeshSpace};
use crate::shared::PackedLight;

/// Type of a random light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Of the sky, a broad glow.
    Point,
    /// Of the sky, a lamp in it. Half of the spots near a surface shine along it, all others towards a point of some
    /// surface.
    Spot,
}

/// Draws lights around the surfaces of a scene.
pub struct RandomLights<'a> {
    samples: &'a GatherSamples,
    /// Inclusive prefix sums of the samples' areas, in mesh space.
    areas: Vec<f64>,
    low: Vec3,
    high: Vec3,
    /// Range of distances of lights near a surface. No light is closer than the minimum to any sample.
    near: [f64; 2],
    points: Points,
}

/// [`RandomLights::near`] as a fraction of the diagonal of the scene's bounds.
const NEAR: [f64; 2] = [0.03, 0.2];
/// Low rooms have a smaller minimum: the height of the room (see [`height`]) divided by this.
const ROOM_HEIGHT_DIVISOR: f64 = 8.0;
/// Maximum number of samples that measure the height.
const HEIGHT_PROBES: usize = 256;
/// Maximum distance of free lights beyond the bounds of all surfaces, in diagonals.
const BEYOND: f32 = 0.15;

impl<'a> RandomLights<'a> {
    /// Different seeds give independent lights. There must be at least one fine sample.
    pub fn new(transfer: &'a LightTransport, seed: u64) -> Self {
        let samples = &transfer.fine.samples;
        let positions = || samples.samples.iter().map(|s| s.position);
        let (low, high) =
            (positions().fold(Vec3::INFINITY, Vec3::min), positions().fold(Vec3::NEG_INFINITY, Vec3::max));
        let diagonal = low.distance(high);
        let beyond = Vec3::splat(BEYOND * diagonal);
        let nearest = (NEAR[0] * f64::from(diagonal)).min(f64::from(height(transfer)) / ROOM_HEIGHT_DIVISOR);
        let mut area = 0.0;
        let add = |s: &GatherSample| {
            area += f64::from(s.area);
            area
        };
        let areas = samples.samples.iter().map(add).collect();
        let near = [nearest, nearest * NEAR[1] / NEAR[0]];
        Self { samples, areas, low: low - beyond, high: high + beyond, near, points: Points::new(seed, 0) }
    }

    /// Light number `index`, in mesh space; `None` if it is too close to a surface. It can be at a place where it
    /// lights nothing. Every fourth light is near a surface, the others are anywhere.
    pub fn light(&self, kind: Kind, index: u32) -> Option<PackedLight> {
        let set = |set: u32| self.points.at(index, 4 * set + u32::from(kind == Kind::Spot));
        let [x, y, z, which] = set(0);
        let near = self.pick(which);
        let near_surface = index.is_multiple_of(4);
        let position = if !near_surface {
            self.low.as_dvec3() + DVec3::new(x, y, z) * (self.high - self.low).as_dvec3()
        } else {
            near.0 + near.1 * (self.near[0] * (self.near[1] / self.near[0]).powf(x))
        };
        let least = (0.99 * self.near[0]) as f32;
        if self.samples.samples.iter().any(|s| s.position.distance(position.as_vec3()) < least) {
            return None;
        }
        let light = Light::point("", position);
        if kind == Kind::Point {
            return Some(light.pack(MeshSpace::WORLD));
        }
        let [u, v, width, edge] = set(1);
        let [grazing, target, ..] = set(2);
        let toward = (self.pick(target).0 - position).normalize_or(DVec3::NEG_Y);
        let direction = if near_surface && grazing < 0.5 {
            // Along the surface, and slightly towards it.
            let (s, t) = near.1.any_orthonormal_pair();
            ((TAU * u).cos() * s + (TAU * u).sin() * t - 0.3 * v * near.1).normalize()
        } else {
            toward
        };
        let outer_angle = PI / 180.0 * (10.0 + 35.0 * width);
        let inner_angle = outer_angle * (0.4 + 0.5 * edge);
        Some(Light { kind: LightKind::Spot, direction, outer_angle, inner_angle, ..light }.pack(MeshSpace::WORLD))
    }

    /// A random surface point and its normal.
    fn pick(&self, random: f64) -> (DVec3, DVec3) {
        let last = self.samples.len() - 1;
        let sample = self.areas.partition_point(|&area| area <= random * self.areas[last]);
        let sample = &self.samples.samples[sample.min(last)];
        (sample.position.as_dvec3(), sample.normal.as_dvec3())
    }
}

/// Distance within which two thirds of the samples hit a surface along their normals; infinite if more than a third hit
/// nothing.
fn height(transfer: &LightTransport) -> f32 {
    let samples = &transfer.fine.samples.samples;
    let sees = |sample: &GatherSample| {
        let offset = transfer.scene().bvh.shadow_offset(0.0);
        let origin = sample.position + offset * sample.normal;
        let hit = transfer.scene().closest_hit(origin, sample.normal, f32::INFINITY);
        hit.map_or(f32::INFINITY, |hit| hit.distance)
    };
    let mut distances: Vec<f32> = samples.iter().step_by(samples.len().div_ceil(HEIGHT_PROBES)).map(sees).collect();
    distances.sort_unstable_by(f32::total_cmp);
    distances[distances.len() * 2 / 3]
}
