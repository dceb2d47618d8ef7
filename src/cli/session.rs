//! From command-line options to a baked scene and a relighter.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use relume::bake::compression::validation::ValidationError;
use relume::bake::spread::spread;
use relume::bake::transfer::baked::BakedTransfer;
use relume::bake::transfer::rows::Lobe;
use relume::bake::transfer::thesis::ThesisSettings;
use relume::bake::transfer::{Outgoing, TransferSettings};
use relume::bake::{BakeSettings, Baked, bake, cache, low_priority};
use relume::gpu::{Context, Validation};
use relume::relight::Relighter;
use relume::relight::light_cache::LightCache;
use relume::scene::memory::available_bytes;
use relume::scene::rig::without_dots;
use relume::scene::{Camera, Rig, Scene};
use relume::trace::bvh::Bvh;
use relume::{Error, Result};

use super::options::{LightOptions, SceneOptions, ViewOptions, check_size};
use super::progress::{Progress, Terminal};
use super::transfer::{BakeInput, TransferPlan};

/// A scene with its BVH, baked for one camera.
pub struct Session {
    pub scene: Arc<Scene>,
    pub bvh: Arc<Bvh>,
    pub baked: Arc<Baked>,
    pub camera: Camera,
    /// The lights that the first picture shows.
    pub rig: Rig,
    pub bake: BakeReport,
    /// Names what the deep framebuffer depends on.
    pub key: cache::Key,
    pub cache_dir: Option<PathBuf>,
    /// Absent without indirect light.
    pub transfers: Option<Transfers>,
    /// One sample a pixel, to which indirect light is baked where `baked` has more and can take it over.
    plain: Option<Arc<Baked>>,
}

/// Where transfers to one deep framebuffer come from.
pub struct Transfers {
    pub plan: TransferPlan,
    key: cache::Key,
    dir: Option<PathBuf>,
}

impl Transfers {
    /// As `--gi` calls it.
    pub fn gi(&self) -> &'static str {
        let (TransferPlan::Robust(TransferSettings { outgoing, .. }, _)
        | TransferPlan::Thesis(ThesisSettings { outgoing, .. })) = &self.plan;
        if *outgoing == Outgoing::Diffuse { "diffuse" } else { "glossy" }
    }

    fn key(&self, lobe: Lobe) -> cache::Key {
        cache::transfer_key(&self.key, &format!("{:?} {lobe:?}", self.plan))
    }

    fn stored(&self, baked: &Baked, lobe: Lobe, report: &mut BakeReport) -> Option<BakedTransfer> {
        let (dir, key) = (self.dir.as_deref()?, self.key(lobe));
        report.stage("read cache", || cache::load_transfer(dir, &key, baked))
    }

    /// Calls `show` with a coarse transfer after seconds, unless the cache has the fine one, then with that. Bakes on threads
    /// of its own, so that lights can be edited meanwhile.
    pub fn refine(&self, seen: BakeInput, progress: &dyn Progress, show: impl Fn(BakedTransfer) + Sync) -> Result<()> {
        let mut report = BakeReport::default();
        if let Some(transfer) = self.stored(seen.baked, Lobe::All, &mut report) {
            show(transfer);
            return Ok(());
        }
        low_priority(|| {
            if let Some(coarse) = self.plan.coarse() {
                show(coarse.bake(seen, Lobe::All, None, &mut report, progress)?);
            }
            show(self.get(seen, Lobe::All, &mut report, progress)?);
            Ok(())
        })
    }

    /// From the cache, or baked and kept there.
    fn get(
        &self,
        seen: BakeInput,
        lobe: Lobe,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<BakedTransfer> {
        let stored = self.stored(seen.baked, lobe, report);
        report.cached &= stored.is_some();
        if let Some(transfer) = stored {
            return Ok(transfer);
        }
        let key = self.key(lobe);
        let journal = self.dir.as_ref().map(|dir| cache::journal(dir, &key));
        let transfer = self.plan.bake(seen, lobe, journal.as_deref(), report, progress)?;
        if let Some(dir) = &self.dir
            && let Err(error) = report
                .stage("write cache", || cache::store_transfer(dir, &key, &seen.scene.name(), seen.baked, &transfer))
        {
            tracing::info!("not kept: {error}"); // a read-only cache works
            report.not_stored = Some(error);
        }
        Ok(transfer)
    }
}

