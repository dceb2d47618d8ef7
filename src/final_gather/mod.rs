//! Final gathering: indirect light of a view, estimated anew for known lights, better with each pass [Jensen 1996].
//!
//! A pass sends photons from the lights, keeps the irradiance that they carry after a bounce in [cells](surface_cells),
//! and [gathers](gather) at all view samples: the first bounce by rays and connections, further ones from the cells.

mod balance;
mod bounds;
mod combine;
mod gather;
mod guide;
mod irradiance_cache;
mod photons;
mod refined;
mod sources;
mod surface_cells;

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

pub use self::combine::Combination;
pub use self::refined::{Estimate, Refined, mean};

use self::gather::{BY_CHANCE, Pass, RAYS, RAYS_OF_STREAM, Scratch};
use self::guide::Guide;
use self::irradiance_cache::IrradianceCache;
use self::photons::{Photons, Surfaces};
use self::sources::Source;
use self::surface_cells::SurfaceCells;
use crate::bake::DeepFramebuffer;
use crate::bake::framebuffer::view_samples::resolve;
use crate::bake::transport::importance::Visible;
use crate::physics::sequence::{SharedPoints, mix};
use crate::scene::{Camera, Emitters, Projection, Rig};
use crate::trace::bvh::TracedScene;
use crate::trace::emitting_triangles::EmittingTriangles;
use crate::trace::packet::PACKET_SIZE;
use crate::trace::photon_map::{Photon, PhotonMap};

/// Indirect light of a view under the lights of a rig.
pub struct FinalGather<'a> {
    scene: &'a TracedScene,
    framebuffer: &'a DeepFramebuffer,
    sources: Vec<Source>,
    /// Of each source.
    guides: Vec<Guide>,
    /// Where perfect mirrors may be.
    mirrors: EmittingTriangles,
    /// `None` before the first pass.
    visible: Option<Visible>,
    /// `None` before the first pass.
    lighting: Option<Lighting>,
    /// How often cells are halved at most.
    most_halvings: u32,
    seed: u64,
    /// Passes of others that the estimate will be joined with.
    others: u32,
    passes: u32,
    /// Of each source, photons in each half of the passes so far.
    photons: [Vec<u32>; 2],
    /// Share of the photons that goes on after some bounces.
    further: f64,
    /// Bounces that these would make in all passes if all photons did so, and number of photons.
    further_bounces: [f64; 2],
    /// Of each source, what its photons sent to the picture in all passes; at unit strength, in no unit.
    values: Vec<f64>,
    /// Of each 64 view samples, in their order.
    chunks: Vec<Chunk>,
}

/// What photons carry, in two independent halves.
struct Lighting {
    cells: SurfaceCells,
    halvings: u32,
    caches: [IrradianceCache; 2],
}

/// Sums of 64 view samples over two independent halves of the passes.
struct Chunk {
    /// `[half][source][lane]`.
    sums: Vec<Vec3>,
    /// Of each view sample.
    rays: [u32; 2],
    /// Whether further passes gather here.
    is_wanted: bool,
}

/// Photons of a pass for each view sample, and their number within bounds: all sources together.
const PHOTONS_A_SAMPLE: usize = 4;
const PHOTONS: [usize; 2] = [1 << 15, 1 << 18];
/// Share of the photons of a pass that tell, before the first one, where light goes and how often it bounces.
const PILOT: f64 = 1.0 / 16.0;
/// Eye paths that tell which sides of triangles are hidden.
const EYE_PATHS: usize = 1 << 15;
/// Bounces of a photon, in the mean, beyond those that all photons may make: in white rooms few photons go far.
const FURTHER_BOUNCES: f64 = 64.0;
/// Distance of photons that a view sample takes from a mirror, in pixels, in the first passes.
const REACH: f64 = 3.0;
/// Passes before the expected error can be relied on: that of fewer rays misses what few of them find.
pub const LEAST_PASSES: u32 = 4;
/// How often cells are halved.
const MOST_HALVINGS: u32 = 5;
/// Cells times sources beyond which they are not.
const MOST_CELLS: usize = 1 << 22;
/// Share of what a pass can gain for which it is made.
const FOCUS: f64 = 0.9;

