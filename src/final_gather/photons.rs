//! Photons: light that leaves the sources and bounces, and where it lands [Jensen 1996].

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::sources::Source;
use super::surface_cells::SurfaceCells;
use crate::physics::brdf::{self, Lobes};
use crate::physics::sequence::Points;
use crate::trace::bvh::TracedScene;
use crate::trace::surface::SurfacePoint;

/// A surface point that sends light of a source: an end of paths that begin at view samples.
#[derive(Clone, Copy)]
pub struct LitPoint {
    /// Index of its source.
    pub source: u32,
    pub surface: SurfacePoint,
    pub light: Sent,
    /// Points like this by area, 1 / area in mesh space.
    pub density: f64,
    /// Z-order index of the place on the source; of the direction, if it has no size.
    order: u32,
}

impl LitPoint {
    fn order(&self) -> u64 {
        let is_emitted = u64::from(matches!(self.light, Sent::Emitted));
        u64::from(self.source) << 33 | is_emitted << 32 | u64::from(self.order)
    }
}

/// What a surface point sends.
#[derive(Clone, Copy)]
pub enum Sent {
    /// Light of a source that it reflects: from unit `wi`, RGB irradiance on a plane that faces it.
    Reflected { wi: DVec3, irradiance: DVec3 },
    /// What it emits itself.
    Emitted,
}

/// Power that lands in a cell of surface.
pub struct Landing {
    pub cell: u32,
    pub source: u32,
    /// Whether it comes straight from the source.
    pub is_direct: bool,
    /// RGB; irradiance times area in mesh space.
    pub power: Vec3,
}

/// What photons find.
#[derive(Default)]
pub struct Photons {
    /// Neighbours are neighbours on their source.
    pub lit: Vec<LitPoint>,
    pub landings: Vec<Landing>,
}

/// Photons of a task.
const TASK: u32 = 1024;
const MAX_BOUNCES: u32 = 64;
/// Largest ratio of cosines at the shading and at the geometric normal.
pub const MAX_TILT: f64 = 4.0;

impl Photons {
    /// `counts[i]` photons of source i, which are numbers `first[i]` and up in its sequence.
    pub fn trace(
        (scene, cells): (&TracedScene, &SurfaceCells),
        sources: &[Source],
        counts: &[u32],
        first: &[u32],
        seed: u64,
    ) -> Self {
        let tasks = |source: usize| (0..counts[source].div_ceil(TASK)).map(move |task| (source, task));
        let tasks: Vec<(usize, u32)> = (0..sources.len()).flat_map(tasks).collect();
        let trace = |&(index, task): &(usize, u32)| {
            let (count, first) = (counts[index], first[index]);
            let points = Points::new(seed, index as u64);
            let mut found = Self::default();
            for i in task * TASK..(task * TASK + TASK).min(count) {
                found.follow((scene, cells), (index as u32, &sources[index]), f64::from(count), |set| {
                    points.at(first.wrapping_add(i), set)
                });
            }
            found
        };
        let parts: Vec<Self> = tasks.par_iter().map(trace).collect();
        let mut order: Vec<(u64, u32, u32)> = Vec::new();
        for (part, found) in parts.iter().enumerate() {
            order.extend(found.lit.iter().enumerate().map(|(i, lit)| (lit.order(), part as u32, i as u32)));
        }
        order.par_sort_unstable();
        Self {
            lit: order.into_par_iter().map(|(_, part, i)| parts[part as usize].lit[i as usize]).collect(),
            landings: parts.into_iter().flat_map(|part| part.landings).collect(),
        }
    }