/// What the bake took.
#[derive(Default)]
pub struct BakeReport {
    pub stages: Vec<Stage>,
    pub seconds: f64,
    /// User and system, all threads.
    pub cpu_seconds: f64,
    /// Whether the deep framebuffer came from the cache.
    pub cached: bool,
    /// Why what was baked could not be kept.
    pub not_stored: Option<Error>,
}

#[derive(serde::Serialize, Clone)]
pub struct Stage {
    pub name: &'static str,
    pub seconds: f64,
}

impl BakeReport {
    /// Adds what `work` takes to the whole.
    fn clocked<R>(&mut self, work: impl FnOnce(&mut Self) -> R) -> R {
        let (start, cpu_start) = (Instant::now(), cpu_seconds());
        let result = work(self);
        self.seconds += start.elapsed().as_secs_f64();
        self.cpu_seconds += cpu_seconds() - cpu_start;
        result
    }

    pub fn stage<R>(&mut self, name: &'static str, work: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = work();
        let seconds = start.elapsed().as_secs_f64();
        tracing::info!("{name}: {:.0} ms", 1e3 * seconds);
        self.stages.push(Stage { name, seconds });
        result
    }
}

/// A scene as it is lit and seen, before any of it is computed.
pub struct Opened {
    pub scene: Scene,
    pub rig: Rig,
    pub camera: Camera,
    pub size: [u32; 2],
}

impl Opened {
    /// Loads `path` with the lights of `rig_path`, or its own.
    pub fn new(path: &Path, rig_path: Option<&Path>, options: &ViewOptions, progress: &dyn Progress) -> Result<Self> {
        use_threads(options.threads);
        progress.begin("loading", 0);
        let scene = Scene::load(path);
        progress.end();
        let mut scene = scene?;
        if options.strip_diffuse {
            scene.materials.iter_mut().for_each(|m| m.strip_diffuse = true);
        }
        let rig = match rig_path {
            Some(path) => Rig::load(path)?,
            None => scene.rig.clone(),
        };
        if rig.lights.is_empty() {
            let emits = scene.materials.iter().any(|material| material.emissive != Vec3::ZERO);
            let so = if emits { "so only emitters shine" } else { "so the picture is black" };
            tracing::warn!("{}: no lights, {so}", rig_path.unwrap_or(path).display());
        }
        let camera = choose_camera(&scene, &rig, options)?;
        let size = options.size.unwrap_or_else(|| scene.default_size(Some(&camera)));
        if let (None, None, Some(aspect)) = (options.size, scene.image_size, camera.aspect) {
            let [width, height] = size;
            tracing::info!("{width}x{height}: camera \"{}\" has an aspect ratio of {aspect:.4}", camera.name);
        }
        check_size(size).map_err(|reason| Error::invalid(path.display().to_string(), reason))?;
        Ok(Self { scene, rig, camera, size })
    }

    pub fn build_bvh(&self, progress: &dyn Progress) -> Bvh {
        progress.begin("building the BVH", 0);
        let bvh = Bvh::build(&self.scene);
        progress.end();
        bvh
    }
}

impl Session {
    /// Loads and bakes `path` with the lights of `rig_path`, or its own.
    pub fn open(path: &Path, rig_path: Option<&Path>, options: &SceneOptions) -> Result<Self> {
        let progress = Terminal::default();
        let mut session = Self::open_direct(path, rig_path, options, &progress)?;
        if session.transfers.is_none() {
            return Ok(session);
        }
        let transfer = session.transfer(Lobe::All, &progress)?;
        Arc::make_mut(&mut session.baked).transfer = Some(transfer);
        Ok(session)
    }

    /// Indirect light from the cache, or baked: to one sample a pixel, whose rows serve its further samples, so that it does
    /// not depend on where the lights' shadow edges lie.
    fn transfer(&mut self, lobe: Lobe, progress: &dyn Progress) -> Result<BakedTransfer> {
        let Self { scene, bvh, baked, bake, transfers, plain, .. } = self;
        let transfers = transfers.as_ref().expect("there is indirect light");
        bake.clocked(|bake| {
            let Some(plain) = plain else {
                return transfers.get(BakeInput { scene, bvh, baked }, lobe, bake, progress);
            };
            let transfer = transfers.get(BakeInput { scene, bvh, baked: plain }, lobe, bake, progress)?;
            let plain = Baked { transfer: Some(transfer), ..Baked::clone(plain) };
            let spread = bake.stage("spread transfer", || spread(&plain, baked, bvh.radius));
            Ok(spread.expect("such a transfer has no plain bake"))
        })
    }