impl<'a> FinalGather<'a> {
    /// Light of the `wanted` lights that are not off, by index in the complete rig. `others`: passes of other gathers
    /// that the estimate will be joined with. Panics if links of a light name what the scene lacks: see
    /// [`Rig::resolve_links`].
    pub fn new(
        scene: &'a TracedScene,
        framebuffer: &'a DeepFramebuffer,
        rig: &Rig,
        wanted: impl Fn(usize) -> bool,
        seed: u64,
        others: u32,
    ) -> Self {
        let sources = Source::of(scene, &Emitters::of(scene).complete(rig), wanted);
        let sums = || vec![Vec3::ZERO; 2 * sources.len() * PACKET_SIZE];
        let count = framebuffer.samples.len().div_ceil(PACKET_SIZE);
        Self {
            scene,
            framebuffer,
            mirrors: EmittingTriangles::new(scene, |material| f64::from(u8::from(scene.may_mirror(material)))),
            guides: sources.iter().map(|_| Guide::default()).collect(),
            visible: None,
            lighting: None,
            most_halvings: MOST_HALVINGS,
            // Others add numbers to it.
            seed: mix(seed),
            others,
            passes: 0,
            photons: [0, 1].map(|_| vec![0; sources.len()]),
            further: PILOT,
            further_bounces: [0.0; 2],
            values: vec![0.0; sources.len()],
            chunks: (0..count).map(|_| Chunk { sums: sums(), rays: [0; 2], is_wanted: true }).collect(),
            sources,
        }
    }

    /// Prepares cells as small as the number of passes allows, so that their bias vanishes with time. Returns whether
    /// there are any: not if `stop` returns true.
    fn prepare(&mut self, stop: &(dyn Fn() -> bool + Sync)) -> bool {
        // A halving takes 4 times the photons to fill the cells.
        let wanted = self.others.saturating_add(self.passes).max(1).ilog2() / 2;
        let is_as_wanted = |lighting: &Lighting| lighting.halvings >= wanted.min(self.most_halvings);
        if self.lighting.as_ref().is_some_and(is_as_wanted) {
            return true;
        }
        let (scene, framebuffer, seed) = (self.scene, self.framebuffer, self.seed);
        let look = || Visible::new(scene, framebuffer, framebuffer.asked_layers, EYE_PATHS, seed);
        let visible = self.visible.get_or_insert_with(look);
        let camera = &self.framebuffer.camera;
        let (mut cells, halvings) = loop {
            let halvings = wanted.min(self.most_halvings);
            if self.lighting.as_ref().is_some_and(|lighting| lighting.halvings == halvings) {
                return true;
            }
            let most = if halvings == 0 { usize::MAX } else { MOST_CELLS / self.sources.len().max(1) };
            match SurfaceCells::new(scene, camera, visible, halvings, &|cells| stop() || cells > most) {
                Some(cells) => break (cells, halvings),
                None if stop() => return false,
                None => self.most_halvings = halvings - 1,
            }
        };
        let counts = self.photon_counts(PILOT);
        let hidden = &self.visible.as_ref().expect("it was looked at").hidden;
        let surfaces = Surfaces { scene, cells: &cells, hidden, mirrors: &self.mirrors };
        let of_half = (&counts[..], &self.photons[0][..]);
        let seed = self.seed ^ u64::from(5 + halvings) << 40;
        let mut pilot = Photons::trace(surfaces, (&self.sources, &self.guides), of_half, self.further, seed, stop);
        if stop() {
            return false;
        }
        // Photons that fill the cells until the next ones are prepared, relative to those of the pilot.
        let ratio = f64::from(3 << (2 * halvings)) / 2.0 / PILOT;
        let joined = cells.join(pilot.reflected().map(|landing| landing.cell), ratio);
        pilot.landings.iter_mut().for_each(|landing| landing.cell = joined[landing.cell as usize]);
        let mut caches = [0, 1].map(|_| IrradianceCache::new(&cells, self.sources.len()));
        caches.iter_mut().for_each(|cache| cache.add_direct(&cells, &pilot.landings));
        self.learn(&counts, &pilot);
        self.lighting = Some(Lighting { cells, halvings, caches });
        true
    }

    /// Learns from photons which sources matter, and how many photons go on.
    fn learn(&mut self, counts: &[u32], photons: &Photons) {
        // Those of each source are neighbours.
        for of_source in photons.values.chunk_by(|a, b| a.0 == b.0) {
            let index = of_source[0].0 as usize;
            self.guides[index].learn(of_source.iter().map(|&(_, place, value)| (place, value)));
            self.values[index] += of_source.iter().map(|(.., value)| value).sum::<f64>();
        }
        let [bounces, count] = &mut self.further_bounces;
        *bounces += photons.further_bounces as f64 / self.further;
        *count += counts.iter().copied().map(f64::from).sum::<f64>();
        self.further = (FURTHER_BOUNCES * *count / *bounces).min(1.0);
    }

