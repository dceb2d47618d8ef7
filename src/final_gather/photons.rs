//! Photons: light that leaves the sources and bounces, and where it lands [Jensen 1996].

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::guide::Guide;
use super::sources::Source;
use super::surface_cells::SurfaceCells;
use crate::bake::brdf_factors::HarmonicProjection;
use crate::physics::brdf::{self, Lobes};
use crate::physics::sequence::Points;
use crate::shared::ALBEDO_CAP;
use crate::trace::bvh::TracedScene;
use crate::trace::emitting_triangles::EmittingTriangles;
use crate::trace::photon_map::Photon;
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
    /// Solid angle that the point of the source stands for which shines on it; 0 if rays do not find the source.
    pub solid_angle: f64,
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

/// What photons meet.
#[derive(Clone, Copy)]
pub struct Surfaces<'a> {
    pub scene: &'a TracedScene,
    pub cells: &'a SurfaceCells,
    /// Sides of triangles that have no cells.
    pub hidden: &'a [bool],
    /// Where there may be perfect mirrors.
    pub mirrors: &'a EmittingTriangles,
}

/// A photon that lands on its first surface.
struct Start {
    source: u32,
    surface: SurfacePoint,
    wo: DVec3,
    power: DVec3,
    /// Whether perfect mirrors throw it on, or all else.
    by_mirrors: bool,
}

/// What photons find.
#[derive(Default)]
pub struct Photons {
    /// Neighbours are neighbours on their source.
    pub lit: Vec<LitPoint>,
    pub landings: Vec<Landing>,
    /// What came from a source by perfect mirrors, with the index of the source.
    pub thrown: Vec<(u32, Photon)>,
    /// Of photons that count: source, where they left it, and what they sent to the picture, in no unit.
    pub values: Vec<(u32, [f64; 2], f64)>,
    /// Bounces beyond those that all photons may make.
    pub further_bounces: u64,
}

/// Photons of a task.
const TASK: u32 = 1024;
/// Photons of a source, relative to those of them that set out towards mirrors.
const TO_MIRRORS: u32 = 2;
/// Bounces after which only a share of the photons goes on.
const FREE_BOUNCES: u32 = 8;
/// Growth of a photon's power at which it ends: where surfaces reflect more light than they receive there is no answer,
/// but a number.
const MAX_GROWTH: f64 = 100.0;
/// Largest ratio of cosines at the shading and at the geometric normal.
pub const MAX_TILT: f64 = 4.0;

impl Photons {
    /// What was reflected before.
    pub fn reflected(&self) -> impl Iterator<Item = &Landing> {
        self.landings.iter().filter(|landing| !landing.is_direct)
    }