    /// Follows one of `count` photons.
    fn follow(
        &mut self,
        (scene, cells): (&TracedScene, &SurfaceCells),
        (index, source): (u32, &Source),
        count: f64,
        random: impl Fn(u32) -> [f64; 4],
    ) {
        let at_source = random(0);
        let from = source.point(scene, at_source);
        let to = random(1);
        let order = match source.is_punctual() {
            true => along_curve([to[0], to[1]]),
            false => along_curve([at_source[0], at_source[1]]),
        };
        if let Some(emitting) = from.emitting {
            self.lit.push(LitPoint {
                source: index,
                surface: emitting.surface,
                light: Sent::Emitted,
                density: count * emitting.density,
                order,
            });
        }
        let emission = from.emit(scene, [to[0], to[1], to[2]]);
        source.lands(scene, &emission, |hit| {
            let surface = SurfacePoint::new(scene, &hit, emission.direction, 0.0);
            let wo = -emission.direction.as_dvec3();
            let Some(arriving) = source.arriving(scene, &from, &surface) else { return };
            let cosine = surface.normal.as_dvec3().dot(wo);
            let facing = surface.geometric_normal.as_dvec3().dot(wo);
            if cosine <= 0.0 || facing <= 0.0 {
                return;
            }
            let distance = f64::from(from.packed.position.distance(surface.position));
            let across = count * from.ray_density(scene, distance);
            let power = arriving.irradiance * (cosine / facing).min(MAX_TILT) / across;
            self.lit.push(LitPoint {
                source: index,
                surface,
                light: Sent::Reflected { wi: arriving.wi, irradiance: arriving.irradiance },
                density: across * facing.max(cosine / MAX_TILT),
                order,
            });
            self.bounce((scene, cells), (index, source.is_punctual()), (surface, wo, power), &random);
        });
    }

    /// Follows power that lands on a surface and bounces.
    fn bounce(
        &mut self,
        (scene, cells): (&TracedScene, &SurfaceCells),
        (source, is_punctual): (u32, bool),
        (mut surface, mut wo, mut power): (SurfacePoint, DVec3, DVec3),
        random: impl Fn(u32) -> [f64; 4],
    ) {
        for bounce in 0..MAX_BOUNCES {
            if let Some(cell) = cells.of_place(surface.position, surface.geometric_normal) {
                self.landings.push(Landing { cell, source, is_direct: bounce == 0, power: power.as_vec3() });
            }
            let [u, v, choice, survival] = random(2 + bounce);
            let normal = surface.normal.as_dvec3();
            let cosine = normal.dot(wo);
            // What perfect mirrors throw of a light without size is left out, as by all other estimates.
            let is_thrown = bounce == 0 && is_punctual;
            let mirrored = if is_thrown { DVec3::ZERO } else { brdf::mirror(&surface.brdf, cosine) };
            let lobes = Lobes::new(&surface.brdf, normal, wo);
            let by_lobes = if lobes.is_none() {
                0.0
            } else if surface.brdf.has_lobe() {
                1.0
            } else {
                f64::from(surface.brdf.diffuse.max_element())
            };
            let by_mirror = mirrored.max_element();
            if by_lobes + by_mirror <= 0.0 {
                return;
            }
            let share = by_mirror / (by_lobes + by_mirror);
            let (direction, factor) = if choice < share {
                (surface.mirrored(wo.as_vec3()), mirrored / share)
            } else {
                let Some(lobes) = lobes else { return };
                let Some(wi) = lobes.sample([u, v, (choice - share) / (1.0 - share)]) else { return };
                let at = lobes.at(wi);
                // Light that arrives is symmetric at the shading normal, photons are not [Veach 1997, Section 5.3].
                let tilt = surface.geometric_normal.as_dvec3().dot(wi) / normal.dot(wi);
                if tilt <= 0.0 {
                    return;
                }
                (wi.as_vec3(), at.sum() * (tilt.min(MAX_TILT) / (at.density * (1.0 - share))))
            };
            let survives = factor.max_element().min(MAX_SURVIVAL);
            if survival >= survives {
                return;
            }
            power *= factor / survives;
            let origin = surface.leave(direction, scene.bvh.shadow_offset(0.0));
            let Some(hit) = scene.closest_hit(origin, direction, f32::INFINITY) else { return };
            surface = SurfacePoint::new(scene, &hit, direction, 0.0);
            wo = -direction.as_dvec3();
            let [cosine, facing] = [surface.normal, surface.geometric_normal].map(|n| n.as_dvec3().dot(wo));
            if cosine <= 0.0 || facing <= 0.0 {
                return;
            }
            power *= (cosine / facing).min(MAX_TILT);
        }
    }
}

/// Maximum probability that a photon goes on.
const MAX_SURVIVAL: f64 = 0.98;

/// Place along a Z-order curve of 2^16 x 2^16 cells.
fn along_curve([u, v]: [f64; 2]) -> u32 {
    let spread = |x: f64| {
        let x = (x * 65_536.0) as u64;
        (0..16).map(|bit| (x >> bit & 1) << (2 * bit)).sum::<u64>()
    };
    (spread(u) | spread(v) << 1) as u32
}
