//! The estimate of indirect light at 64 view samples at a time.
//!
//! Light of a source that one surface reflects, or an emitter sends, to a view sample is found from both sides, and the
//! balance heuristic weighs what is found [Veach 1995, Eq. 14]:
//!
//! - Rays from the view samples. Where they hit, a source is chosen by what the cache knows, and a shadow ray decides.
//! - Points where photons landed, or that emit light, chosen by what they could send; shadow rays connect them to all
//!   64.
//!
//! Light that was reflected before is read from the cache where the rays hit; specular lobes there send the rays on.
//! Light of small sources that perfect mirrors throw on the view samples is the density of photons around them [Jensen
//! 1996].

use glam::{DVec3, Vec3};

use super::balance::Found;
use super::bounds::Bounds;
use super::irradiance_cache::IrradianceCache;
use super::photons::{LitPoint, Sent};
use super::sources::{MAX_SOLID_ANGLE, Source};
use super::surface_cells::SurfaceCells;
use crate::bake::DeepFramebuffer;
use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::fan::Fan;
use crate::physics::brdf::{self, Lobes};
use crate::physics::octahedral;
use crate::physics::sequence::{GOLDEN_RATIO, Points, SharedPoints};
use crate::shared::{Brdf, LIGHT_FACET, NO_BRDF, PackedLight};
use crate::trace::bvh::{Hit, TracedScene};
use crate::trace::light_surface::ArrivingLight;
use crate::trace::packet::common_origin::trace_common_origin;
use crate::trace::packet::{PACKET_SIZE, SamplePacket, trace_packets};
use crate::trace::photon_map::PhotonMap;
use crate::trace::surface::SurfacePoint;

/// Most rays of a view sample in one pass, and points that are connected to it.
pub const RAYS: u32 = 32;
/// Rays of a view sample before the points of all view samples are scrambled anew: 32 passes.
pub const RAYS_OF_STREAM: u32 = 1024;
/// Points of which these are chosen.
const CANDIDATES: usize = 1024;

/// Probability of choosing a source uniformly instead of by cached irradiance.
pub const BY_CHANCE: f64 = 0.2;
/// Vertices that share a point of a source with a size.
const VERTICES_A_POINT: usize = 8;
/// Surfaces after which only a share of the rays goes on, and that share.
const FREE_SURFACES: u32 = 8;
const FURTHER: f64 = 1.0 / 16.0;
/// Maximum probability with which other rays go on.
const MAX_SURVIVAL: f64 = 0.999;

/// What all estimates of a pass share.
pub struct Pass<'a> {
    pub scene: &'a TracedScene,
    pub framebuffer: &'a DeepFramebuffer,
    pub sources: &'a [Source],
    pub cells: &'a SurfaceCells,
    pub cache: &'a IrradianceCache,
    pub lit: &'a [LitPoint],
    /// Of each source.
    pub thrown: &'a [PhotonMap],
    /// Largest distance of such photons: fixed, and by distance from the eye; mesh space.
    pub reach: [f32; 2],
    /// Mesh space.
    pub eye: Vec3,
    /// Maximum number of perfect mirrors along a ray.
    pub layers: u32,
    /// One for each ray of a view sample.
    pub points: &'a SharedPoints,
    pub seed: u64,
    /// Number of the pass.
    pub number: u32,
}

/// Buffers that a thread reuses.
#[derive(Default)]
pub struct Scratch {
    fan: Fan,
    vertices: Vec<Vertex>,
    /// Points to connect, and how many times.
    chosen: Vec<(u32, f64)>,
}

/// A view sample that receives light.
struct Receiver<'a> {
    lane: usize,
    index: u32,
    position: Vec3,
    geometric_normal: Vec3,
    lobes: Lobes<'a>,
    normal: Vec3,
    wo: Vec3,
}

/// Where a ray looks for direct light of one source.
struct Vertex {
    lane: u8,
    source: u32,
    /// With its own normal, by which connections are chosen.
    surface: SurfacePoint,
    wo: DVec3,
    /// What its radiance is multiplied by; with the probability of the source.
    weight: DVec3,
    /// Probability of the source.
    chance: f64,
    /// Probability that the ray goes on by the specular lobe.
    goes_on: f64,
    /// Density of such rays by area; `None` if no connection finds them.
    density: Option<f64>,
    /// Neighbours in this order are close to each other as the source sees them.
    order: u32,
}