    /// `counts[i]` photons of source i, which leave as its guide tells, are numbers `first[i]` and up in its sequence, and some more towards
    /// mirrors. The share `further` of them goes on after some bounces. Finds less if `stop` returns true.
    pub fn trace(
        surfaces: Surfaces,
        (sources, guides): (&[Source], &[Guide]),
        (counts, first): (&[u32], &[u32]),
        further: f64,
        seed: u64,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Self {
        let to_mirrors = |count: u32| if surfaces.mirrors.is_empty() { 0 } else { count.div_ceil(TO_MIRRORS) };
        let tasks = |(source, count): (usize, u32)| {
            let by_mirrors = [(false, count), (true, to_mirrors(count))];
            by_mirrors.into_iter().flat_map(move |(by_mirrors, count)| {
                (0..count.div_ceil(TASK)).map(move |task| (source, by_mirrors, count, task))
            })
        };
        let tasks: Vec<_> = counts.iter().copied().enumerate().flat_map(tasks).collect();
        let trace = |&(index, by_mirrors, count, task): &(usize, bool, u32, u32)| {
            let points = Points::new(seed ^ u64::from(by_mirrors) << 32, index as u64);
            let source = (index as u32, &sources[index]);
            let mut found = Self::default();
            if stop() {
                return found;
            }
            for i in task * TASK..(task * TASK + TASK).min(count) {
                let random = |set| points.at(first[index].wrapping_add(i), set);
                match by_mirrors {
                    true => found.throw(surfaces, source, (f64::from(count), further), random),
                    false => {
                        let value = found.follow(surfaces, source, &guides[index], (f64::from(count), further), random);
                        found.values.extend(value.map(|(place, value)| (index as u32, place, value)));
                    }
                }
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
            thrown: parts.iter().flat_map(|part| part.thrown.iter().copied()).collect(),
            values: parts.iter().flat_map(|part| part.values.iter().copied()).collect(),
            further_bounces: parts.iter().map(|part| part.further_bounces).sum(),
            landings: parts.into_iter().flat_map(|part| part.landings).collect(),
        }
    }

    /// Follows one of `count` photons. Returns where it left, and what it sends to the picture, if that is anything.
    fn follow(
        &mut self,
        surfaces: Surfaces,
        (index, source): (u32, &Source),
        guide: &Guide,
        (count, further): (f64, f64),
        random: impl Fn(u32) -> [f64; 4],
    ) -> Option<([f64; 2], f64)> {
        let scene = surfaces.scene;
        let before = self.landings.len();
        let at_source = random(0);
        let from = source.point(scene, at_source);
        let [u, v, w, _] = random(1);
        let (to, density) = guide.draw([u, v]);
        let order = match source.is_punctual() {
            true => along_curve(to),
            false => along_curve([at_source[0], at_source[1]]),
        };
        if let Some(emitting) = from.emitting {
            self.lit.push(LitPoint {
                source: index,
                surface: emitting.surface,
                light: Sent::Emitted,
                density: count * emitting.density,
                solid_angle: 0.0,
                order,
            });
        }
        let emission = from.emit(scene, [to[0], to[1], w]);
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
            let across = count * density * from.ray_density(scene, distance);
            let power = arriving.irradiance * (cosine / facing).min(MAX_TILT) / across;
            self.lit.push(LitPoint {
                source: index,
                surface,
                light: Sent::Reflected { wi: arriving.wi, irradiance: arriving.irradiance },
                density: across * facing.max(cosine / MAX_TILT),
                solid_angle: source.solid_angle(&from, surface.position, arriving.wi),
                order,
            });
            let start = Start { source: index, surface, wo, power, by_mirrors: false };
            self.bounce(surfaces, start, further, &random);
        });
        let value = |landing: &Landing| landing.power.max_element() * surfaces.cells.importance(landing.cell);
        let value = f64::from(self.landings[before..].iter().map(value).sum::<f32>());
        (value > 0.0 && value.is_finite()).then_some((to, value))
    }