    /// The lights of the rig that have images, by index.
    pub fn lights(&self) -> impl Iterator<Item = usize> {
        self.sources.iter().map(|source| source.light)
    }

    pub fn passes(&self) -> u32 {
        self.passes
    }

    /// Makes one more pass; ends early if `stop` returns true.
    pub fn pass(&mut self, stop: &(dyn Fn() -> bool + Sync)) {
        if !self.prepare(stop) {
            return;
        }
        let half = (self.passes % 2) as usize;
        let number = self.passes / 2;
        let seed = self.seed ^ (1 + half as u64) << 48;
        let counts = self.photon_counts(1.0);
        let Lighting { cells, caches, .. } = self.lighting.as_mut().expect("it is prepared");
        let hidden = &self.visible.as_ref().expect("it is prepared").hidden;
        let surfaces = Surfaces { scene: self.scene, cells, hidden, mirrors: &self.mirrors };
        let of_half = (&counts[..], &self.photons[half][..]);
        let mut photons = Photons::trace(surfaces, (&self.sources, &self.guides), of_half, self.further, seed, stop);
        if stop() {
            return;
        }
        self.photons[half].iter_mut().zip(&counts).for_each(|(sum, count)| *sum = sum.wrapping_add(*count));
        caches[half].add_reflected(cells, &photons.landings);
        // A first look at the picture comes sooner.
        let rays = if number == 0 { RAYS / 8 } else { RAYS };
        let (round, first) = (number * RAYS / RAYS_OF_STREAM, number * RAYS % RAYS_OF_STREAM);
        let points = SharedPoints::of(seed ^ 4 << 40 ^ u64::from(round), first..first + rays, RAYS_OF_STREAM);
        // Photons of some pixels around at first, of fewer later [Knaus 2011].
        let pixels = REACH / f64::from(number + 1).powf(1.0 / 6.0);
        let camera = &self.framebuffer.camera;
        let height = f64::from(self.framebuffer.tiling.height) / pixels;
        let pass = Pass {
            scene: self.scene,
            framebuffer: self.framebuffer,
            sources: &self.sources,
            cells,
            cache: &caches[half],
            lit: &photons.lit,
            thrown: &photon_maps(self.scene, &self.sources, std::mem::take(&mut photons.thrown)),
            reach: width_of_strip(camera, self.scene, height).map(|width| width as f32),
            eye: self.scene.space.from_world(camera.ray(0.5, 0.5, 1.0).0).as_vec3(),
            layers: self.framebuffer.asked_layers,
            points: &points,
            seed,
            number,
        };
        let stopped = AtomicBool::new(false);
        let gather = |scratch: &mut Scratch, (index, chunk): (usize, &mut Chunk)| {
            if stopped.load(Ordering::Relaxed) || stop() {
                return stopped.store(true, Ordering::Relaxed);
            }
            if !chunk.is_wanted {
                return;
            }
            let found = pass.gather(index, scratch);
            let sums = &mut chunk.sums[half * found.len()..][..found.len()];
            let finite = sums.iter_mut().zip(found).filter(|(_, value)| value.is_finite());
            finite.for_each(|(sum, value)| *sum += value * rays as f32);
            chunk.rays[half] += rays;
        };
        self.chunks.par_iter_mut().enumerate().for_each_init(Scratch::default, gather);
        // Added after gathering: otherwise the probability of a source would depend on this pass's connections.
        caches[half].add_direct(cells, &photons.landings);
        self.learn(&counts, &photons);
        self.passes += 1;
    }

