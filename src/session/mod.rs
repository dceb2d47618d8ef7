//! A scene from its file to pictures of it: opened, planned, baked or found in the cache, relit.
//!
//! ```text
//! Opened -> Session (deep framebuffer) -> transfer -> Relighter
//! ```

mod memory;
mod open;
mod parts;
mod plan;
mod prepared;
mod progress;
mod refine;
mod report;
mod survey;
mod target;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

pub use self::memory::check_fits;
pub use self::open::{OpenSettings, Opened, build_bvh, check_size};
pub use self::plan::{BakeInput, ERROR, Form, IndirectSettings, THESIS_BOUNCES, TransferPlan};
pub use self::progress::Progress;
pub use self::refine::{Refinement, Until};
pub use self::report::{BakeReport, Stage, cpu_seconds, peak_bytes};
pub use self::survey::{CountedIn, FramebufferCounts, NoSky, Survey, Unneeded};
pub use self::target::Target;

use self::memory::check_memory;
use self::open::choose_view;
use self::prepared::Prepared;
use self::progress::{advance, until_cancelled};
use crate::bake::baselines::thesis::ThesisSettings;
use crate::bake::compression::Fitted;
use crate::bake::compression::validation::ValidationError;
use crate::bake::transfer::Transfer;
use crate::bake::transfer::sky::SkyTransfer;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::{Outgoing, TransferSettings};
use crate::bake::{BakeSettings, DeepFramebuffer, at_rest, bake, cache, low_priority};
use crate::error::{Error, Result};
use crate::gpu::{Context, Validation};
use crate::relight::{RelightSettings, Relighter, choose_device};
use crate::scene::{Camera, Light, Rig, Scene};
use crate::trace::bvh::TracedScene;

/// What a session bakes.
#[derive(Clone, Debug)]
pub struct SessionSettings {
    pub open: OpenSettings,
    /// Layers of the deep framebuffer: 1 has no reflections.
    pub layers: u32,
    /// View samples of a pixel on an edge.
    pub samples: u32,
    /// Leaves nothing of the deep framebuffer out, nor the transfer's harmonics; pictures are the same.
    pub force_all: bool,
    /// Everything random follows from it.
    pub seed: u64,
    /// Where baked data lives; `None`: nowhere.
    pub cache_dir: Option<PathBuf>,
    /// Indirect light, if there is to be any.
    pub indirect: Option<IndirectSettings>,
    /// What the pictures are to be made on: what cannot fit there is refused before it is baked. `None`: not asked.
    pub target: Option<Target>,
    /// Lights that will be shown besides those of the rig: their edges get samples too, and the sky if one is a dome.
    pub other_lights: Vec<Light>,
}

impl Default for SessionSettings {
    fn default() -> Self {
        Self {
            open: OpenSettings::default(),
            layers: 4,
            samples: 1,
            force_all: false,
            seed: 1,
            cache_dir: user_cache_dir(),
            indirect: Some(IndirectSettings::default()),
            target: None,
            other_lights: Vec::new(),
        }
    }
}

impl SessionSettings {
    /// Refuses numbers that mean nothing.
    fn check(&self) -> Result<()> {
        if self.layers == 0 || self.samples == 0 {
            return Err(Error::invalid("settings", "layers and samples must be at least 1"));
        }
        self.indirect.map_or(Ok(()), |indirect| indirect.check())
    }

    /// Refuses what means nothing, and pictures that do not fit this machine.
    fn check_view(&self, scene: &Scene, rig: &Rig, size: [u32; 2]) -> Result<()> {
        self.check()?;
        let forced = if self.force_all { self.layers - 1 } else { 0 };
        check_memory(size, self.samples, forced, rig.lights.len(), &scene.path)
    }
}