    /// How far indirect light is from rows gathered anew, under points and spots.
    pub fn verify(&self) -> Result<[ValidationError; 2]> {
        let (Some(transfers), Some(transfer)) = (&self.transfers, &self.baked.transfer) else {
            return Err(Error::invalid("--verify", "with --gi off there is nothing to verify"));
        };
        transfers.plan.verify(self.seen(), transfer, &Terminal::default())
    }

    /// All but indirect light.
    pub fn open_direct(
        path: &Path,
        rig_path: Option<&Path>,
        options: &SceneOptions,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let mut report = BakeReport::default();
        let opened =
            report.clocked(|report| report.stage("load", || Opened::new(path, rig_path, &options.view, progress)))?;
        Self::of(opened, options, report, progress)
    }

    /// The same of what is open already; `report` is of opening it.
    pub fn of(opened: Opened, options: &SceneOptions, mut report: BakeReport, progress: &dyn Progress) -> Result<Self> {
        let (start, cpu_start) = (Instant::now(), cpu_seconds());
        let plan = options.transfer.plan(&options.view, opened.size)?;
        let forced = if options.force_all { options.view.layers - 1 } else { 0 };
        check_memory(opened.size, options.samples(), forced, opened.rig.lights.len(), &opened.scene.path)?;
        let bvh = report.stage("build BVH", || opened.build_bvh(progress));
        let Opened { scene, rig, camera, size: [width, height] } = opened;
        let settings = BakeSettings { width, height, layers: options.view.layers, samples: options.samples() };
        let cache_dir = options.cache_dir();
        let framebuffer = |settings: &BakeSettings, report: &mut BakeReport| -> (cache::Key, Baked) {
            let key = cache::key(&scene, &camera, &rig, settings);
            let stored =
                cache_dir.as_deref().and_then(|dir| report.stage("read cache", || cache::load(dir, &key, settings)));
            report.cached = stored.is_some();
            if let Some(baked) = stored {
                return (key, baked);
            }
            let passes = if settings.samples > 1 { 2 } else { 1 };
            progress.begin("deep framebuffer", passes * settings.tile_count());
            let advance = |tiles| progress.advance(tiles);
            let baked = report.stage("deep framebuffer", || bake(&scene, &bvh, &camera, &rig, settings, &advance));
            progress.end();
            if let Some(dir) = &cache_dir
                && let Err(error) = report.stage("write cache", || cache::store(dir, &key, &scene.name(), &baked))
            {
                tracing::info!("not kept: {error}"); // a read-only cache works
                report.not_stored = Some(error);
            }
            (key, baked)
        };
        let plain = (settings.samples > 1 && plan.as_ref().is_some_and(TransferPlan::spreads))
            .then(|| framebuffer(&BakeSettings { samples: 1, ..settings.clone() }, &mut report));
        let (key, baked) = framebuffer(&settings, &mut report);
        let baked = if options.force_all { baked.with_nothing_left_out() } else { baked };
        let plain_key = match &plain {
            Some((key, _)) => key.clone(),
            None if options.force_all => cache::transfer_key(&key, "nothing left out"),
            None => key.clone(),
        };
        let transfers = plan.map(|plan| Transfers { plan, key: plain_key, dir: cache_dir.clone() });
        let plain = plain.map(|(_, baked)| Arc::new(baked));
        report.seconds += start.elapsed().as_secs_f64();
        report.cpu_seconds += cpu_seconds() - cpu_start;
        let (scene, bvh, baked) = (Arc::new(scene), Arc::new(bvh), Arc::new(baked));
        Ok(Self { scene, bvh, baked, camera, rig, bake: report, key, cache_dir, transfers, plain })
    }

    pub fn context(&self, options: &LightOptions) -> Result<Arc<Context>> {
        let validation = if cfg!(debug_assertions) { Validation::On } else { Validation::Off };
        Context::new(options.device.as_deref(), validation, self.cache_dir.as_deref())
    }

    pub fn relighter(&self, context: &Arc<Context>, rig: &Rig, options: &LightOptions) -> Result<Relighter> {
        Relighter::new(context, &self.scene, &self.bvh, &self.baked, rig, &options.relight_settings())
    }

