//! One path from a visible surface: BRDF sampling with next-event estimation at each surface.

use glam::DVec3;

use super::PathTracer;
use super::aims::MirrorAims;
use super::film::{DIRECT, INDIRECT, INDIRECT_GLOSSY, REFLECTION, Sample};
use crate::bake::framebuffer::view_samples::PathVertex;
use crate::physics::brdf::{Lobes, mirror};
use crate::physics::sequence::Points;
use crate::shared::ALBEDO_CAP;
use crate::trace::surface::SurfacePoint;

/// Bounces before Russian roulette begins.
const SURE_BOUNCES: u32 = 3;
/// Maximum survival probability, so that paths between white surfaces end.
const MAX_SURVIVAL: f64 = ALBEDO_CAP as f64;
/// Throughput, relative to that at the pixel, at which a path ends: where surfaces reflect more light than they receive
/// there is no answer, but a number. Others hardly reach it.
const MAX_THROUGHPUT: f64 = 100.0;

/// Source of a path's random numbers.
#[derive(Clone, Copy)]
pub(super) struct PathRandom {
    pub points: Points,
    /// Index of the path among those of the pixel.
    pub index: u32,
}

impl PathRandom {
    /// Four numbers in [0, 1) for decision `which` at the `surface`th surface along the ray after `bounce` bounces.
    fn at(&self, which: u32, bounce: u32, surface: u32) -> [f64; 4] {
        self.points.at(self.index, bounce << 8 | surface << 2 | which)
    }
}

const DIRECTION: u32 = 0;
const SURFACE: u32 = 1;
const EMITTER: u32 = 2;
/// Points of area lights.
const LIGHT_POINT: u32 = 3;

/// A visible surface and its aims, shared by many paths.
pub(super) struct FirstHit {
    pub vertex: PathVertex,
    /// Number of surfaces before it on the path from the eye.
    pub number: u64,
    pub aims: MirrorAims,
}

/// Sums of the light that a path finds, multiplied by the path's throughput to the eye.
struct PathSums<'a> {
    sample: &'a mut Sample,
    /// Specular fraction, per channel, of the reflection at the first bounce.
    glossy: DVec3,
    /// Sum of the direct light of the path's first surface.
    direct: usize,
}

impl PathSums<'_> {
    /// Adds `light` of the light with index `source` in the rig, after `bounce` bounces; 0: direct light.
    fn add(&mut self, bounce: u32, source: usize, light: DVec3) {
        if bounce == 0 {
            return self.sample.add_light(self.direct, source, light);
        }
        self.sample.add_light(INDIRECT, source, light);
        self.sample[INDIRECT_GLOSSY] += light * self.glossy;
        self.sample.add_bounce(bounce, light);
    }
}