/// A surface that a ray left by its specular lobe.
struct Last {
    surface: SurfacePoint,
    cell: Option<u32>,
    /// Density of rays to it by area; `None` if no connection finds it.
    rays: Option<f64>,
    /// Density of the direction, 1/sr.
    density: f64,
}

impl Pass<'_> {
    /// Radiance of the view samples `64 chunk` and up, by source and lane, from sources of unit strength.
    pub fn gather(&self, chunk: usize, scratch: &mut Scratch) -> Vec<Vec3> {
        let mut sums = vec![DVec3::ZERO; self.sources.len() * PACKET_SIZE];
        let receivers = self.receivers(chunk);
        if receivers.is_empty() {
            return vec![Vec3::ZERO; sums.len()];
        }
        let bounds =
            self.choose(chunk, Bounds::of(&receivers, |receiver| (receiver.position, receiver.normal)), scratch);
        scratch.vertices.clear();
        receivers.iter().for_each(|receiver| self.cast(receiver, &bounds, scratch, &mut sums));
        self.light(chunk, &bounds, scratch, &mut sums);
        self.connect(chunk, &receivers, &bounds, scratch, &mut sums);
        self.receive_thrown(&receivers, &mut sums);
        sums.into_iter().map(DVec3::as_vec3).collect()
    }

    /// Rays of a view sample, and points that are connected to it.
    fn rays(&self) -> f64 {
        self.points.len() as f64
    }

    fn receivers(&self, chunk: usize) -> Vec<Receiver<'_>> {
        let DeepFramebuffer { samples, brdfs, geometric_normals, .. } = self.framebuffer;
        let first = chunk * PACKET_SIZE;
        let receiver = |index: usize| {
            let view = &samples[index];
            if view.brdf == NO_BRDF {
                return None;
            }
            let [normal, wo] = [view.normal, view.wo].map(octahedral::decode);
            let lobes =
                Lobes::new(&brdfs[view.brdf as usize], normal.as_dvec3().normalize(), wo.as_dvec3().normalize())?;
            let (position, geometric_normal) = (view.position, geometric_normals[index]);
            let lane = index - first;
            Some(Receiver { lane, index: index as u32, position, geometric_normal, lobes, normal, wo })
        };
        (first..(first + PACKET_SIZE).min(samples.len())).filter_map(receiver).collect()
    }

    /// Chooses points to connect, and how many of each.
    fn choose(&self, chunk: usize, mut bounds: Bounds, scratch: &mut Scratch) -> Bounds {
        let Scratch { chosen, .. } = scratch;
        chosen.clear();
        let count = CANDIDATES.min(self.lit.len() / 2);
        if count == 0 {
            return bounds;
        }
        let [offset, start, ..] = Points::new(self.seed ^ 1 << 40, chunk as u64).at(self.number, 0);
        let stride = self.lit.len() as f64 / count as f64;
        let candidate = |i: usize, offset: f64| ((i as f64 + offset) * stride) as usize % self.lit.len();
        let weight = |index: usize| {
            let lit = &self.lit[index];
            bounds.potential(&self.sources[lit.source as usize], &lit.surface, lit.light) / lit.density
        };
        // The normalization must not depend on the chosen points, so other candidates estimate it.
        let elsewhere = |i: usize| (offset + 0.5 + i as f64 * GOLDEN_RATIO).fract();
        let total: f64 = (0..count).map(|i| weight(candidate(i, elsewhere(i)))).sum();
        if total <= 0.0 {
            return bounds;
        }
        let mut left = start;
        for i in 0..count {
            let index = candidate(i, offset);
            left += self.rays() * weight(index) / total;
            let times = left.floor();
            if times > 0.0 {
                chosen.push((index as u32, times));
                left -= times;
            }
        }
        // Candidates stand for all points.
        bounds.per_potential = self.rays() / (stride * total);
        bounds
    }

    /// Casts the rays of one view sample.
    fn cast(&self, receiver: &Receiver, bounds: &Bounds, scratch: &mut Scratch, sums: &mut [DVec3]) {
        let Receiver { lane, index, position, geometric_normal, lobes, normal, wo } = receiver;
        let brdf = &self.framebuffer.brdfs[self.framebuffer.samples[*index as usize].brdf as usize];
        let scene = self.scene;
        let eye = (*normal, *wo, lobes.specular_share() as f32);
        let Scratch { fan, vertices, .. } = scratch;
        fan.draw(brdf, eye, Lobe::All, self.points, *index);
        let origin = off(scene, *position, *geometric_normal, *geometric_normal, 0.0);
        trace_common_origin(scene, origin, &mut fan.packets);
        let random = Points::new(self.seed ^ 2 << 40, u64::from(*index));
        for (number, weight, direction, hit) in fan.rays() {
            let hit = match direction.dot(*geometric_normal) < 0.0 {
                true => {
                    let origin = off(scene, *position, *geometric_normal, direction, 0.0);
                    scene.closest_hit(origin, direction, f32::INFINITY)
                }
                false => hit.map(|(hit, _)| hit),
            };
            let Some(hit) = hit else { continue };
            let at = lobes.at(direction.as_dvec3().normalize());
            let mut walk = Walk {
                pass: self,
                bounds,
                lane: *lane,
                random: |set| random.at(self.number * RAYS + number, set),
                vertices,
                sums,
            };
            walk.follow(hit, direction, weight.as_dvec3(), self.rays() * at.density);
        }
    }

    /// Adds direct light at the vertices.
    fn light(&self, chunk: usize, bounds: &Bounds, scratch: &mut Scratch, sums: &mut [DVec3]) {
        let vertices = &mut scratch.vertices;
        vertices.sort_unstable_by_key(|vertex| (vertex.source, vertex.order));
        let random = Points::new(self.seed ^ 3 << 40, chunk as u64);
        let mut number = 0;
        let mut visibility = [0; PACKET_SIZE];
        for of_source in vertices.chunk_by(|a, b| a.source == b.source) {
            let index = of_source[0].source as usize;
            let source = &self.sources[index];
            let count = if source.is_punctual() { PACKET_SIZE } else { VERTICES_A_POINT };
            for vertices in of_source.chunks(count) {
                let point = source.point(self.scene, random.at(self.number << 14 | number, 0));
                number += 1;
                let seen: Vec<_> = vertices.iter().map(|vertex| vertex.surface.facing(vertex.wo.as_vec3())).collect();
                let arriving: Vec<_> = seen.iter().map(|seen| source.arriving(self.scene, &point, seen)).collect();
                if arriving.iter().all(Option::is_none) {
                    continue;
                }
                visibility.fill(255);
                if source.casts_shadows() {
                    let packet = packet(seen.iter());
                    trace_packets(source.linked(self.scene), &point.packed, &[packet], &mut visibility);
                }
                for (((vertex, surface), arriving), visible) in vertices.iter().zip(&seen).zip(arriving).zip(visibility)
                {
                    let Some(arriving) = arriving.filter(|_| visible > 0) else { continue };
                    let mut found = Found { rays: vertex.density, chance: vertex.chance, ..Found::default() };
                    if vertex.density.is_some() {
                        let light = Sent::Reflected { wi: arriving.wi, irradiance: arriving.irradiance };
                        found.connections = bounds.connections(source, &vertex.surface, light);
                    }
                    let normal = surface.normal.as_dvec3();
                    let solid_angle = source.solid_angle(&point, surface.position, arriving.wi);
                    let lobes = Lobes::of_specular_lobe(&surface.brdf, normal, vertex.wo).filter(|_| solid_angle > 0.0);
                    let reflected = match lobes {
                        Some(lobes) => {
                            found.reflected(lobes.at(arriving.wi), vertex.goes_on * solid_angle, Found::by_point)
                        }
                        None => brdf::reflected(&surface.brdf, normal, arriving.wi, vertex.wo) * found.by_point(),
                    };
                    sums[index * PACKET_SIZE + usize::from(vertex.lane)] +=
                        vertex.weight * reflected * arriving.irradiance * (f64::from(visible) / 255.0);
                }
            }
        }
    }

    /// Connects the chosen points with all view samples.
    fn connect(&self, chunk: usize, receivers: &[Receiver], bounds: &Bounds, scratch: &Scratch, sums: &mut [DVec3]) {
        let mut visibility = [0; PACKET_SIZE];
        let packets = &self.framebuffer.packets[chunk..=chunk];
        for &(index, times) in &scratch.chosen {
            let lit = &self.lit[index as usize];
            let density = bounds.connections(&self.sources[lit.source as usize], &lit.surface, lit.light);
            let chance = match lit.light {
                // All that shines is seen where a ray hits.
                Sent::Emitted => 1.0,
                Sent::Reflected { .. } => {
                    let cell = self.cells.of_place(self.scene, &lit.surface);
                    self.chances(cell).nth(lit.source as usize).expect("of each source")
                }
            };
            let geometric_normal = lit.surface.geometric_normal.as_dvec3();
            let light = PackedLight {
                position: lit.surface.position + lit.surface.geometric_normal * self.scene.bvh.shadow_offset(0.0),
                kind: LIGHT_FACET,
                direction: lit.surface.geometric_normal,
                ..bytemuck::Zeroable::zeroed()
            };
            trace_packets(self.scene, &light, packets, &mut visibility);
            for receiver in receivers {
                let visible = visibility[receiver.lane];
                if visible == 0 {
                    continue;
                }
                let between = lit.surface.position.as_dvec3() - receiver.position.as_dvec3();
                let distance2 = between.length_squared();
                if distance2 <= 0.0 {
                    continue;
                }
                let wi = between / distance2.sqrt();
                let leaving = -geometric_normal.dot(wi);
                if leaving <= 0.0 {
                    continue;
                }
                let at = receiver.lobes.at(wi);
                let by_area = leaving / distance2;
                let rays = self.rays() * at.density * by_area;
                let found = Found { rays: Some(rays), chance, connections: density, ..Found::default() };
                let radiance = match lit.light {
                    Sent::Emitted => (lit.surface.coverage * lit.surface.emission).as_dvec3() * found.by_connection(),
                    Sent::Reflected { wi: from, irradiance } => {
                        let normal = lit.surface.facing(-wi.as_vec3()).normal.as_dvec3();
                        let cosine = -normal.dot(wi);
                        if cosine <= 0.0 {
                            continue;
                        }
                        let brdf = &lit.surface.brdf;
                        let lobes = Lobes::of_specular_lobe(brdf, normal, -wi).filter(|_| lit.solid_angle > 0.0);
                        irradiance
                            * match lobes {
                                Some(lobes) => {
                                    let goes_on =
                                        brdf::specular_reflectance(brdf, cosine).max_element().min(MAX_SURVIVAL);
                                    found.reflected(lobes.at(from), goes_on * lit.solid_angle, Found::by_connection)
                                }
                                None => brdf::reflected(brdf, normal, from, -wi) * found.by_connection(),
                            }
                    }
                };
                let value = at.sum() * radiance * (times * by_area / density);
                sums[lit.source as usize * PACKET_SIZE + receiver.lane] += value * (f64::from(visible) / 255.0);
            }
        }
    }

    /// Adds light that perfect mirrors throw on the view samples.
    fn receive_thrown(&self, receivers: &[Receiver], sums: &mut [DVec3]) {
        let [fixed, growing] = self.reach;
        for (source, photons) in self.thrown.iter().enumerate().filter(|(_, photons)| !photons.is_empty()) {
            for Receiver { lane, position, geometric_normal, lobes, .. } in receivers {
                let reach = fixed + growing * position.distance(self.eye);
                photons.arriving(*position, *geometric_normal, reach * reach, |wi, irradiance| {
                    sums[source * PACKET_SIZE + lane] += lobes.at(wi).sum() * irradiance;
                });
            }
        }
    }

    /// Of each source the probability that it is chosen in a cell.
    fn chances(&self, cell: Option<u32>) -> impl Iterator<Item = f64> {
        let known = cell.map(|cell| self.cache.direct(cell));
        let power = move |i: usize| known.map_or(0.0, |known| self.sources[i].scale * f64::from(known[i]));
        let count = self.sources.len();
        let total: f64 = (0..count).map(power).sum();
        let by_chance = if total > 0.0 { BY_CHANCE } else { 1.0 };
        (0..count).map(move |i| {
            let known = if total > 0.0 { power(i) / total } else { 0.0 };
            by_chance / count as f64 + (1.0 - by_chance) * known
        })
    }
}

