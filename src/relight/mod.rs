//! Relighting: pictures of a baked scene whose lights are edited.

mod device_choice;
mod factor_budget;
mod finite_check;
pub mod footprint;
mod frame;
mod gpu_framebuffer;
pub mod indirect;
pub mod light_cache;
mod light_changes;
mod light_factors;
mod light_images;
mod light_sights;
mod light_target;
pub mod output;
mod passes;
mod request;
pub mod roofline;
mod some_points;
mod visibility;

use std::collections::HashMap;
use std::sync::Arc;

use glam::{Vec3, Vec4};

pub use self::device_choice::{DeviceSpeed, choose_device};
use self::finite_check::FiniteCheck;
use self::gpu_framebuffer::{EmitterImages, GpuFramebuffer};
use self::indirect::Indirect;
use self::indirect::images::IndirectImages;
use self::indirect::sky_importance::SkyImportances;
use self::indirect::sky_light::SkyTerms;
pub use self::light_cache::Detail;
use self::light_cache::{LightCache, Term};
pub use self::light_changes::{LightChanges, StandingLight};
use self::light_factors::SampleTriangles;
use self::light_images::{LightImages, light_image};
use self::light_sights::LightSights;
use self::output::inspect::Inspector;
use self::output::sheet::Sheet;
use self::output::{Output, Outputs};
pub use self::request::{Layers, Picture, Request, ToneMap};
use self::some_points::SomePoints;
use self::visibility::VisibilityBuffers;
use self::visibility::method::VisibilityChoice;
pub use self::visibility::method::{VisibilityMethod, VisibilityTimes};
use self::visibility::shadow_map::ShadowMaps;
use self::visibility::soft_light::SoftLights;
use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::error::{Error, Result};
use crate::gpu::{Access, Buffer, Context, Frames, Kernel, PassTime, Pixels, Screen};
use crate::scene::{Emitters, Light, LightKind, ResolvedLinks, Rig};
use crate::shared::{MAX_LIGHTS_PER_PASS, ResolvePush, ShadeLightConstants, ShadeLightPush, SumImagesPush};
use crate::trace::bvh::TracedScene;

/// Where light is transformed and multiplied by a transfer of blocks, and where images of lights are summed. Row
/// wavelets are multiplied by kernels in any case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Site {
    /// By kernels.
    Device,
    /// On devices whose kernels run on the CPU; others do it by kernels.
    Host,
}

/// Settings of a [`Relighter`].
#[derive(Clone, Debug)]
pub struct RelightSettings {
    pub visibility: VisibilityMethod,
    /// Side of a shadow map in texels.
    pub shadow_size: u32,
    /// Device memory for light images and transfer factors; `None`: three quarters of the device's memory.
    pub budget_bytes: Option<u64>,
    /// Whether images of lights are kept for later pictures, as far as the budget allows. If not, there are only as
    /// many as one picture needs, and thousands of lights take no more memory than fifty.
    pub keep_images: bool,
    /// `None`: where kernels run. For tests.
    pub site: Option<Site>,
}

impl Default for RelightSettings {
    fn default() -> Self {
        Self {
            visibility: VisibilityMethod::Auto,
            shadow_size: 1024,
            budget_bytes: None,
            keep_images: true,
            site: None,
        }
    }
}

impl RelightSettings {
    /// `is_cpu`: whether kernels run on the CPU.
    pub fn site_on(&self, is_cpu: bool) -> Site {
        if is_cpu { self.site.unwrap_or(Site::Host) } else { Site::Device }
    }
}