/// `$XDG_CACHE_HOME/relume`, else `~/.cache/relume`; `%LOCALAPPDATA%\relume` on Windows.
pub fn user_cache_dir() -> Option<PathBuf> {
    let from = |variable: &str| std::env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute());
    let base = from("XDG_CACHE_HOME").or_else(|| from("LOCALAPPDATA")).or_else(|| Some(from("HOME")?.join(".cache")));
    base.map(|base| base.join("relume"))
}

/// A scene with its BVH, baked for one camera.
pub struct Session {
    pub scene: Arc<TracedScene>,
    pub framebuffer: Arc<DeepFramebuffer>,
    /// Indirect light, once it is there.
    pub transfer: Option<Arc<Transfer>>,
    /// The lights that the first picture shows.
    pub rig: Rig,
    /// The lights of all shots.
    pub base_rig: Rig,
    pub bake: BakeReport,
    /// Names what the deep framebuffer depends on.
    pub key: cache::Key,
    pub cache_dir: Option<PathBuf>,
    /// Absent without indirect light.
    pub transfers: Option<Transfers>,
    /// One sample a pixel, to which indirect light is baked where `framebuffer` has more and can take it over.
    plain: Option<Arc<DeepFramebuffer>>,
}

/// Where transfers to one deep framebuffer come from.
pub struct Transfers {
    pub plan: TransferPlan,
    /// What the deep framebuffer depends on.
    inputs: cache::Inputs,
    key: cache::Key,
    dir: Option<PathBuf>,
    force_all: bool,
    /// Whether light of the sky is baked, too: there is a dome.
    sky: bool,
}

impl Transfers {
    /// Nothing left out where that is asked for: all harmonics, even if no sample has them.
    fn forced(&self, transfer: Transfer) -> Transfer {
        Transfer { all_degrees: self.force_all, ..transfer }
    }

