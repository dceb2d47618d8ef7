//! An unbiased path tracer: the reference for all error measurements.
//!
//! It samples the lights at every surface and directions from a mixture of the BRDF and of aims at mirrored lights
//! (`aims`, `curves`). Light that can be found in two ways is weighted by the balance heuristic [Veach 1995, Eq. 14].
//! The first vertices, seen directly, through perfect mirrors and through blended surfaces, are those of the deep
//! framebuffer, so that direct light and reflections equal those of [`crate::relight`]. A bounced ray sees at most as
//! many surfaces through mirrors as a ray from the eye.
//!
//! Omitted: light of punctual lights that a perfect mirror reflects onto a surface, because a ray cannot hit them.
//! The gather rows omit it too. In mirrors the eye sees area lights; directly it sees those that are visible.

mod aims;
mod curves;
mod film;
mod glossy_mirrors;
mod lights;
mod path;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

pub use self::film::{Film, Half, Layer, StandardErrors};

use self::film::{DIRECT, REFLECTION, Sample, TILE_PIXELS, Tile};
use self::glossy_mirrors::GlossyMirrors;
use self::lights::{ActiveEmitters, ActiveLights};
use self::path::{FirstHit, PathRandom};
use crate::bake::framebuffer::view_samples::{EyeRays, PathPart, Tiling};
use crate::physics::sequence::Points;
use crate::scene::{Camera, Emitters, Rig};
use crate::trace::bvh::TracedScene;

/// Parameters of a trace.
#[derive(Clone, Debug)]
pub struct Settings {
    pub width: u32,
    pub height: u32,
    /// Maximum surfaces per ray, mirrors included; 1: no mirror reflections.
    pub layers: u32,
    /// Maximum indirect bounces; 0: only direct light, `None`: unlimited.
    pub max_bounces: Option<u32>,
    pub filter: Filter,
    /// Number of bounces whose light is stored as separate layers.
    pub bounce_layers: u32,
    /// Whether each light's contribution is stored as a separate layer.
    pub light_layers: bool,
    pub seed: u64,
}

/// Pixel filter: position of eye rays in the pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// At the centre, as in a deep framebuffer with one sample per pixel.
    Centre,
    /// Uniform over the pixel: anti-aliased.
    Box,
}

/// Maximum samples per pixel and half in one pass over the tiles. `stop` is checked before each tile.
const MAX_SAMPLES_A_PASS: u32 = 16;

/// A scene with its lights, ready to trace.
pub struct PathTracer<'a> {
    scene: &'a TracedScene,
    eye: EyeRays<'a>,
    lights: ActiveLights,
    emitters: ActiveEmitters,
    mirrors: GlossyMirrors,
    settings: Settings,
    /// Names of the lights that have layers.
    light_names: Vec<String>,
    /// Number of closest-hit rays so far.
    segments: AtomicU64,
}

impl<'a> PathTracer<'a> {
    /// Prepares lights, emitters and aims.
    ///
    /// Panics if links of a light name what the scene lacks: see [`Rig::resolve_links`].
    pub fn new(scene: &'a TracedScene, camera: &'a Camera, rig: &Rig, settings: &Settings) -> Self {
        let tiling = Tiling { width: settings.width, height: settings.height };
        let rig = &*Emitters::of(scene).complete(rig);
        let lights = ActiveLights::new(scene, rig);
        Self {
            scene,
            eye: EyeRays { scene, camera, tiling, layers: settings.layers },
            mirrors: GlossyMirrors::new(scene, &lights),
            lights,
            emitters: ActiveEmitters::new(scene, rig),
            settings: settings.clone(),
            light_names: rig.lights.iter().filter(|_| settings.light_layers).map(|light| light.name.clone()).collect(),
            segments: AtomicU64::new(0),
        }
    }

    /// Number of tiles. The counts that [`Self::trace`] passes to `progress` sum to this times `samples_a_half`.
    pub fn tile_count(&self) -> usize {
        self.eye.tiling.len() / TILE_PIXELS
    }

    /// Number of path segments so far: closest-hit rays, each with shading and shadow rays.
    pub fn segments(&self) -> u64 {
        self.segments.load(Ordering::Relaxed)
    }