/// Renders pictures of a baked scene for a rig. Images of lights that did not change are reused.
pub struct Relighter {
    context: Arc<Context>,
    frames: Frames,
    scene: Arc<TracedScene>,
    framebuffer: Arc<DeepFramebuffer>,
    transfer: Option<Arc<Transfer>>,
    gpu: GpuFramebuffer,
    indirect: Option<Indirect>,
    cache: LightCache,
    /// Of the lights that have any, by index.
    links: HashMap<usize, ResolvedLinks>,
    /// `None` as long as no light has links that scale its light.
    triangles: Option<SampleTriangles>,
    /// `None` as long as no light has a size.
    sights: Option<LightSights>,
    /// `None` as long as no light has a size.
    soft: Option<SoftLights>,
    skies: SkyImportances,
    /// `None` as long as no transfer has light of the sky.
    sky_terms: Option<SkyTerms>,
    images: LightImages,
    /// See [`Source::SomePoints`]; `None` if all lights are without size.
    some_points: Option<SomePoints>,
    /// What is added to images of lights.
    changes: LightChanges,
    /// `None` as long as none was asked for.
    indirect_images: Option<IndirectImages>,
    /// Bytes of device memory for the factors of the transfer.
    transfer_budget: u64,
    site: Site,
    rest: Buffer<Vec4>,
    /// Planes of the extra samples' radiance, for each light of a batch.
    extras: Vec<Buffer<f32>>,
    visibility: VisibilityBuffers,
    shadow_maps: Option<ShadowMaps>,
    /// Why there are shadow maps, or none.
    visibility_reason: String,
    kernels: Kernels,
    outputs: Outputs,
    /// Layers that the light images contain.
    layers: Layers,
    finite_check: Option<FiniteCheck>,
    inspector: Option<Inspector>,
    sheet: Sheet,
    /// Picture, output and terms of the last frame.
    shown: Option<(Picture, Output, Vec<Term>)>,
    /// Pass times of all frames of the last call.
    times: Vec<PassTime>,
    /// See [`Relighter::set_progress`].
    progress: Option<Box<dyn Fn(usize, usize) + Send + Sync>>,
}

struct Kernels {
    shade_light: Kernel<ShadeLightPush>,
    resolve: Kernel<ResolvePush>,
    sum_images: Kernel<SumImagesPush>,
}

impl Relighter {
    /// Uploads the bake and allocates light images. `transfer`: `None` for direct light only.
    ///
    /// The budget holds first the fewest light images that a frame needs, then factors of the transfer, then further
    /// light images. Factors that do not fit, or for which the device has no room, stay in host memory.
    pub fn new(
        context: &Arc<Context>,
        scene: &Arc<TracedScene>,
        framebuffer: &Arc<DeepFramebuffer>,
        transfer: Option<&Arc<Transfer>>,
        rig: &Rig,
        settings: &RelightSettings,
    ) -> Result<Self> {
        let rig = &*Emitters::of(scene).complete(rig);
        let links = resolved(rig, scene)?;
        let VisibilityChoice { traced, reason } = settings.visibility.choose(context, scene);
        tracing::info!("shadows: {} ({reason})", if traced { "traced" } else { "maps" });
        let image_bytes = 12 * framebuffer.pixel_stride() as u64;
        let (fewest, _) = LightCache::slot_range(rig.lights.len());
        let of = transfer.map(Arc::as_ref);
        // Another relighter may already hold memory.
        let budget = settings.budget_bytes.map(|budget| budget.saturating_sub(held(context)));
        // What the picture cannot do without comes first.
        let frames = Frames::new(context)?;
        let gpu = GpuFramebuffer::new(context, scene, framebuffer, of)?;
        let visibility = VisibilityBuffers::new(context, framebuffer, of, traced, rig.has_factors())?;
        let shadow_maps = if traced { None } else { Some(ShadowMaps::new(context, scene, settings.shadow_size)?) };
        let batch = batch_size(rig.lights.len());
        let extras = (0..batch).map(|_| extra_planes(context, framebuffer)).collect::<Result<_>>()?;
        let rest = light_image(context, framebuffer, "light images (rest)")?;
        let mut images = LightImages::new(context, framebuffer, LightImages::NAME, fewest)?;
        let budget = budget.unwrap_or_else(|| {
            let left = context.info.usable_bytes().saturating_sub(held(context));
            left + fewest as u64 * image_bytes
        });
        let transfer_budget = budget.saturating_sub(fewest as u64 * image_bytes);
        let site = settings.site_on(context.is_cpu());
        let indirect = transfer.map(|t| Indirect::new(context, t, site, transfer_budget)).transpose()?;
        let taken = indirect.as_ref().map_or(0, |indirect| indirect.device_bytes);
        let image_budget = ((budget - taken.min(budget)) / image_bytes) as usize;
        if image_budget < fewest {
            tracing::warn!("the budget holds {image_budget} light images; the minimum of {fewest} is allocated");
        }
        images.set_budget(if settings.keep_images { image_budget } else { fewest });
        images.grow(context, framebuffer, rig.lights.len(), 0)?;
        let mut skies = SkyImportances::default();
        skies.update(scene, framebuffer, of, rig, &links);
        let some_points = rig.has_sizes().then(|| SomePoints::new(context, framebuffer)).transpose()?;
        Ok(Self {
            frames,
            cache: LightCache::new(rig, images.len(), gpu.emitters.by_material().clone()),
            triangles: scales(&links).then(|| SampleTriangles::find(scene, framebuffer, of)),
            sights: LightSights::find(context, scene, framebuffer, rig)?,
            soft: SoftLights::find(context, framebuffer, of, rig)?,
            skies,
            sky_terms: sky_terms(context, of)?,
            links,
            gpu,
            indirect,
            images,
            some_points,
            changes: LightChanges::default(),
            indirect_images: None,
            transfer_budget,
            site,
            rest,
            extras,
            visibility,
            shadow_maps,
            visibility_reason: reason,
            kernels: Kernels {
                shade_light: Kernel::new(context, ShadeLightConstants { specular: framebuffer.has_specular })?,
                resolve: Kernel::new(context, ())?,
                sum_images: Kernel::new(context, ())?,
            },
            outputs: Outputs::new(context, framebuffer.tiling.width as usize * framebuffer.tiling.height as usize),
            layers: Layers::All,
            finite_check: None,
            inspector: None,
            sheet: Sheet::default(),
            shown: None,
            times: Vec::new(),
            progress: None,
            context: context.clone(),
            scene: scene.clone(),
            framebuffer: framebuffer.clone(),
            transfer: transfer.cloned(),
        })
    }

