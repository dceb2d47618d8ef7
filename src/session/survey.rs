//! What the bake of a scene would give, told without it: from the cache, or estimated from a small picture.

use std::path::Path;

use super::open::{Opened, build_bvh};
use super::plan::TransferPlan;
use super::progress::{Progress, advance, until_cancelled};
use super::report::BakeReport;
use super::{Session, SessionSettings};
use crate::bake::framebuffer::view_samples::Tiling;
use crate::bake::transport::importance::Importance;
use crate::bake::transport::{CLOSED, TransferSettings};
use crate::bake::{BakeSettings, DeepFramebuffer, bake, cache};
use crate::error::Result;
use crate::relight::footprint::light_image_bytes;
use crate::scene::{Camera, Rig};
use crate::trace::bvh::TracedScene;

/// What a deep framebuffer consists of.
#[derive(Clone, Debug, PartialEq)]
pub struct FramebufferCounts {
    /// Pixels, padded to whole tiles.
    pub pixels: usize,
    /// View samples, a pixel each and the extra ones.
    pub samples: usize,
    /// Those that see anything, in each layer that was asked for.
    pub layers: Vec<usize>,
    /// Whether any sample has a specular lobe.
    pub has_specular: bool,
    /// Number of emitters that are seen.
    pub emitters: usize,
    /// BRDFs that are no material's own.
    pub own_brdfs: usize,
}

/// Where the counts are from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CountedIn {
    /// A bake of this very picture.
    Cache,
    /// The picture is small, and was baked.
    Picture,
    /// A smaller picture, of so many pixels.
    Smaller([u32; 2]),
}

/// A scene as it would be baked.
pub struct Survey {
    pub scene: TracedScene,
    pub rig: Rig,
    pub size: [u32; 2],
    pub counts: FramebufferCounts,
    pub counted_in: CountedIn,
    /// Absent without indirect light.
    pub transfer: Option<TransferPlan>,
    /// Absent without indirect light.
    pub unneeded: Option<Unneeded>,
    /// Share of the rays from visible surfaces that leave the scene.
    escaped: f64,
}

/// What indirect light of a scene and camera does without.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unneeded {
    /// Share of all surfaces, by area, that no pixel sees, even over bounces.
    pub unseen: f64,
    /// Why light of the sky is not baked although the method could.
    pub sky: Option<NoSky>,
}

/// Why a scene needs no light of the sky.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoSky {
    /// No light is a dome.
    NoDome,
    /// Hardly any ray leaves the scene.
    Closed,
}

/// Pixels of the picture that larger ones are judged by: a few milliseconds, and each thousandth of a picture is some
/// pixels.
const PIXELS: f64 = 16_384.0;
/// Paths from the eye that tell how much of the scene is seen.
const PATHS: usize = 16_384;

impl FramebufferCounts {
    pub fn new(framebuffer: &DeepFramebuffer, materials: usize) -> Self {
        let mut layers = framebuffer.layers.clone();
        layers.resize(framebuffer.asked_layers as usize, 0);
        Self {
            pixels: framebuffer.pixel_stride(),
            samples: framebuffer.samples.len(),
            layers,
            has_specular: framebuffer.has_specular,
            emitters: framebuffer.emission.chunk_by(|a, b| a.emitter == b.emitter).count(),
            own_brdfs: framebuffer.brdfs.len().saturating_sub(materials),
        }
    }

    /// What every picture of `size` has at the least.
    pub(super) fn fewest([width, height]: [u32; 2]) -> Self {
        let pixels = Tiling { width, height }.len();
        Self { pixels, samples: pixels, layers: Vec::new(), has_specular: false, emitters: 0, own_brdfs: 0 }
    }