    /// Traces `samples_a_half` samples per pixel in each of two independent halves, at least one. Ends early if `stop`
    /// returns true. `progress` receives the number of new samples per half of each tile.
    ///
    /// Unless stopped, the film depends only on scene, lights and settings, not on the number of threads.
    pub fn trace(
        &self,
        samples_a_half: u32,
        stop: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn(u64) + Sync),
    ) -> Film {
        let mut film = Film::new(self.eye.tiling, self.settings.bounce_layers, &self.light_names);
        let stopped = AtomicBool::new(false);
        let mut done = 0;
        while done < samples_a_half && !stopped.load(Ordering::Relaxed) {
            // 1, 1, 2, 4, ...: a first estimate is available early.
            let count = done.clamp(1, MAX_SAMPLES_A_PASS).min(samples_a_half - done);
            film.tiles.par_iter_mut().enumerate().for_each(|(index, tile)| {
                if done > 0 && (stopped.load(Ordering::Relaxed) || stop()) {
                    stopped.store(true, Ordering::Relaxed);
                    return;
                }
                self.trace_tile(index, tile, done..done + count);
                progress(count.into());
            });
            done += count;
        }
        film
    }

    fn trace_tile(&self, index: usize, tile: &mut Tile, samples: std::ops::Range<u32>) {
        let mut segments = 0;
        let mut direct = Sample::new(self.settings.bounce_layers, self.light_names.len());
        let mut sample = direct.clone();
        let mut seen: Vec<FirstHit> = Vec::new();
        for pixel in 0..TILE_PIXELS {
            let place = index * TILE_PIXELS + pixel;
            let (x, y) = self.eye.tiling.pixel(place);
            if !self.eye.tiling.contains((x, y)) {
                continue;
            }
            let row = u64::from(y) * u64::from(self.settings.width) + u64::from(x);
            direct.clear();
            if self.settings.filter == Filter::Centre {
                segments += self.look(f64::from(x) + 0.5, f64::from(y) + 0.5, &mut seen, &mut direct);
            }
            for half in 0..2 {
                let stream = row << 1 | half as u64;
                for index in samples.clone() {
                    if self.settings.filter == Filter::Box {
                        let [u, v, _, _] = self.points(stream).at(index, 0);
                        direct.clear();
                        segments += self.look(f64::from(x) + u, f64::from(y) + v, &mut seen, &mut direct);
                    }
                    sample.copy_from(&direct);
                    for seen in &seen {
                        let points = self.points(seen.number << 40 | stream);
                        let random = PathRandom { points, index };
                        segments += self.follow(seen, random, &mut sample);
                    }
                    sample.add_to(tile.pixel(half, pixel));
                }
            }
        }
        tile.counts = tile.counts.map(|count| count + samples.len() as u32);
        self.segments.fetch_add(segments, Ordering::Relaxed);
    }

    fn points(&self, stream: u64) -> Points {
        Points::new(self.settings.seed, stream)
    }

    /// Finds the surfaces visible through image point (x, y) and adds their direct light and emission to `sums`.
    /// Returns the number of rays.
    fn look(&self, x: f64, y: f64, seen: &mut Vec<FirstHit>, sums: &mut Sample) -> u64 {
        seen.clear();
        let mut segments = 0;
        self.eye.follow(x, y, |part| {
            let vertex = match part {
                PathPart::Vertex(vertex) => vertex,
                PathPart::Segment(segment) => {
                    let layer = if segment.layer == 0 { DIRECT } else { REFLECTION };
                    for (source, seen) in self.lights.seen(self.scene, &segment) {
                        sums.add_light(layer, source, segment.weight.as_dvec3() * seen);
                    }
                    return;
                }
            };
            let number = segments;
            segments += 1;
            let (weight, wo) = (vertex.weight.as_dvec3(), vertex.wo.as_dvec3());
            self.emitters.add(sums, vertex.point.material, weight * vertex.point.emission.as_dvec3());
            if vertex.point.normal.dot(vertex.wo) <= 0.0 || !vertex.point.brdf.reflects_directly() {
                return;
            }
            let layer = if vertex.layer == 0 { DIRECT } else { REFLECTION };
            for (source, lit) in self.lights.reflect_each(self.scene, &vertex.point, wo) {
                sums.add_light(layer, source, weight * lit);
            }
            seen.push(FirstHit { aims: self.mirrors.aim(&self.lights, &vertex.point), vertex, number });
        });
        segments
    }
}