    pub fn rig(&self) -> &Rig {
        self.cache.rig()
    }

    pub fn framebuffer(&self) -> &Arc<DeepFramebuffer> {
        &self.framebuffer
    }

    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// Time of each pass of the last picture.
    pub fn times(&self) -> &[PassTime] {
        &self.times
    }

    /// Whether shadow rays are traced on the CPU; otherwise shadow maps are drawn.
    pub fn traces(&self) -> bool {
        self.shadow_maps.is_none()
    }

    /// Why shadow rays are traced, or shadow maps drawn.
    pub fn visibility_reason(&self) -> &str {
        &self.visibility_reason
    }

    /// Calls `progress` after each frame of pictures that take several, with the number of lights that are done and
    /// that of all.
    pub fn set_progress(&mut self, progress: impl Fn(usize, usize) + Send + Sync + 'static) {
        self.progress = Some(Box::new(progress));
    }

    /// Replaces the lights; the next picture shows them. May allocate memory if there are more lights.
    pub fn set_rig(&mut self, rig: &Rig) -> Result<()> {
        let rig = &*Emitters::of(&self.scene).complete(rig);
        let old = self.rig();
        if rig.sets != old.sets || !rig.lights.iter().map(|l| &l.links).eq(old.lights.iter().map(|l| &l.links)) {
            self.links = resolved(rig, &self.scene)?;
            self.skies.clear();
            if self.triangles.is_none() && scales(&self.links) {
                self.find_triangles();
            }
        }
        self.images.grow(&self.context, &self.framebuffer, rig.lights.len(), 0)?;
        for _ in self.extras.len()..batch_size(rig.lights.len()) {
            self.extras.push(extra_planes(&self.context, &self.framebuffer)?);
        }
        if self.some_points.is_none() && rig.has_sizes() {
            self.some_points = Some(SomePoints::new(&self.context, &self.framebuffer)?);
        }
        let suffices = |sights: &LightSights| sights.suffice(rig);
        if rig.has_sizes() && !self.sights.as_ref().is_some_and(suffices) {
            self.sights = LightSights::find(&self.context, &self.scene, &self.framebuffer, rig)?;
        }
        match &mut self.soft {
            Some(soft) => soft.allow(&self.context, &self.framebuffer, rig)?,
            None => self.soft = SoftLights::find(&self.context, &self.framebuffer, self.transfer.as_deref(), rig)?,
        }
        if rig.has_factors() {
            self.visibility.allow_factors(&self.context, &self.framebuffer, self.transfer.as_deref())?;
        }
        self.skies.update(&self.scene, &self.framebuffer, self.transfer.as_deref(), rig, &self.links);
        self.cache.set_rig(rig, self.images.len());
        self.match_changes();
        Ok(())
    }