    /// Counts of a picture of `pixels`, padded, with `area` times as many pixels, from those of `plain` with one sample
    /// per pixel and of `smooth` with `samples` per pixel on edges.
    ///
    /// Edges are lines, so their share of the pixels falls with the side of the picture. But in a small picture many
    /// lines cross the same pixel: in mirrors all pixels may be edges. If lines lie at random, a pixel has none with
    /// probability exp(-c / side), c being their length.
    fn scaled(plain: &Self, smooth: &Self, samples: u32, area: f64, pixels: usize) -> Self {
        let scale = |plain: usize, smooth: usize| {
            let extra = smooth.saturating_sub(plain) as f64;
            // What all pixels on edges would give. A deep layer may be seen by further samples only.
            let most = extra.max(plain as f64 * f64::from(samples - 1));
            let share = if most > 0.0 { 1.0 - (1.0 - extra / most).powf(area.sqrt().recip()) } else { 0.0 };
            (area * (plain as f64 + share * most)).round() as usize
        };
        let layers: Vec<usize> = plain.layers.iter().zip(&smooth.layers).map(|(p, s)| scale(*p, *s)).collect();
        // Pixels whose first sample sees a surface; all other samples are extra ones.
        let first = plain.pixels + plain.layers.iter().sum::<usize>() - plain.samples;
        let extra = layers.iter().sum::<usize>() - (area * first as f64).round() as usize;
        Self {
            pixels,
            samples: pixels + extra,
            layers,
            own_brdfs: scale(plain.own_brdfs, smooth.own_brdfs),
            ..smooth.clone()
        }
    }
}

impl Unneeded {
    fn new(unseen: f64, plan: &TransferPlan, rig: &Rig, open: bool) -> Self {
        let sky = match (plan.has_sky(), rig.has_domes()) {
            (false, _) => None,
            (true, false) => Some(NoSky::NoDome),
            (true, true) => (!open).then_some(NoSky::Closed),
        };
        Self { unseen, sky }
    }
}

impl Session {
    pub fn counts(&self) -> FramebufferCounts {
        FramebufferCounts::new(&self.framebuffer, self.scene.materials.len())
    }

    /// Absent without indirect light.
    pub fn unneeded(&self) -> Option<Unneeded> {
        let (transfers, transfer) = (self.transfers.as_ref()?, self.transfer.as_ref()?);
        let open = transfer.sky.as_ref().is_none_or(|sky| !sky.chain.is_empty());
        Some(Unneeded::new(transfer.report.unseen, &transfers.plan, &self.rig, open))
    }
}

impl Survey {
    /// Of `path` with the lights of `rig_path`, or its own. Nothing is stored.
    pub fn new(
        path: &Path,
        rig_path: Option<&Path>,
        settings: &SessionSettings,
        progress: &dyn Progress,
    ) -> Result<Self> {
        settings.check()?;
        let mut report = BakeReport::default();
        let opened = report.stage("load", || Opened::new(path, rig_path, &settings.open, progress))?;
        let Opened { scene, rig, camera, size, .. } = opened;
        let scene = report.stage("build BVH", || build_bvh(scene, progress));
        let view = View { scene: &scene, rig: &rig, camera: &camera, settings };
        let (framebuffer, counts, counted_in) = match report.stage("read cache", || view.stored(size)) {
            Some(stored) => {
                let counts = view.counts(&stored);
                (stored, counts, CountedIn::Cache)
            }
            None => report.stage("count", || until_cancelled(|| Ok(view.count(size, progress))))?,
        };
        let SessionSettings { layers, seed, indirect, .. } = settings;
        let transfer = indirect.map(|indirect| indirect.plan(size, *layers, *seed));
        let mut escaped = 0.0;
        let unneeded = transfer.as_ref().map(|plan| match plan {
            TransferPlan::Robust(TransferSettings { layers, seed, .. }, _) => {
                let importance = report.stage("paths", || Importance::new(&scene, &framebuffer, *layers, PATHS, *seed));
                escaped = importance.escaped.unwrap_or(0.0);
                Unneeded::new(importance.unseen, plan, &rig, importance.escaped.is_none_or(|share| share > CLOSED))
            }
            // It looks at all surfaces.
            TransferPlan::Thesis(_) => Unneeded { unseen: 0.0, sky: None },
        });
        Ok(Self { size, counts, counted_in, transfer, unneeded, scene, rig, escaped })
    }