    /// Lets further passes gather where they lower the error most. `errors2`: expected squared errors of the pixels.
    pub fn focus(&mut self, errors2: &[f64]) {
        let tiling = &self.framebuffer.tiling;
        let tiles = self.framebuffer.pixel_stride() / PACKET_SIZE;
        let mut gains = vec![0.0; tiles];
        for (i, error2) in errors2.iter().enumerate() {
            let index = tiling.index(i as u32 % tiling.width, i as u32 / tiling.width);
            gains[index / PACKET_SIZE] += *error2;
        }
        // With n times the rays there is an n-th of the squared error.
        let rays = |chunk: &Chunk| f64::from(chunk.rays.iter().sum::<u32>().max(1));
        gains.iter_mut().zip(&self.chunks).for_each(|(gain, chunk)| *gain /= rays(chunk));
        let mut order: Vec<usize> = (0..tiles).collect();
        order.sort_by(|&a, &b| gains[b].total_cmp(&gains[a]));
        let mut left = FOCUS * gains.iter().sum::<f64>();
        self.chunks.iter_mut().take(tiles).for_each(|chunk| chunk.is_wanted = false);
        for tile in order {
            self.chunks[tile].is_wanted = true;
            left -= gains[tile];
            if left <= 0.0 {
                break;
            }
        }
    }

    /// Photons of each source in the next pass, or in a share of it: as its light matters in the scene.
    fn photon_counts(&self, share: f64) -> Vec<u32> {
        let value = |(source, value): (&Source, &f64)| source.scale * value;
        let total: f64 = self.sources.iter().zip(&self.values).map(value).sum();
        let even = 1.0 / self.sources.len() as f64;
        let [fewest, most] = PHOTONS;
        let count = share * (PHOTONS_A_SAMPLE * self.framebuffer.samples.len()).clamp(fewest, most) as f64;
        let photons = |of: (&Source, &f64)| {
            let known = if total > 0.0 { value(of) / total } else { even };
            (count * (BY_CHANCE * even + (1.0 - BY_CHANCE) * known)).max(1.0) as u32
        };
        self.sources.iter().zip(&self.values).map(photons).collect()
    }

    /// What the passes found of the light that is number `source` of [`Self::lights`].
    pub fn estimate(&self, source: usize) -> Estimate {
        let halves = [0, 1].map(|half| self.image(half, source));
        let rays = [0, 1].map(|half| self.pixels(|index| self.chunks[index / PACKET_SIZE].rays[half]));
        Estimate { halves, rays, passes: self.passes }
    }

    /// Indirect radiance of the pixels in one half of the passes, row by row, from the source that is number `source`
    /// of [`Self::lights`], at unit strength.
    pub fn image(&self, half: usize, source: usize) -> Vec<Vec3> {
        let of_chunk = |chunk: &Chunk| {
            let first = (half * self.sources.len() + source) * PACKET_SIZE;
            let share = 1.0 / f64::from(chunk.rays[half].max(1));
            let sums: Vec<DVec3> =
                chunk.sums[first..first + PACKET_SIZE].iter().map(|sum| sum.as_dvec3() * share).collect();
            sums
        };
        let mut samples: Vec<DVec3> = self.chunks.iter().flat_map(of_chunk).collect();
        let extras = samples.split_off(self.framebuffer.pixel_stride());
        let DeepFramebuffer { extra_pixels, extra_indices, extra_samples, .. } = self.framebuffer;
        resolve(extra_pixels, extra_indices, extra_samples, &extras, u32::MAX, &mut samples);
        self.pixels(|index| samples[index].as_vec3())
    }

    /// A value of each pixel, row by row, by its index.
    fn pixels<T>(&self, value: impl Fn(usize) -> T) -> Vec<T> {
        let tiling = &self.framebuffer.tiling;
        let pixels = (0..tiling.height).flat_map(|y| (0..tiling.width).map(move |x| (x, y)));
        pixels.map(|(x, y)| value(tiling.index(x, y))).collect()
    }
}

/// Width of a strip of the picture, if `count` of them make up its height, in mesh space: fixed, and by distance from
/// the eye.
fn width_of_strip(camera: &Camera, scene: &TracedScene, count: f64) -> [f64; 2] {
    match camera.projection {
        Projection::Perspective { yfov } => [0.0, 2.0 * (yfov / 2.0).tan() / count],
        Projection::Orthographic { ymag } => [2.0 * ymag / scene.space.unit / count, 0.0],
    }
}

/// Of each source, the photons that view samples take.
fn photon_maps(scene: &TracedScene, sources: &[Source], thrown: Vec<(u32, Photon)>) -> Vec<PhotonMap> {
    let mut of_source: Vec<Vec<Photon>> = sources.iter().map(|_| Vec::new()).collect();
    let of_small = thrown.into_iter().filter(|(source, _)| sources[*source as usize].is_small(scene));
    of_small.for_each(|(source, photon)| of_source[source as usize].push(photon));
    of_source.into_iter().map(PhotonMap::new).collect()
}