    /// Replaces what is added to images of lights that stand as the changes say, in all pictures with indirect light.
    pub fn set_changes(&mut self, changes: &LightChanges) -> Result<()> {
        if self.changes.is_same(changes) {
            return Ok(());
        }
        // An image more of each light that has a change.
        let light_count = self.cache.rig().lights.len();
        self.images.grow(&self.context, &self.framebuffer, light_count, changes.len())?;
        self.cache.grow(self.images.len());
        self.changes = changes.clone();
        self.match_changes();
        Ok(())
    }

    fn match_changes(&mut self) {
        let layers = self.layers;
        // Pictures of indirect light alone do not show emitters.
        let shows = |light: &Light| layers == Layers::All || (layers.indirect() && light.kind != LightKind::Emitter);
        self.cache.set_changes(|rig, light| self.changes.of(rig, light).filter(|_| shows(&rig.lights[light])));
    }

    /// Replaces the transfer by another one to the same view samples; the next picture uses it.
    pub fn set_transfer(&mut self, transfer: Arc<Transfer>) -> Result<()> {
        self.indirect = None; // frees its memory first
        let (traced, factors) = (self.traces(), self.visibility.allows_factors());
        self.visibility = VisibilityBuffers::new(&self.context, &self.framebuffer, Some(&transfer), traced, factors)?;
        self.gpu.emitters = EmitterImages::new(&self.context, &self.scene, &self.framebuffer, Some(&transfer))?;
        self.indirect = Some(Indirect::new(&self.context, &transfer, self.site, self.transfer_budget)?);
        if let Some(soft) = &mut self.soft {
            soft.set_transfer(&transfer);
        }
        self.sky_terms = sky_terms(&self.context, Some(&transfer))?;
        self.transfer = Some(transfer);
        self.find_again();
        Ok(())
    }

    /// Replaces the bake by another one of the same view of the same scene; the next picture uses it.
    ///
    /// Panics if the picture size differs.
    pub fn set_framebuffer(
        &mut self,
        framebuffer: Arc<DeepFramebuffer>,
        transfer: Option<Arc<Transfer>>,
    ) -> Result<()> {
        let size = |framebuffer: &DeepFramebuffer| (framebuffer.tiling.width, framebuffer.tiling.height);
        assert_eq!(size(&framebuffer), size(&self.framebuffer), "light images have the size of the first bake");
        if framebuffer.has_specular != self.framebuffer.has_specular {
            let constants = ShadeLightConstants { specular: framebuffer.has_specular };
            self.kernels.shade_light = Kernel::new(&self.context, constants)?;
        }
        let of = transfer.as_deref();
        self.indirect = None; // frees its memory first
        let (traced, factors) = (self.traces(), self.visibility.allows_factors());
        self.visibility = VisibilityBuffers::new(&self.context, &framebuffer, of, traced, factors)?;
        self.gpu = GpuFramebuffer::new(&self.context, &self.scene, &framebuffer, of)?;
        for extras in &mut self.extras {
            *extras = extra_planes(&self.context, &framebuffer)?;
        }
        self.indirect = of.map(|t| Indirect::new(&self.context, t, self.site, self.transfer_budget)).transpose()?;
        self.sights = LightSights::find(&self.context, &self.scene, &framebuffer, self.cache.rig())?;
        self.soft = SoftLights::find(&self.context, &framebuffer, of, self.cache.rig())?;
        self.sky_terms = sky_terms(&self.context, of)?;
        (self.framebuffer, self.transfer) = (framebuffer, transfer);
        self.find_again();
        Ok(())
    }

    /// After a change of the samples.
    fn find_again(&mut self) {
        if self.triangles.is_some() {
            self.find_triangles();
        }
        self.skies.clear();
        let rig = self.cache.rig();
        self.skies.update(&self.scene, &self.framebuffer, self.transfer.as_deref(), rig, &self.links);
        self.invalidate_all();
    }

    fn find_triangles(&mut self) {
        let transfer = self.transfer.as_deref();
        self.triangles = Some(SampleTriangles::find(&self.scene, &self.framebuffer, transfer));
    }