    /// A relighter whose indirect light is what the pixels' specular lobes make of it.
    pub fn glossy_relighter(&mut self, context: &Arc<Context>, rig: &Rig, options: &LightOptions) -> Result<Relighter> {
        let transfer = self.transfer(Lobe::Specular, &Terminal::default())?;
        let baked = Arc::new(Baked { transfer: Some(transfer), ..Baked::clone(&self.baked) });
        Relighter::new(context, &self.scene, &self.bvh, &baked, rig, &options.relight_settings())
    }

    /// View samples in each layer that was asked for, seen or not.
    pub fn layers(&self) -> Vec<usize> {
        let mut layers = self.baked.layers.clone();
        layers.resize(self.baked.asked_layers as usize, 0);
        layers
    }

    pub fn seen(&self) -> BakeInput<'_> {
        BakeInput { scene: &self.scene, bvh: &self.bvh, baked: &self.baked }
    }

    pub fn size(&self) -> (usize, usize) {
        (self.baked.tiling.width as usize, self.baked.tiling.height as usize)
    }
}

/// The rig's camera, the one asked for by name, the first, or one that frames the scene.
fn choose_camera(scene: &Scene, rig: &Rig, options: &ViewOptions) -> Result<Camera> {
    if let Some(name) = &options.camera {
        let found = scene.cameras.iter().find(|camera| camera.name == without_dots(name));
        return found.cloned().ok_or_else(|| {
            let names: Vec<_> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
            let reason = match names.is_empty() {
                true => format!("{} has no cameras", scene.path.display()),
                false => format!("{} has no such camera; it has: {}", scene.path.display(), names.join(", ")),
            };
            Error::invalid(format!("--camera {name}"), reason)
        });
    }
    if let Some(camera) = rig.camera.as_ref().or(scene.cameras.first()) {
        return Ok(camera.clone());
    }
    tracing::warn!("{}: no camera, so the view is framed by the scene's bounds", scene.path.display());
    Ok(Camera::framing(&scene.mesh, scene.space))
}

/// Bytes that a sample takes at the least: view sample, normal and packet, twice while they are collected; the samples
/// and nine lights' visibility on the device; two pictures.
const BYTES_A_SAMPLE: u64 = 2 * (32 + 12 + 36) + 32 + 9 + 16;
/// Share of the pixels that get several samples: 0.04 in the shipped scenes.
const SHARE_OF_EDGES: f64 = 0.04;

/// Refuses a picture that cannot fit this machine, before the system does so less kindly.
fn check_memory(size: [u32; 2], samples: u32, forced_layers: u32, light_count: usize, path: &Path) -> Result<()> {
    let samples_a_pixel = 1.0 + SHARE_OF_EDGES * f64::from(samples - 1) + f64::from(forced_layers);
    // The fewest light images that work and their rest; each light's visibility while its shadow edges are looked for.
    let images = LightCache::slot_range(light_count).0 + 1;
    let edges = if samples > 1 { light_count } else { 0 };
    let bytes = BYTES_A_SAMPLE as f64 * samples_a_pixel + (12 * images + edges) as f64;
    let remedy = if samples > 1 { "choose a smaller --size or fewer --samples" } else { "choose a smaller --size" };
    check_fits(size, f64::from(size[0]) * f64::from(size[1]) * bytes, remedy, path)
}

/// Refuses a picture that takes more bytes than are free.
pub fn check_fits(size: [u32; 2], bytes: f64, remedy: &str, path: &Path) -> Result<()> {
    let [width, height] = size;
    check_free(bytes, &format!("{width}x{height} pixels take"), remedy, path)
}

/// Refuses what takes more bytes than are free.
pub fn check_free(bytes: f64, what: &str, remedy: &str, path: &Path) -> Result<()> {
    let Some(free) = available_bytes() else { return Ok(()) };
    let (needed, free) = (bytes * 1e-9, free as f64 * 1e-9);
    if needed <= free {
        return Ok(());
    }
    let reason = format!("{what} {needed:.1} GB of memory, {free:.1} GB are free; {remedy}");
    Err(Error::invalid(path.display().to_string(), reason))
}

fn use_threads(threads: Option<u32>) {
    let Some(threads) = threads else { return };
    // Fails only if the pool is running already, with the number that an earlier call chose.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global();
}

/// Processor time of this process, user and system, all threads; 0 where /proc does not tell.
pub fn cpu_seconds() -> f64 {
    #[cfg(target_os = "linux")]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    }
    #[cfg(not(target_os = "linux"))]
    0.0
}

/// Most memory that this process ever held, in bytes; 0 where /proc does not tell.
pub fn peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).unwrap_or(0) * 1024
}