/// A ray on its way through specular lobes.
struct Walk<'a, R: Fn(u32) -> [f64; 4]> {
    pass: &'a Pass<'a>,
    bounds: &'a Bounds,
    lane: usize,
    random: R,
    vertices: &'a mut Vec<Vertex>,
    sums: &'a mut [DVec3],
}

impl<R: Fn(u32) -> [f64; 4]> Walk<'_, R> {
    /// Collects light from the first hit on. `density`: of rays per solid angle.
    fn follow(&mut self, mut hit: Hit, mut direction: Vec3, mut weight: DVec3, density: f64) {
        let Pass { scene, cells, cache, layers, sources, .. } = *self.pass;
        let mut density = Some(density);
        let mut mirrors = 0;
        // Whether nothing but mirrors was met.
        let mut is_straight = true;
        let mut last: Option<Last> = None;
        for number in 0.. {
            let surface = SurfacePoint::new(scene, &hit, direction, 0.0);
            let seen = surface.facing(-direction);
            let wo = -direction.as_dvec3().normalize();
            let facing = surface.geometric_normal.as_dvec3().dot(wo);
            let distance2 = f64::from(hit.distance * hit.distance) * direction.as_dvec3().length_squared();
            // Density by area, if connections can find this place, too.
            let by_area = density.map(|density| density * facing / distance2);
            let by_area = by_area.filter(|by_area| *by_area > 0.0 && by_area.is_finite());
            if surface.emission != Vec3::ZERO {
                match &last {
                    Some(last) => self.emission_by_lobe(&surface, weight, last, facing.max(0.0) / distance2, direction),
                    None => self.emission(&surface, weight, by_area),
                }
            }
            let normal = seen.normal.as_dvec3();
            let cosine = normal.dot(wo);
            if cosine <= 0.0 {
                return;
            }
            let [choice, u, v, survival] = (self.random)(number);
            let cell = cells.of_place(scene, &surface);
            let specular = brdf::specular_reflectance(&surface.brdf, cosine);
            let further = if number == FREE_SURFACES { FURTHER } else { 1.0 };
            let goes_on = specular.max_element().min(MAX_SURVIVAL) * further;
            if surface.brdf.reflects_directly() {
                self.vertex((&surface, cell), wo, weight, (by_area, goes_on), choice);
                let diffuse = Brdf { f0: Vec3::ZERO, f90: 0.0, ..surface.brdf };
                if let Some(cell) = cell.filter(|_| diffuse.diffuse != Vec3::ZERO) {
                    let albedo = HarmonicProjection::get().albedo(&diffuse, cosine as f32).as_dvec3();
                    let radiance = weight * albedo * std::f64::consts::FRAC_1_PI;
                    for (source, irradiance) in cache.reflected(cell).enumerate() {
                        self.sums[source * PACKET_SIZE + self.lane] += radiance * irradiance.as_dvec3();
                    }
                }
            }
            if survival >= goes_on {
                return;
            }
            if surface.brdf.has_lobe() {
                let Some(lobes) = Lobes::of_specular_lobe(&surface.brdf, normal, wo) else { return };
                let Some(wi) = lobes.sample([u, v, 0.0]) else { return };
                let at = lobes.at(wi);
                weight *= at.specular / (at.density * goes_on);
                direction = wi.as_vec3();
                is_straight = false;
                last = Some(Last { surface, cell, rays: by_area, density: goes_on * at.density });
            } else {
                last = None;
                mirrors += 1;
                if mirrors > layers {
                    return;
                }
                weight *= specular / goes_on;
                direction = seen.mirrored(wo.as_vec3());
            }
            density = None;
            let origin = off(scene, surface.position, surface.geometric_normal, direction, hit.distance);
            let next = scene.closest_hit(origin, direction, f32::INFINITY);
            let end = next.map_or(f32::INFINITY, |hit| hit.distance);
            // Shadow rays find no lights in a perfect mirror. Photons bring small ones.
            let looked_for = |source: &Source| !(is_straight && source.is_small(scene));
            for (index, source) in sources.iter().enumerate().filter(|(_, source)| looked_for(source)) {
                let Some(ArrivingLight { radiance, density }) =
                    source.seen(scene, surface.triangle, [origin, direction], end)
                else {
                    continue;
                };
                let solid_angle = density.recip().min(MAX_SOLID_ANGLE);
                let share =
                    last.as_ref().map_or(1.0, |last| self.share_of_lobe(index, last, direction, radiance, solid_angle));
                self.sums[index * PACKET_SIZE + self.lane] += weight * radiance * share;
            }
            let Some(next) = next else { return };
            hit = next;
        }
    }

    fn emission(&mut self, surface: &SurfacePoint, weight: DVec3, by_area: Option<f64>) {
        let sources = self.pass.sources;
        let radiance = surface.emission.as_dvec3();
        for (index, source) in sources.iter().enumerate().filter(|(_, source)| source.emits(surface.material)) {
            let share = by_area
                .map_or(1.0, |by_area| by_area / (by_area + self.bounds.connections(source, surface, Sent::Emitted)));
            self.sums[index * PACKET_SIZE + self.lane] += weight * radiance * share;
        }
    }

    /// Light of emitters that the specular lobe of the last surface found. `by_distance`: cosine of the direction at the
    /// emitter over squared distance.
    fn emission_by_lobe(
        &mut self,
        surface: &SurfacePoint,
        weight: DVec3,
        last: &Last,
        by_distance: f64,
        direction: Vec3,
    ) {
        let pass = self.pass;
        let radiance = surface.emission.as_dvec3();
        for (index, source) in pass.sources.iter().enumerate().filter(|(_, source)| source.emits(surface.material)) {
            let solid_angle = by_distance / source.point_density(pass.scene, surface.material);
            let share = self.share_of_lobe(index, last, direction, radiance, solid_angle);
            self.sums[index * PACKET_SIZE + self.lane] += weight * radiance * share;
        }
    }

    /// Weight of light that the specular lobe of the last surface found, and points of its source could have, each of
    /// which stands for a `solid_angle` there.
    fn share_of_lobe(&self, index: usize, last: &Last, direction: Vec3, radiance: DVec3, solid_angle: f64) -> f64 {
        let pass = self.pass;
        let chance = pass.chances(last.cell).nth(index).expect("of each source");
        let light = Sent::Reflected { wi: direction.as_dvec3(), irradiance: radiance * solid_angle };
        let connections =
            last.rays.map_or(0.0, |_| self.bounds.connections(&pass.sources[index], &last.surface, light));
        Found { rays: last.rays, chance, by_lobe: last.density * solid_angle, connections }.by_lobe()
    }

    fn vertex(
        &mut self,
        (surface, cell): (&SurfacePoint, Option<u32>),
        wo: DVec3,
        weight: DVec3,
        (density, goes_on): (Option<f64>, f64),
        choice: f64,
    ) {
        let pass = self.pass;
        let (source, chance) = match pass.sources.len() {
            0 => return,
            1 => (0, 1.0),
            _ => {
                let mut left = choice;
                let mut picked = None;
                for (i, chance) in pass.chances(cell).enumerate() {
                    picked = Some((i, chance));
                    if left < chance {
                        break;
                    }
                    left -= chance;
                }
                picked.expect("there are sources")
            }
        };
        self.vertices.push(Vertex {
            lane: self.lane as u8,
            source: source as u32,
            surface: *surface,
            wo,
            weight: weight / chance,
            chance,
            goes_on,
            density,
            order: along_curve(surface.position),
        });
    }
}