    /// Invalidates all images.
    fn invalidate_all(&mut self) {
        self.indirect_images = None;
        self.invalidate_images();
        self.shown = None;
        self.sheet.invalidate();
    }

    fn invalidate_images(&mut self) {
        self.cache.invalidate(self.emitters());
    }

    /// Index of the image of each emitter that the layers show, by its material.
    fn emitters(&self) -> HashMap<String, usize> {
        if self.layers == Layers::All { self.gpu.emitters.by_material().clone() } else { HashMap::new() }
    }

    /// Number of lights whose images must be rendered before a whole picture of these layers.
    pub fn pending(&self, layers: Layers) -> usize {
        if layers == self.layers { self.cache.pending().0 } else { self.rig().lights.len() }
    }

    /// Renders the exact image of one [pending](Self::pending) light, or a part of it if the light has a size, so that
    /// a whole picture takes less time.
    pub fn prepare(&mut self, layers: Layers) -> Result<()> {
        self.set_layers_and_detail(layers, Detail::Exact);
        let Some(light) = self.cache.pending().1 else { return Ok(()) };
        let plan = self.cache.plan_part(light, 1);
        self.execute_or_invalidate(&plan, None)
    }

    /// Number of lights in the last picture, and of all; `None` if it lacks none. See [`Request::most_points`].
    pub fn lights_shown(&self) -> Option<[usize; 2]> {
        let all = self.rig().lights.len();
        Some(self.cache.lacking()).filter(|lacking| *lacking > 0).map(|lacking| [all - lacking, all])
    }

    /// Whether a picture lacked no light since all images were invalid.
    pub fn was_whole(&self) -> bool {
        self.cache.was_whole()
    }

    /// Points of lights outside of the focus that the last picture shaded; see [`Request::most_points`].
    pub fn points_in_rest(&self) -> usize {
        self.cache.points_in_rest()
    }

    /// Whether there is a slot for every image, so that none is evicted and rendered again.
    pub fn has_slot_for_every_image(&self) -> bool {
        self.images.len() >= LightCache::slot_range(self.rig().lights.len()).1
    }

    /// Selects the lights that will be edited; see [`LightCache::select`].
    pub fn select(&mut self, lights: &[usize]) {
        self.cache.select(lights);
    }

    /// Whether the last picture lacks lights, or any image in it is coarse.
    pub fn is_coarse(&self) -> bool {
        self.cache.is_coarse()
    }

    /// Invalidates all images if the layers change, and coarse images if exact ones are requested.
    fn set_layers_and_detail(&mut self, layers: Layers, detail: Detail) {
        if self.layers != layers {
            let whole = [self.layers, layers].map(|layers| layers == Layers::All);
            self.layers = layers;
            self.cache.change_layers(self.emitters(), whole);
            self.match_changes();
        }
        self.cache.set_detail(detail);
    }

    /// Starts to count infinite and NaN values in scene-linear pictures, and in the results of passes of pictures that
    /// have any; see [`Self::non_finite`].
    pub fn check_finite(&mut self) -> Result<()> {
        self.finite_check = Some(FiniteCheck::new(&self.context)?);
        Ok(())
    }

    /// Number of infinite and NaN values per pass; empty unless [`Self::check_finite`] was called.
    pub fn non_finite(&self) -> Vec<(&'static str, u32)> {
        self.finite_check.as_ref().map_or_else(Vec::new, FiniteCheck::counts)
    }

    /// Histogram of the last picture's exposed luminance: pixel counts of `BINS_PER_STOP` bins per stop around middle
    /// grey, and of all darker (first bin) and brighter (last bin) pixels. `None` unless [`Request::inspection`]
    /// requested it.
    pub fn histogram(&self) -> Option<&[u32]> {
        self.inspector.as_ref()?.counts()
    }

    /// Pixel and its scene-linear radiance. `None` unless [`Request::inspection`] requested it.
    pub fn probed(&self) -> Option<([u32; 2], Vec3)> {
        self.inspector.as_ref()?.probed()
    }

    /// The picture for a display: width * height pixels of 8 bits a channel with alpha, row 0 at the top; sRGB but for
    /// [`ToneMap::View`]. Errors: the device is lost or out of memory.
    pub fn display(&mut self, request: impl Into<Request>) -> Result<&[[u8; 4]]> {
        let request = request.into();
        let output = Output::Display { exposure: request.exposure, tone_map: request.tone_map.clone() };
        self.run(&request, output.clone(), None)?;
        Ok(bytemuck::cast_slice(self.outputs.pixels(&output).host()))
    }