    /// As `--gi` calls it.
    pub fn gi(&self) -> &'static str {
        let (TransferPlan::Robust(TransferSettings { outgoing, .. }, _)
        | TransferPlan::Thesis(ThesisSettings { outgoing, .. })) = &self.plan;
        if *outgoing == Outgoing::Diffuse { "diffuse" } else { "glossy" }
    }

    fn key(&self, lobe: Lobe) -> cache::Key {
        cache::transfer_key(&self.key, &(&self.plan, lobe))
    }

    fn sky_key(&self, lobe: Lobe) -> cache::Key {
        cache::transfer_key(&self.key, &(&self.plan, lobe, "sky"))
    }

    fn stored(&self, framebuffer: &DeepFramebuffer, lobe: Lobe, report: &mut BakeReport) -> Option<Transfer> {
        let (dir, key) = (self.dir.as_deref()?, self.key(lobe));
        let stored = report.stage("read cache", || cache::load_transfer(dir, &key, framebuffer))?;
        Some(self.forced(stored))
    }

    /// Whether the cache has a transfer, without light of the sky.
    fn is_stored(&self, lobe: Lobe) -> bool {
        self.dir.as_deref().is_some_and(|dir| cache::has(dir, &self.key(lobe)))
    }

    fn stored_sky(&self, framebuffer: &DeepFramebuffer, lobe: Lobe) -> Option<SkyTransfer> {
        cache::load_sky(self.dir.as_deref()?, &self.sky_key(lobe), framebuffer)
    }

    /// Calls `show` with a first transfer after a second and a coarse one after many, unless the cache has the fine
    /// one, then with that, which it also returns. Bakes on threads of its own, so that lights can be edited meanwhile.
    pub fn refine(
        &self,
        seen: BakeInput,
        progress: &dyn Progress,
        show: impl Fn(Arc<Transfer>) + Sync,
    ) -> Result<Arc<Transfer>> {
        let mut report = BakeReport::default();
        let is_stored = self.is_stored(Lobe::All);
        let show = |transfer: Transfer| {
            let transfer = Arc::new(transfer.with_coarse());
            show(transfer.clone());
            transfer
        };
        let preview = |plan: Option<TransferPlan>, pixels: f64, report: &mut BakeReport| {
            let Some(plan) = plan.filter(|_| !is_stored) else { return Ok(()) };
            let BakeInput { scene, framebuffer } = seen;
            let small = reduced(seen, pixels);
            let input = BakeInput { scene, framebuffer: small.as_ref().unwrap_or(framebuffer) };
            let made = plan.bake(input, Lobe::All, false, report, progress)?;
            let made = match &small {
                Some(small) => made.upsampled(small, framebuffer, scene.bvh.radius).expect("it has blocks"),
                None => made,
            };
            show(self.forced(made));
            Ok(())
        };
        until_cancelled(|| at_rest(|| preview(self.plan.first(), FIRST_PIXELS, &mut report)))?;
        until_cancelled(|| {
            low_priority(|| {
                preview(self.plan.coarse(), COARSE_PIXELS, &mut report)?;
                let first = |transfer: &Transfer| {
                    show(transfer.clone());
                };
                Ok(show(self.get(seen, Lobe::All, [None, None], &first, &mut report, progress)?))
            })
        })
    }

    /// Whether the transfer could have light of the sky, which it has not because there was no dome.
    pub fn lacks_sky(&self) -> bool {
        !self.sky && self.plan.has_sky()
    }

    /// Adds light of the sky, from the cache or baked as by [`Transfers::refine`].
    pub fn add_sky(&self, transfer: &Transfer, seen: BakeInput, progress: &dyn Progress) -> Result<Transfer> {
        let mut report = BakeReport::default();
        let lobe = Lobe::All;
        let bake = |report: &mut BakeReport| {
            let mut prepared = self.prepare(seen, lobe, report, progress);
            self.bake_sky(&mut prepared, lobe, None, report, progress)
        };
        let sky = match self.stored_sky(seen.framebuffer, lobe) {
            Some(sky) => sky,
            None => until_cancelled(|| low_priority(|| bake(&mut report)))?,
        };
        Ok(Transfer { sky: Some(sky), ..transfer.clone() })
    }

    /// Whether light of the sky is part of the transfer.
    fn has_sky(&self) -> bool {
        self.sky && self.plan.has_sky()
    }

    /// From the cache, or baked and kept there; `fits` are those that parts made, of the operator and of light of the
    /// sky. `first` gets what is there while light of the sky is baked.
    fn get(
        &self,
        seen: BakeInput,
        lobe: Lobe,
        [fits, sky_fits]: [Option<Vec<Fitted>>; 2],
        first: &dyn Fn(&Transfer),
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Transfer> {
        let framebuffer = seen.framebuffer;
        let stored = self.stored(framebuffer, lobe, report);
        let stored_sky = if self.has_sky() { self.stored_sky(framebuffer, lobe) } else { None };
        let is_complete = stored.is_some() && (stored_sky.is_some() || !self.has_sky());
        report.cached &= is_complete;
        let stored = match stored {
            Some(transfer) if is_complete => return Ok(Transfer { sky: stored_sky, ..transfer }),
            stored => stored,
        };
        let mut prepared = self.prepare(seen, lobe, report, progress);
        let transfer = match stored {
            Some(transfer) => transfer,
            None => {
                let key = self.key(lobe);
                let made = prepared.bake(lobe, fits, self.journal(&key).as_deref(), report, progress)?;
                let name = seen.scene.name();
                self.keep(report, |dir| cache::store_transfer(dir, &key, &name, framebuffer, &made));
                self.forced(made)
            }
        };
        if !self.has_sky() {
            return Ok(transfer);
        }
        let sky = match stored_sky {
            Some(sky) => sky,
            None => {
                first(&transfer);
                self.bake_sky(&mut prepared, lobe, sky_fits, report, progress)?
            }
        };
        Ok(Transfer { sky: Some(sky), ..transfer })
    }

    /// Bakes light of the sky and keeps it in the cache.
    fn bake_sky(
        &self,
        prepared: &mut Prepared,
        lobe: Lobe,
        fits: Option<Vec<Fitted>>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<SkyTransfer> {
        let key = self.sky_key(lobe);
        let made = prepared.bake_sky(lobe, fits, self.journal(&key).as_deref(), report, progress)?;
        let BakeInput { scene, framebuffer } = prepared.input();
        self.keep(report, |dir| cache::store_sky(dir, &key, &scene.name(), framebuffer, &made));
        Ok(made)
    }

    fn journal(&self, key: &cache::Key) -> Option<PathBuf> {
        self.dir.as_ref().map(|dir| cache::file_of(dir, key, "journal"))
    }

    /// Writes something to the cache. An error is only reported: a read-only cache works.
    fn keep(&self, report: &mut BakeReport, store: impl FnOnce(&Path) -> Result<()>) {
        if let Some(dir) = &self.dir
            && let Err(error) = report.stage("write cache", || store(dir))
        {
            tracing::info!("not stored in the cache: {}", error.chain());
            report.not_stored = Some(error);
        }
    }
}

/// Pixels of a first and of a coarse transfer at most: they take as long for large pictures.
const FIRST_PIXELS: f64 = 5_400.0;
const COARSE_PIXELS: f64 = 65_536.0;

/// The same view with at most `pixels` pixels; `None` if it has no more.
fn reduced(BakeInput { scene, framebuffer }: BakeInput, pixels: f64) -> Option<DeepFramebuffer> {
    let [width, height] = [framebuffer.tiling.width, framebuffer.tiling.height];
    let scale = (pixels / (f64::from(width) * f64::from(height))).sqrt();
    let [width, height] = [width, height].map(|side| ((f64::from(side) * scale) as u32).max(1));
    let settings = BakeSettings { width, height, layers: framebuffer.asked_layers, samples: 1 };
    (scale < 1.0).then(|| bake(scene, &framebuffer.camera, &Rig::default(), &settings, &|_| ()))
}

impl Session {
    /// Loads and bakes `path` with the lights of `rig_path`, or its own. Errors: [`Error::Import`] of a file,
    /// [`Error::Invalid`] of what does not fit memory or the device, [`Error::Cancelled`].
    pub fn open(
        path: &Path,
        rig_path: Option<&Path>,
        settings: &SessionSettings,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let mut session = Self::open_direct(path, rig_path, settings, progress)?;
        if session.transfers.is_none() {
            return Ok(session);
        }
        let transfer = session.transfer(Lobe::All, progress)?;
        session.transfer = Some(Arc::new(transfer));
        Ok(session)
    }

    /// Indirect light from the cache, or baked: to one sample a pixel, whose rows serve its further samples, so that it
    /// does not depend on where the lights' shadow edges lie.
    fn transfer(&mut self, lobe: Lobe, progress: &dyn Progress) -> Result<Transfer> {
        let Self { scene, framebuffer, bake, transfers, plain, .. } = self;
        let transfers = transfers.as_ref().expect("there is indirect light");
        let get = move |bake: &mut BakeReport| {
            let Some(plain) = plain.as_deref() else {
                return transfers.get(BakeInput { scene, framebuffer }, lobe, [None, None], &|_| (), bake, progress);
            };
            let input = BakeInput { scene, framebuffer: plain };
            let transfer = transfers.get(input, lobe, [None, None], &|_| (), bake, progress)?;
            let spread = bake.stage("spread transfer", || transfer.spread(plain, framebuffer, scene.bvh.radius));
            Ok(spread.expect("such a transfer has no plain bake"))
        };
        bake.clocked(|bake| until_cancelled(|| get(bake)))
    }

    /// How far indirect light is from rows gathered anew, under points and spots.
    pub fn verify(&self, progress: &dyn Progress) -> Result<[ValidationError; 2]> {
        let (Some(transfers), Some(transfer)) = (&self.transfers, &self.transfer) else {
            return Err(Error::invalid("--verify", "with --gi off there is no transfer to measure"));
        };
        until_cancelled(|| transfers.plan.verify(self.seen(), transfer, progress))
    }

    /// All but indirect light.
    pub fn open_direct(
        path: &Path,
        rig_path: Option<&Path>,
        settings: &SessionSettings,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let mut report = BakeReport::default();
        let opened =
            report.clocked(|report| report.stage("load", || Opened::new(path, rig_path, &settings.open, progress)))?;
        Self::of(opened, settings, report, progress)
    }

    /// The same of what is open already; `report` is of opening it.
    pub fn of(
        opened: Opened,
        settings: &SessionSettings,
        mut report: BakeReport,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let Opened { scene, rig, base_rig, camera, size } = opened;
        settings.check_view(&scene, &rig, size)?;
        let scene = report.clocked(|report| report.stage("build BVH", || build_bvh(scene, progress)));
        Self::of_view(Arc::new(scene), [rig, base_rig], (camera, size), settings, report, progress)
    }

    /// A scene that another session opened, from the camera that `settings` name. `rig`: the lights of all shots.
    pub fn of_traced(
        scene: Arc<TracedScene>,
        rig: Rig,
        settings: &SessionSettings,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let view = choose_view(&scene, &rig, &settings.open)?;
        settings.check_view(&scene, &rig, view.1)?;
        let seen = rig.of_shot(&view.0.name).map_err(|reason| Error::invalid("the lights", reason))?;
        Self::of_view(scene, [seen, rig], view, settings, BakeReport::default(), progress)
    }

    fn of_view(
        scene: Arc<TracedScene>,
        [rig, base_rig]: [Rig; 2],
        (camera, size @ [width, height]): (Camera, [u32; 2]),
        settings: &SessionSettings,
        mut report: BakeReport,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let (start, cpu_start) = (Instant::now(), cpu_seconds());
        let SessionSettings { layers, samples, seed, .. } = *settings;
        let plan = settings.indirect.map(|indirect| indirect.plan(size, layers, seed));
        let fits = |counts: &FramebufferCounts| {
            let refusal = settings.target.as_ref().and_then(|target| {
                target.footprint(&scene, &rig, [width, height], counts, plan.as_ref()).refusal(&target.device)
            });
            refusal.map_or(Ok(()), |reason| Err(Error::invalid(scene.path.display().to_string(), reason)))
        };
        fits(&FramebufferCounts::fewest([width, height]))?;
        let of_framebuffer = BakeSettings { width, height, layers, samples };
        let mut baked_for = rig.clone();
        baked_for.lights.extend_from_slice(&settings.other_lights);
        let cache_dir = &settings.cache_dir;
        report.cached = true; // until something is made
        let framebuffer =
            |settings: &BakeSettings, report: &mut BakeReport| -> Result<(cache::Inputs, DeepFramebuffer)> {
                let inputs = cache::Inputs::of(&scene, &camera, &baked_for, settings);
                let key = inputs.key();
                let stored = cache_dir
                    .as_deref()
                    .and_then(|dir| report.stage("read cache", || cache::load(dir, &key, &camera, settings)));
                report.cached &= stored.is_some();
                if let Some(framebuffer) = stored {
                    return Ok((inputs, framebuffer));
                }
                let because = cache_dir.as_deref().and_then(|dir| inputs.changes(dir, &scene.name()));
                if let Some(changed) = &because {
                    tracing::info!("baked again, because of what changed since: {changed}");
                }
                report.because = report.because.take().or(because);
                let passes = if settings.samples > 1 { 2 } else { 1 };
                progress.begin("deep framebuffer", passes * settings.tile_count());
                let make = || bake(&scene, &camera, &baked_for, settings, &advance(progress));
                let framebuffer = until_cancelled(|| Ok(report.stage("deep framebuffer", make)))?;
                progress.end();
                if let Some(dir) = cache_dir
                    && let Err(error) =
                        report.stage("write cache", || cache::store(dir, &inputs, &scene.name(), &framebuffer))
                {
                    tracing::info!("not stored in the cache: {}", error.chain()); // a read-only cache works
                    report.not_stored = Some(error);
                }
                Ok((inputs, framebuffer))
            };
        let plain = (samples > 1 && plan.as_ref().is_some_and(TransferPlan::spreads))
            .then(|| framebuffer(&BakeSettings { samples: 1, ..of_framebuffer.clone() }, &mut report))
            .transpose()?;
        let (inputs, framebuffer) = framebuffer(&of_framebuffer, &mut report)?;
        let key = inputs.key();
        let framebuffer = if settings.force_all { framebuffer.into_worst_case() } else { framebuffer };
        // Only now it is known how much mirrors and edges add. Indirect light takes longest.
        fits(&FramebufferCounts::new(&framebuffer, scene.materials.len()))?;
        let plain_inputs = plain.as_ref().map_or(inputs, |(inputs, _)| inputs.clone());
        let plain_key = match plain_inputs.key() {
            key if plain.is_none() && settings.force_all => cache::transfer_key(&key, &"nothing left out"),
            key => key,
        };
        let sky = baked_for.has_domes();
        let transfers = plan.map(|plan| Transfers {
            plan,
            inputs: plain_inputs,
            key: plain_key,
            dir: cache_dir.clone(),
            force_all: settings.force_all,
            sky,
        });
        let plain = plain.map(|(_, framebuffer)| Arc::new(framebuffer));
        report.seconds += start.elapsed().as_secs_f64();
        report.cpu_seconds += cpu_seconds() - cpu_start;
        let framebuffer = Arc::new(framebuffer);
        Ok(Self {
            scene,
            framebuffer,
            transfer: None,
            rig,
            base_rig,
            bake: report,
            key,
            cache_dir: cache_dir.clone(),
            transfers,
            plain,
        })
    }

    /// A Vulkan device by its index or a part of its name, or the fastest one: see [`choose_device`]. Compiled kernels
    /// go to the cache. Debug builds turn validation layers on.
    pub fn context(&self, device: Option<&str>) -> Result<Arc<Context>> {
        let validation = if cfg!(debug_assertions) { Validation::On } else { Validation::Off };
        let cache_dir = self.cache_dir.as_deref();
        Context::new(choose_device(device, cache_dir)?.as_deref(), validation, cache_dir)
    }

    /// What makes pictures of the scene under `rig`'s lights, and any edit of these.
    pub fn relighter(&self, context: &Arc<Context>, rig: &Rig, settings: &RelightSettings) -> Result<Relighter> {
        Relighter::new(context, &self.scene, &self.framebuffer, self.transfer.as_ref(), rig, settings)
    }

    /// A relighter whose indirect light is what the pixels' specular lobes make of it.
    pub fn glossy_relighter(
        &mut self,
        context: &Arc<Context>,
        rig: &Rig,
        settings: &RelightSettings,
        progress: &dyn Progress,
    ) -> Result<Relighter> {
        let transfer = self.transfer(Lobe::Specular, progress)?;
        Relighter::new(context, &self.scene, &self.framebuffer, Some(&Arc::new(transfer)), rig, settings)
    }

    /// View samples in each layer that was asked for, seen or not.
    pub fn layers(&self) -> Vec<usize> {
        self.counts().layers
    }

    pub fn seen(&self) -> BakeInput<'_> {
        BakeInput { scene: &self.scene, framebuffer: &self.framebuffer }
    }

    pub fn size(&self) -> (usize, usize) {
        (self.framebuffer.tiling.width as usize, self.framebuffer.tiling.height as usize)
    }
}
