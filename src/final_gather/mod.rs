//! Final gathering: indirect light of a view, estimated anew for known lights, better with each pass [Jensen 1996].
//!
//! A pass sends photons from the lights, keeps the irradiance that they carry after a bounce in [cells](surface_cells),
//! and [gathers](gather) at all view samples: the first bounce by rays and connections, further ones from the cells.

mod combine;
mod gather;
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

use self::gather::{BY_CHANCE, Pass, RAYS, Scratch};
use self::irradiance_cache::IrradianceCache;
use self::photons::Photons;
use self::sources::Source;
use self::surface_cells::SurfaceCells;
use crate::bake::DeepFramebuffer;
use crate::bake::framebuffer::view_samples::resolve;
use crate::physics::sequence::ShiftedPoints;
use crate::scene::{Emitters, Rig};
use crate::trace::bvh::TracedScene;
use crate::trace::packet::PACKET_SIZE;

/// Indirect light of a view under the lights of a rig.
pub struct FinalGather<'a> {
    scene: &'a TracedScene,
    framebuffer: &'a DeepFramebuffer,
    sources: Vec<Source>,
    cells: SurfaceCells,
    /// One for each half of the passes.
    caches: [IrradianceCache; 2],
    seed: u64,
    passes: u32,
    /// Of each source, photons in each half of the passes so far.
    photons: [Vec<u32>; 2],
    /// Of each source, the power that landed in all passes; at unit strength.
    powers: Vec<f64>,
    /// Of each 64 view samples, in their order.
    chunks: Vec<Chunk>,
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
/// Passes before the expected error can be relied on: that of fewer rays misses what few of them find.
pub const LEAST_PASSES: u32 = 4;
/// Share of what a pass can gain for which it is made.
const FOCUS: f64 = 0.9;

impl<'a> FinalGather<'a> {
    /// Light of the `wanted` lights that are not off, by index in the complete rig. Panics if links of a light name what
    /// the scene lacks: see [`Rig::resolve_links`].
    pub fn new(
        scene: &'a TracedScene,
        framebuffer: &'a DeepFramebuffer,
        rig: &Rig,
        wanted: impl Fn(usize) -> bool,
        seed: u64,
    ) -> Self {
        let sources = Source::of(scene, &Emitters::of(scene).complete(rig), wanted);
        let cells = SurfaceCells::new(scene, &framebuffer.camera);
        let caches = [0, 1].map(|_| IrradianceCache::new(&cells, sources.len()));
        let sums = || vec![Vec3::ZERO; 2 * sources.len() * PACKET_SIZE];
        let count = framebuffer.samples.len().div_ceil(PACKET_SIZE);
        let chunks = (0..count).map(|_| Chunk { sums: sums(), rays: [0; 2], is_wanted: true }).collect();
        let photons = [0, 1].map(|_| vec![0; sources.len()]);
        let powers = vec![0.0; sources.len()];
        Self { scene, framebuffer, sources, cells, caches, seed, passes: 0, photons, powers, chunks }
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
        let half = (self.passes % 2) as usize;
        let number = self.passes / 2;
        let seed = self.seed ^ (1 + half as u64) << 48;
        let counts = self.photon_counts();
        let photons = Photons::trace((self.scene, &self.cells), &self.sources, &counts, &self.photons[half], seed);
        self.photons[half].iter_mut().zip(&counts).for_each(|(sum, count)| *sum = sum.wrapping_add(*count));
        self.caches[half].add_reflected(&self.cells, &photons.landings);
        // A first look at the picture comes sooner.
        let rays = if number == 0 { RAYS / 8 } else { RAYS };
        let points = ShiftedPoints::of(seed ^ 4 << 40, number * RAYS..number * RAYS + rays);
        let pass = Pass {
            scene: self.scene,
            framebuffer: self.framebuffer,
            sources: &self.sources,
            cells: &self.cells,
            cache: &self.caches[half],
            lit: &photons.lit,
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
        self.caches[half].add_direct(&self.cells, &photons.landings);
        for landing in photons.landings.iter().filter(|landing| landing.is_direct) {
            self.powers[landing.source as usize] += f64::from(landing.power.max_element());
        }
        self.passes += 1;
    }

    /// Lets further passes gather where they lower the error most. `errors2`: expected squared errors of the pixels.
    pub fn focus(&mut self, errors2: &[f32]) {
        let tiling = &self.framebuffer.tiling;
        let tiles = self.framebuffer.pixel_stride() / PACKET_SIZE;
        let mut gains = vec![0.0; tiles];
        for (i, error2) in errors2.iter().enumerate() {
            let index = tiling.index(i as u32 % tiling.width, i as u32 / tiling.width);
            gains[index / PACKET_SIZE] += f64::from(*error2);
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

    /// Photons of each source in the next pass: as its light matters in the scene.
    fn photon_counts(&self) -> Vec<u32> {
        let power = |(source, power): (&Source, &f64)| source.scale * power;
        let total: f64 = self.sources.iter().zip(&self.powers).map(power).sum();
        let even = 1.0 / self.sources.len() as f64;
        let [fewest, most] = PHOTONS;
        let count = (PHOTONS_A_SAMPLE * self.framebuffer.samples.len()).clamp(fewest, most) as f64;
        let photons = |of: (&Source, &f64)| {
            let known = if total > 0.0 { power(of) / total } else { even };
            (count * (BY_CHANCE * even + (1.0 - BY_CHANCE) * known)).max(1.0) as u32
        };
        self.sources.iter().zip(&self.powers).map(photons).collect()
    }

    /// What the passes found of the light that is number `source` of [`Self::lights`].
    pub fn estimate(&self, source: usize) -> Estimate {
        let halves = [0, 1].map(|half| self.image(half, source));
        let rays = [0, 1].map(|half| self.pixels(|index| self.chunks[index / PACKET_SIZE].rays[half]));
        Estimate { halves, rays, passes: self.passes }
    }

    /// Indirect radiance of the pixels in one half of the passes, row by row, from the source that is number `source` of
    /// [`Self::lights`], at unit strength.
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