/// Surface points as receivers of shadow rays.
fn packet<'a>(surfaces: impl Iterator<Item = &'a SurfacePoint>) -> SamplePacket {
    let mut packet = SamplePacket::default();
    for (lane, surface) in surfaces.enumerate() {
        let position = surface.lifted();
        for axis in 0..3 {
            packet.position[axis][lane] = position[axis];
            packet.normal[axis][lane] = surface.normal[axis];
            packet.geometric_normal[axis][lane] = surface.geometric_normal[axis];
        }
    }
    packet
}

/// Place along a Z-order curve through the scene.
fn along_curve(position: Vec3) -> u32 {
    let spread = |x: f32| {
        let x = ((0.5 + 0.5 * x).clamp(0.0, 1.0) * 1023.0) as u32;
        (0..10).map(|bit| (x >> bit & 1) << (3 * bit)).sum::<u32>()
    };
    spread(position.x) | spread(position.y) << 1 | spread(position.z) << 2
}

/// Origin of a ray: off the surface, to the side of its direction.
fn off(scene: &TracedScene, position: Vec3, geometric_normal: Vec3, direction: Vec3, distance: f32) -> Vec3 {
    position + geometric_normal * scene.bvh.shadow_offset(distance).copysign(geometric_normal.dot(direction))
}
