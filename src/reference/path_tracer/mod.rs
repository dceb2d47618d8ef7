//! An unbiased path tracer: the truth that everything else is measured against.
//!
//! It looks for lights at every surface, draws directions from the BRDF and from aims at mirrored lights (`aims`, `curves`),
//! and weighs whatever two ways can find by the balance heuristic [Veach 1995, Eq. 14]. What the eye sees, straight and
//! through perfect mirrors and past what blends, are the vertices of the deep framebuffer, so that direct light and
//! reflections are those of [`crate::relight`]; a bounced ray sees as many surfaces through mirrors as one from the eye.
//!
//! Not found: light that reaches a surface off a perfect mirror from a point, spot or directional light. No ray meets a
//! light without size, and the gather rows do not find it either.

mod aims;
mod curves;
mod film;
mod lights;
mod path;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

pub use self::film::{Film, Half, Layer, StandardErrors};

use self::aims::Faces;
use self::film::{DIRECT, EMISSION, REFLECTION, Sample, TILE_PIXELS, Tile};
use self::lights::{Emitters, Lamps};
use self::path::{FirstHit, Numbers};
use crate::bake::framebuffer::view_samples::{EyeRays, Tiling};
use crate::physics::sequence::Points;
use crate::scene::{Camera, Rig};
use crate::trace::bvh::TracedScene;

/// What is traced.
#[derive(Clone, Debug)]
pub struct Settings {
    pub width: u32,
    pub height: u32,
    /// Surfaces that a ray meets at most, mirrors included: 1 = no reflections.
    pub layers: u32,
    /// Indirect bounces counted at the pixel, 0 = direct light alone; `None`: all.
    pub max_bounces: Option<u32>,
    pub filter: Filter,
    /// Bounces whose light is kept as a layer of its own.
    pub bounce_layers: u32,
    /// Whether each light's share is kept as a layer of its own.
    pub light_layers: bool,
    pub seed: u64,
}

/// Where in its pixel a ray from the eye goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// Through the centre, as in a deep framebuffer with one sample a pixel.
    Centre,
    /// Anywhere: anti-aliased.
    Box,
}

/// Samples that a pixel gets at once in each half: so often the clock is looked at.
const MAX_SAMPLES_A_PASS: u32 = 16;

/// A scene with its lights, ready to trace.
pub struct PathTracer<'a> {
    scene: &'a TracedScene,
    eye: EyeRays<'a>,
    lamps: Lamps,
    emitters: Emitters,
    faces: Faces,
    settings: Settings,
    /// Names of the lights that get layers.
    light_names: Vec<String>,
    /// Closest-hit rays so far.
    segments: AtomicU64,
}

impl<'a> PathTracer<'a> {
    pub fn new(scene: &'a TracedScene, camera: &'a Camera, rig: &Rig, settings: &Settings) -> Self {
        let tiling = Tiling { width: settings.width, height: settings.height };
        let lamps = Lamps::new(scene, rig);
        Self {
            scene,
            eye: EyeRays { scene, camera, tiling, layers: settings.layers },
            faces: Faces::new(scene, &lamps),
            lamps,
            emitters: Emitters::new(scene),
            settings: settings.clone(),
            light_names: rig.lights.iter().filter(|_| settings.light_layers).map(|light| light.name.clone()).collect(),
            segments: AtomicU64::new(0),
        }
    }

    /// Tiles of pixels: `trace` reports each as often as it has samples in each half.
    pub fn tile_count(&self) -> usize {
        self.eye.tiling.len() / TILE_PIXELS
    }

    /// Path segments so far: closest-hit rays, each with its shading and shadow rays.
    pub fn segments(&self) -> u64 {
        self.segments.load(Ordering::Relaxed)
    }

    /// Traces `samples_a_half` samples a pixel in each of two independent halves, or until `stop` says so; at least one.
    ///
    /// Unless it was stopped, the film follows from the scene and the settings alone, whatever the number of threads.
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
            // 1, 1, 2, 4, ...: the first answer soon.
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
                        segments += self.follow(seen, Numbers { points, index }, &mut sample);
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

    /// What the eye sees through image point (x, y): the surfaces, and the light that comes straight to them. Returns
    /// how many rays it took.
    fn look(&self, x: f64, y: f64, seen: &mut Vec<FirstHit>, sums: &mut Sample) -> u64 {
        seen.clear();
        let mut segments = 0;
        self.eye.follow(x, y, |vertex| {
            let number = segments;
            segments += 1;
            let (weight, wo) = (vertex.weight.as_dvec3(), vertex.wo.as_dvec3());
            sums[EMISSION] += weight * vertex.point.emission.as_dvec3();
            if vertex.point.normal.dot(vertex.wo) <= 0.0 || !vertex.point.brdf.reflects_directly() {
                return;
            }
            let layer = if vertex.layer == 0 { DIRECT } else { REFLECTION };
            for (source, lit) in self.lamps.reflect_each(self.scene, &vertex.point, wo) {
                sums.add_light(layer, source, weight * lit);
            }
            seen.push(FirstHit { aims: self.faces.aim(&self.lamps, &vertex.point), vertex, number });
        });
        segments
    }
}