    /// Follows one of `count` photons towards mirrors.
    fn throw(
        &mut self,
        surfaces: Surfaces,
        (index, source): (u32, &Source),
        (count, further): (f64, f64),
        random: impl Fn(u32) -> [f64; 4],
    ) {
        let Surfaces { scene, mirrors, .. } = surfaces;
        let from = source.point(scene, random(0));
        let [u, v, w, _] = random(1);
        let Some((triangle, barycentric)) = mirrors.place([u, v, w]) else { return };
        let [a, b, c] = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize]);
        let place = a + (b - a) * barycentric.x + (c - a) * barycentric.y;
        let Some(emission) = from.emit_towards(scene, place) else { return };
        source.lands(scene, &emission, |hit| {
            if hit.triangle != triangle {
                return;
            }
            let surface = SurfacePoint::new(scene, &hit, emission.direction, 0.0);
            let wo = -emission.direction.as_dvec3();
            let [cosine, facing] = [surface.normal, surface.geometric_normal].map(|n| n.as_dvec3().dot(wo));
            let Some(arriving) = source.arriving(scene, &from, &surface).filter(|_| facing > 0.0) else { return };
            let across = count * mirrors.area_density(surface.material) / facing;
            let power = arriving.irradiance * (cosine / facing).min(MAX_TILT) / across;
            let start = Start { source: index, surface, wo, power, by_mirrors: true };
            self.bounce(surfaces, start, further, &random);
        });
    }

    /// Follows power that lands on a surface and bounces.
    fn bounce(&mut self, surfaces: Surfaces, start: Start, further: f64, random: impl Fn(u32) -> [f64; 4]) {
        let Surfaces { scene, cells, hidden, .. } = surfaces;
        let Start { source, mut surface, mut wo, mut power, by_mirrors } = start;
        let mut is_thrown = by_mirrors;
        let mut most = MAX_GROWTH * power.max_element();
        for bounce in 0.. {
            self.further_bounces += u64::from(bounce > FREE_BOUNCES);
            let is_first = bounce == 0;
            if !(by_mirrors && is_first)
                && let Some(cell) = cells.of_landing(scene, hidden, &surface)
            {
                self.landings.push(Landing { cell, source, is_direct: is_first, power: power.as_vec3() });
            }
            let [u, v, choice, survival] = random(2 + bounce);
            let normal = surface.normal.as_dvec3();
            let cosine = normal.dot(wo);
            // At the first surface photons of two kinds have one part each.
            let mirrored = if is_first && !by_mirrors { DVec3::ZERO } else { brdf::mirror(&surface.brdf, cosine) };
            let lobes = Lobes::new(&surface.brdf, normal, wo);
            let by_lobes = if lobes.is_none() || is_first && by_mirrors {
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
                (surface.mirrored(wo.as_vec3()).as_dvec3(), mirrored / share)
            } else {
                is_thrown = false;
                let Some(lobes) = lobes else { return };
                let Some(wi) = lobes.sample([u, v, (choice - share) / (1.0 - share)]) else { return };
                let at = lobes.at(wi);
                let capped = HarmonicProjection::get().cap(&surface.brdf, cosine as f32).as_dvec3();
                (wi, at.sum() * capped / (at.density * (1.0 - share)))
            };
            // Light that arrives is symmetric at the shading normal, photons are not [Veach 1997, Section 5.3].
            let tilt = surface.geometric_normal.as_dvec3().dot(direction) / normal.dot(direction);
            if tilt <= 0.0 {
                return;
            }
            let (direction, factor) = (direction.as_vec3(), factor * tilt.min(MAX_TILT));
            let goes_on = if bounce == FREE_BOUNCES { further } else { 1.0 };
            let survives = factor.max_element().min(ALBEDO_CAP.into()) * goes_on;
            if survival >= survives {
                return;
            }
            power *= factor / survives;
            most /= goes_on;
            if power.max_element() > most {
                return;
            }
            let origin = surface.leave(direction, scene.bvh.shadow_offset(0.0));
            let Some(hit) = scene.closest_hit(origin, direction, f32::INFINITY) else { return };
            surface = SurfacePoint::new(scene, &hit, direction, 0.0);
            wo = -direction.as_dvec3();
            let [cosine, facing] = [surface.normal, surface.geometric_normal].map(|n| n.as_dvec3().dot(wo));
            if cosine <= 0.0 || facing <= 0.0 {
                return;
            }
            if is_thrown && surface.brdf.reflects_directly() {
                let SurfacePoint { position, geometric_normal, .. } = surface;
                let photon = Photon { position, geometric_normal, wi: wo.as_vec3(), flux: power.as_vec3() };
                self.thrown.push((source, photon));
            }
            power *= (cosine / facing).min(MAX_TILT);
        }
    }
}

/// Place along a Z-order curve of 2^16 x 2^16 cells.
fn along_curve([u, v]: [f64; 2]) -> u32 {
    let spread = |x: f64| {
        let x = (x * 65_536.0) as u64;
        (0..16).map(|bit| (x >> bit & 1) << (2 * bit)).sum::<u64>()
    };
    (spread(u) | spread(v) << 1) as u32
}