impl PathTracer<'_> {
    /// Traces one path and adds the indirect light that a visible surface reflects to `sample`, and the direct light of
    /// area lights; returns the number of
    /// rays without shadow rays.
    pub(super) fn follow(&self, seen: &FirstHit, random: PathRandom, sample: &mut Sample) -> u64 {
        let direct = if seen.vertex.layer == 0 { DIRECT } else { REFLECTION };
        let mut sums = PathSums { sample, glossy: DVec3::ZERO, direct };
        let weight = seen.vertex.weight.as_dvec3();
        let (mut point, mut wo, mut throughput) = (seen.vertex.point, seen.vertex.wo.as_dvec3(), weight);
        let mut segments = 0;
        let mut last_distance = 0.0;
        let mut later = MirrorAims::default();
        let have_sizes = self.lights.have_sizes();
        if have_sizes && self.settings.max_bounces == Some(0) {
            let [u, v, ..] = random.at(LIGHT_POINT, 0, 0);
            for (source, lit) in self.lights.reflect_points(self.scene, &point, wo, [u, v], |_| 0.0) {
                sums.add(0, source, throughput * lit);
            }
        }
        for bounce in 1..=self.settings.max_bounces.unwrap_or(u32::MAX) {
            let Some(lobes) = Lobes::new(&point.brdf, point.normal.as_dvec3(), wo) else { break };
            let [u, v, choice, survival] = random.at(DIRECTION, bounce, 0);
            if bounce > SURE_BOUNCES {
                let survives = (throughput / weight.max_element()).max_element().min(MAX_SURVIVAL);
                if survival >= survives {
                    break;
                }
                throughput /= survives;
            }
            let aims = if bounce == 1 {
                &seen.aims
            } else {
                self.mirrors.aim_at_planes(&mut later, &self.lights, &point);
                &later
            };
            if !self.emitters.triangles.is_empty() {
                let [a, b, c, _] = random.at(EMITTER, bounce, 0);
                if let Some((material, light)) = self.reflect_emitter(&point, &lobes, aims, [a, b, c]) {
                    self.emitters.add(sums.sample, material, throughput * light);
                }
            }
            if have_sizes {
                let [a, b, ..] = random.at(LIGHT_POINT, bounce, 0);
                let density = |wi| mixture(&lobes, aims, wi).1;
                for (source, lit) in self.lights.reflect_points(self.scene, &point, wo, [a, b], density) {
                    sums.add(bounce - 1, source, throughput * lit);
                }
            }
            let drawn = match choice < aims.share {
                true => Some(aims.draw(choice / aims.share, u, v)),
                false => lobes.sample([u, v, (choice - aims.share) / (1.0 - aims.share)]),
            };
            let Some(wi) = drawn else { break };
            let (reflected, density) = mixture(&lobes, aims, wi);
            if reflected.sum() == DVec3::ZERO {
                break;
            }
            if bounce == 1 {
                sums.glossy = share(reflected.specular, reflected.sum());
            }
            throughput *= reflected.sum() * (1.0 / density);
            if throughput.max_element() > MAX_THROUGHPUT * weight.max_element() {
                break;
            }

            let mut direction = wi.as_vec3();
            let mut origin = point.leave(direction, self.scene.bvh.shadow_offset(last_distance));
            let mut density = Some(density);
            let mut surface = 0;
            // Follows perfect mirrors up to a surface with other reflection.
            loop {
                segments += 1;
                let hit = self.scene.closest_hit(origin, direction, f32::INFINITY);
                if have_sizes {
                    let end = hit.map_or(f32::INFINITY, |hit| hit.distance);
                    for (source, light, own) in self.lights.met(self.scene, &point, [origin, direction], end) {
                        // Sampling lights cannot find those in a mirror; such light counts as indirect.
                        let (at, share) = match density {
                            Some(density) => (bounce - 1, density / (density + own)),
                            None => (bounce, 1.0),
                        };
                        sums.add(at, source, throughput * share * light);
                    }
                }
                let Some(hit) = hit else { return segments };
                last_distance = hit.distance;
                point = SurfacePoint::new(self.scene, &hit, direction, 0.0).facing(-direction);
                if point.emission.max_element() > 0.0 {
                    let looked_for = self.emitters.triangles.density(&point, direction, hit.distance);
                    let share = density.map_or(1.0, |density| density / (density + looked_for));
                    let emission = throughput * share * point.emission.as_dvec3();
                    self.emitters.add(sums.sample, point.material, emission);
                }
                wo = -direction.as_dvec3();
                let cosine = point.normal.as_dvec3().dot(wo);
                if cosine <= 0.0 {
                    return segments; // single-sided, seen from behind
                }
                surface += 1;
                let [light, branch, _, _] = match self.is_plain(&point) {
                    true => [0.0; 4],
                    false => random.at(SURFACE, bounce, surface),
                };
                if let Some((source, lit)) = self.lights.reflect_one(self.scene, &point, wo, light) {
                    sums.add(bounce, source, throughput * lit);
                }
                if have_sizes && self.settings.max_bounces == Some(bounce) {
                    let [a, b, ..] = random.at(LIGHT_POINT, bounce, surface);
                    for (source, lit) in self.lights.reflect_points(self.scene, &point, wo, [a, b], |_| 0.0) {
                        sums.add(bounce, source, throughput * lit);
                    }
                }

                let mirrored = mirror(&point.brdf, cosine);
                let through = if surface < self.settings.layers { mirrored.max_element() } else { 0.0 };
                let scattered = match self.settings.max_bounces {
                    Some(max) if bounce == max => 0.0,
                    _ if point.brdf.has_lobe() => 1.0,
                    _ => f64::from(point.brdf.diffuse.max_element()),
                };
                if through + scattered <= 0.0 {
                    return segments;
                }
                if through <= 0.0 {
                    break;
                }
                let share = through / (through + scattered);
                if branch >= share {
                    throughput /= 1.0 - share;
                    break;
                }
                throughput *= mirrored / share;
                let next = point.mirrored(-direction);
                origin = point.leave(next, self.scene.bvh.shadow_offset(hit.distance));
                direction = next;
                density = None; // emitter sampling cannot find emitters in a mirror
            }
        }
        segments
    }

    /// Whether a path needs no random numbers when it hits `point`: at most one light, no perfect mirror.
    fn is_plain(&self, point: &SurfacePoint) -> bool {
        self.lights.all.len() <= 1 && point.brdf.has_lobe()
    }

    /// Material and light of a sampled emitter, weighted by the balance heuristic against sampling the BRDF and aims.
    fn reflect_emitter(
        &self,
        point: &SurfacePoint,
        lobes: &Lobes,
        aims: &MirrorAims,
        u: [f64; 3],
    ) -> Option<(u32, DVec3)> {
        let drawn = self.emitters.triangles.draw(self.scene, &point.into(), u)?;
        let (reflected, density) = mixture(lobes, aims, drawn.wi);
        Some((drawn.material, reflected.sum() * drawn.emission / (drawn.density + density)))
    }
}

/// Reflection of light from `wi`, and the density of `wi` in the mixture of lobes and aims, 1/sr.
fn mixture(lobes: &Lobes, aims: &MirrorAims, wi: DVec3) -> (crate::physics::brdf::Reflected, f64) {
    let reflected = lobes.at(wi);
    let mut density = reflected.density;
    if aims.share > 0.0 {
        density += aims.share * (aims.density(wi) - density);
    }
    (reflected, density)
}

/// `part / whole` per channel; 0 if `whole` is 0.
fn share(part: DVec3, whole: DVec3) -> DVec3 {
    DVec3::select(whole.cmpgt(DVec3::ZERO), part / whole, DVec3::ZERO)
}