    /// Shows the same picture in a window. An unchanged picture is presented again without compositing.
    pub fn show(&mut self, request: impl Into<Request>, screen: Screen) -> Result<()> {
        let request = request.into();
        let (exposure, tone_map) = (request.exposure, request.tone_map.clone());
        let output = Output::Screen { exposure, tone_map, blue_first: screen.surface.wants_blue_first() };
        self.run(&request, output, Some(screen))
    }

    /// Shows the pixels of the last picture that was shown again, whatever has changed since. Panics if there was none.
    pub fn show_again(&mut self, screen: Screen) -> Result<()> {
        let [width, height] = [self.framebuffer.tiling.width, self.framebuffer.tiling.height];
        let pixels = Pixels { buffer: self.outputs.shown(), width, height };
        Self::show_pixels(&mut self.frames, &mut self.times, pixels, screen)
    }

    /// The picture in scene-linear Rec. 709 radiance: width * height pixels, row 0 at the top. Errors as of
    /// [`Self::display`].
    pub fn linear(&mut self, request: impl Into<Request>) -> Result<&[[f32; 3]]> {
        let request = request.into();
        self.run(&request, Output::Linear, None)?;
        if self.finite_check.as_mut().is_some_and(FiniteCheck::becomes_thorough) {
            self.invalidate_all();
            self.run(&request, Output::Linear, None)?;
        }
        Ok(bytemuck::cast_slice(self.outputs.pixels(&Output::Linear).host()))
    }

    /// Shows given pixels in a window.
    pub fn show_still(&mut self, pixels: Pixels, screen: Screen) -> Result<()> {
        Self::show_pixels(&mut self.frames, &mut self.times, pixels, screen)
    }

    fn show_pixels(frames: &mut Frames, times: &mut Vec<PassTime>, pixels: Pixels, mut screen: Screen) -> Result<()> {
        times.clear();
        let mut frame = frames.begin()?;
        frame.draw(&mut screen, Some(pixels))?;
        frame.finish_on(screen.surface)?;
        times.extend(frames.times());
        Ok(())
    }

    /// Recompiles compute kernels whose source changed, and then invalidates all images.
    #[cfg(feature = "hot-reload")]
    fn reload_changed_kernels(&mut self) {
        let Kernels { shade_light, resolve, sum_images } = &mut self.kernels;
        let changed = self.soft.as_mut().is_some_and(SoftLights::reload_changed_kernels)
            | shade_light.reload_if_changed()
            | resolve.reload_if_changed()
            | sum_images.reload_if_changed()
            | self.outputs.reload_changed_kernels();
        if changed {
            self.invalidate_all();
        }
    }
}

/// Whether any links scale the light of their light.
fn scales(links: &HashMap<usize, ResolvedLinks>) -> bool {
    !links.values().all(ResolvedLinks::light_evenly)
}

/// Links of the lights that have any; an error names the light.
fn resolved(rig: &Rig, scene: &TracedScene) -> Result<HashMap<usize, ResolvedLinks>> {
    rig.resolve_links(scene).map_err(|reason| Error::invalid("rig", reason))
}

fn sky_terms(context: &Arc<Context>, transfer: Option<&Transfer>) -> Result<Option<SkyTerms>> {
    transfer.and_then(|transfer| transfer.sky.as_ref()).map(|_| SkyTerms::new(context)).transpose()
}

/// Planes R, G, B for the radiance of extra samples.
fn extra_planes(context: &Arc<Context>, framebuffer: &DeepFramebuffer) -> Result<Buffer<f32>> {
    let stride = framebuffer.extra_samples.len().next_multiple_of(4);
    Buffer::new(context, "extra samples' radiance", Access::Device, 3 * stride)
}

/// Bytes of device memory in use.
fn held(context: &Context) -> u64 {
    context.memory_by_owner().iter().map(|(_, bytes)| bytes).sum()
}

/// Number of lights of a rig that are shaded in one batch.
fn batch_size(light_count: usize) -> usize {
    light_count.clamp(1, MAX_LIGHTS_PER_PASS as usize)
}