    /// Bytes of memory and CPU seconds that the bake takes, within a factor of about three (docs/farm.md, "What a bake
    /// takes").
    pub fn bake_cost(&self) -> (f64, f64) {
        let samples = self.counts.samples as f64;
        let scene = BYTES_A_TRIANGLE * self.scene.mesh.triangles.len() as f64 + BYTES_A_SAMPLE * samples;
        let Some(TransferPlan::Robust(TransferSettings { rays, samples: gather, .. }, _)) = &self.transfer else {
            return (LEAST_BYTES + scene, 0.0);
        };
        let hits = 1.0 - self.escaped;
        let seconds = samples * f64::from(*rays) * (SECONDS_A_RAY + hits * SECONDS_A_HIT);
        (LEAST_BYTES + scene + BYTES_A_GATHER_SAMPLE * *gather as f64, seconds)
    }

    /// Bytes of all light images of the rig, and of the fewest that work.
    pub fn light_image_bytes(&self) -> [u64; 2] {
        light_image_bytes(self.rig.lights.len(), self.counts.pixels)
    }
}

/// Of [`Survey::bake_cost`].
const LEAST_BYTES: f64 = 0.3e9;
const BYTES_A_TRIANGLE: f64 = 400.0;
const BYTES_A_SAMPLE: f64 = 500.0;
const BYTES_A_GATHER_SAMPLE: f64 = 190_000.0;
const SECONDS_A_RAY: f64 = 0.1e-6;
const SECONDS_A_HIT: f64 = 2.4e-6;

/// What is looked at, and how it would be baked.
struct View<'a> {
    scene: &'a TracedScene,
    rig: &'a Rig,
    camera: &'a Camera,
    settings: &'a SessionSettings,
}

impl View<'_> {
    fn bake_settings(&self, [width, height]: [u32; 2], samples: u32) -> BakeSettings {
        BakeSettings { width, height, layers: self.settings.layers, samples }
    }

    /// The deep framebuffer, if the cache has it.
    fn stored(&self, size: [u32; 2]) -> Option<DeepFramebuffer> {
        let dir = self.settings.cache_dir.as_deref().filter(|dir| dir.is_dir())?;
        let settings = self.bake_settings(size, self.settings.samples);
        let key = cache::Inputs::of(self.scene, self.camera, self.rig, &settings).key();
        cache::load(dir, &key, self.camera, &settings).map(|framebuffer| self.forced(framebuffer))
    }

    fn forced(&self, framebuffer: DeepFramebuffer) -> DeepFramebuffer {
        if self.settings.force_all { framebuffer.into_worst_case() } else { framebuffer }
    }

    fn counts(&self, framebuffer: &DeepFramebuffer) -> FramebufferCounts {
        FramebufferCounts::new(framebuffer, self.scene.materials.len())
    }

    /// A bake of at most [`PIXELS`], and the counts of the whole picture.
    fn count(&self, size: [u32; 2], progress: &dyn Progress) -> (DeepFramebuffer, FramebufferCounts, CountedIn) {
        let pixels = |[width, height]: [u32; 2]| f64::from(width) * f64::from(height);
        let shrink = (PIXELS / pixels(size)).sqrt().min(1.0);
        let small = size.map(|side| ((f64::from(side) * shrink).round() as u32).max(1));
        let samples = self.settings.samples;
        let bake = |samples: u32| {
            let settings = self.bake_settings(small, samples);
            self.forced(bake(self.scene, self.camera, self.rig, &settings, &advance(progress)))
        };
        let framebuffer = bake(samples);
        let smooth = self.counts(&framebuffer);
        if small == size {
            return (framebuffer, smooth, CountedIn::Picture);
        }
        let plain = if samples > 1 { self.counts(&bake(1)) } else { smooth.clone() };
        let all = Tiling { width: size[0], height: size[1] }.len();
        let counts = FramebufferCounts::scaled(&plain, &smooth, samples, pixels(size) / pixels(small), all);
        (framebuffer, counts, CountedIn::Smaller(small))
    }
}
