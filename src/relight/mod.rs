//! The whole frame, top to bottom: visibility -> shading of what moved -> sums of light images -> picture.

mod cutouts;
pub mod exposure;
mod finite_check;
mod gpu_baked;
mod haar;
mod indirect;
pub mod inspect;
pub mod light_cache;
mod light_rays;
mod output;
mod passes;
pub mod roofline;
mod shadow_map;
pub mod sheet;
mod sparse;
mod visibility;

use std::sync::Arc;
use std::time::Instant;

use glam::{Vec3, Vec4};

use self::finite_check::FiniteCheck;
use self::gpu_baked::{GpuBaked, upload_emission};
use self::indirect::Indirect;
use self::inspect::{Inspection, Inspector};
pub use self::light_cache::Detail;
use self::light_cache::{LightCache, Plan, Source, Step, Term};
use self::output::{Output, Outputs};
use self::passes::FrameResources;
use self::shadow_map::ShadowMaps;
use self::sheet::{Grid, Sheet};
use self::visibility::VisibilityBuffers;
pub use self::visibility::VisibilityMethod;
use crate::bake::Baked;
use crate::bake::transfer::baked::BakedTransfer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frames, Kernel, PassTime, Pixels, Screen};
use crate::scene::{Rig, Scene};
use crate::shared::{LIGHTS_A_PASS, ResolvePush, ShadeLightConstants, ShadeLightPush, SumImagesPush};
use crate::trace::bvh::Bvh;

/// How pictures leave the relighter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToneMap {
    /// Clamped.
    None,
    Agx,
    PbrNeutral,
    /// [`STOP_COLORS`] by luminance: a colour a stop, middle grey at 2^exposure stops being grey.
    FalseColor,
}

/// Which part of the picture is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layers {
    /// Straight and through mirrors.
    All,
    /// Layer 1 of the deep framebuffer.
    Direct,
    /// The mirror layers.
    Reflection,
    /// All but what came through the gather samples.
    FirstHand,
    /// What came through the gather samples.
    Indirect,
}

impl Layers {
    /// Layers of the deep framebuffer that count.
    fn mask(self) -> u32 {
        match self {
            Self::All | Self::FirstHand | Self::Indirect => u32::MAX,
            Self::Direct => 1,
            Self::Reflection => !1,
        }
    }

    fn direct(self) -> bool {
        self != Self::Indirect
    }

    fn indirect(self) -> bool {
        matches!(self, Self::All | Self::Indirect)
    }
}

/// What a picture shows of the chosen layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Picture {
    Whole,
    /// One light's share, by its index in the rig.
    Light(usize),
    /// Emitters as seen.
    Emission,
    /// Every light's share, side by side as in a [`Grid`].
    Sheet,
}

#[derive(Clone, Debug)]
pub struct RelightSettings {
    pub visibility: VisibilityMethod,
    /// Side of a shadow map in texels.
    pub shadow_size: u32,
    pub tone_map: ToneMap,
    /// Device memory for light images; `None` takes three quarters of what the device has.
    pub budget_bytes: Option<u64>,
}

impl Default for RelightSettings {
    fn default() -> Self {
        Self { visibility: VisibilityMethod::Auto, shadow_size: 1024, tone_map: ToneMap::Agx, budget_bytes: None }
    }
}

/// Keeps a picture up to date with its lights.
pub struct Relighter {
    context: Arc<Context>,
    frames: Frames,
    scene: Arc<Scene>,
    bvh: Arc<Bvh>,
    baked: Arc<Baked>,
    gpu: GpuBaked,
    indirect: Option<Indirect>,
    cache: LightCache,
    images: Vec<Buffer<Vec4>>,
    /// Light images that the budget has room for.
    image_budget: usize,
    /// Bytes of device memory that factors of indirect light may take.
    transfer_budget: u64,
    rest: Buffer<Vec4>,
    /// Planes of the extra samples' radiance, of each light that is shaded together with others.
    extras: Vec<Buffer<f32>>,
    visibility: VisibilityBuffers,
    shadow_maps: Option<ShadowMaps>,
    kernels: Kernels,
    outputs: Outputs,
    tone_map: ToneMap,
    layers: Layers,
    finite_check: Option<FiniteCheck>,
    inspector: Option<Inspector>,
    sheet: Sheet,
    /// What the last frame showed, and how.
    shown: Option<(Picture, Output, Vec<Term>)>,
    /// Times of the frames that the last call took.
    times: Vec<PassTime>,
}

/// How making images ends.
struct Last<'a> {
    picture: Picture,
    output: Output,
    screen: Option<Screen<'a>>,
}

struct Kernels {
    shade_light: Kernel<ShadeLightPush>,
    resolve: Kernel<ResolvePush>,
    sum_images: Kernel<SumImagesPush>,
}

impl Relighter {
    pub fn new(
        context: &Arc<Context>,
        scene: &Arc<Scene>,
        bvh: &Arc<Bvh>,
        baked: &Arc<Baked>,
        rig: &Rig,
        settings: &RelightSettings,
    ) -> Result<Self> {
        let pixel_stride = baked.pixel_stride();
        let image_bytes = 12 * pixel_stride as u64;
        let fewest = slot_count(rig, 0);
        // Another relighter may have its share already.
        let held: u64 = context.memory_by_owner().iter().map(|(_, bytes)| bytes).sum();
        let budget = settings.budget_bytes.unwrap_or(context.info.memory_bytes / 4 * 3).saturating_sub(held);
        let transfer_budget = budget.saturating_sub(fewest as u64 * image_bytes);
        let indirect = baked.transfer.as_ref().map(|t| Indirect::new(context, t, transfer_budget)).transpose()?;
        let taken = indirect.as_ref().map_or(0, |indirect| indirect.device_bytes);
        let image_budget = ((budget - taken.min(budget)) / image_bytes) as usize;
        let slot_count = slot_count(rig, image_budget);
        if image_budget < slot_count {
            tracing::warn!(
                "the budget holds {image_budget} light images; {slot_count}, the fewest that work, are taken"
            );
        }
        let image = |name: &str| Buffer::new(context, name, Access::Device, 3 * pixel_stride / 4);
        let traced = settings.visibility.traces(context, bvh);
        let gpu = GpuBaked::new(context, baked)?;
        Ok(Self {
            frames: Frames::new(context)?,
            cache: LightCache::new(rig, slot_count, gpu.emission.is_some()),
            gpu,
            indirect,
            images: (0..slot_count).map(|_| image("light images")).collect::<Result<_>>()?,
            image_budget,
            transfer_budget,
            rest: image("light images (rest)")?,
            extras: (0..together(rig)).map(|_| extra_planes(context, baked)).collect::<Result<_>>()?,
            visibility: VisibilityBuffers::new(context, baked, traced)?,
            shadow_maps: if traced { None } else { Some(ShadowMaps::new(context, scene, bvh, settings.shadow_size)?) },
            kernels: Kernels {
                shade_light: Kernel::new(context, ShadeLightConstants { specular: baked.has_specular })?,
                resolve: Kernel::new(context, ())?,
                sum_images: Kernel::new(context, ())?,
            },
            outputs: Outputs::new(context, baked.tiling.width as usize * baked.tiling.height as usize),
            tone_map: settings.tone_map,
            layers: Layers::All,
            finite_check: None,
            inspector: None,
            sheet: Sheet::default(),
            shown: None,
            times: Vec::new(),
            context: context.clone(),
            scene: scene.clone(),
            bvh: bvh.clone(),
            baked: baked.clone(),
        })
    }

    pub fn rig(&self) -> &Rig {
        self.cache.rig()
    }

    pub fn baked(&self) -> &Arc<Baked> {
        &self.baked
    }

    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// What each pass of the last picture took.
    pub fn times(&self) -> &[PassTime] {
        &self.times
    }

    /// Whether shadow rays are traced on the CPU, else shadow maps are drawn.
    pub fn traces(&self) -> bool {
        self.shadow_maps.is_none()
    }

    /// Takes over a new state of the lights; the next picture shows it. More lights may take more memory.
    pub fn set_rig(&mut self, rig: &Rig) -> Result<()> {
        for _ in self.images.len()..slot_count(rig, self.image_budget) {
            let elements = 3 * self.baked.pixel_stride() / 4;
            self.images.push(Buffer::new(&self.context, "light images", Access::Device, elements)?);
        }
        for _ in self.extras.len()..together(rig) {
            self.extras.push(extra_planes(&self.context, &self.baked)?);
        }
        self.cache.set_rig(rig, self.images.len());
        Ok(())
    }

    /// Takes over another transfer to the same view samples; the next picture shows it.
    pub fn set_transfer(&mut self, transfer: BakedTransfer) -> Result<()> {
        self.indirect = None; // its memory first
        self.indirect = Some(Indirect::new(&self.context, &transfer, self.transfer_budget)?);
        let baked = Arc::new(Baked { transfer: Some(transfer), ..Baked::clone(&self.baked) });
        self.visibility = VisibilityBuffers::new(&self.context, &baked, self.traces())?;
        self.gpu.emission = upload_emission(&self.context, &baked)?;
        self.baked = baked;
        self.start_anew();
        Ok(())
    }

    /// Takes over another bake of the same view of the same scene; the next picture shows it.
    pub fn set_baked(&mut self, baked: Arc<Baked>) -> Result<()> {
        let size = |baked: &Baked| (baked.tiling.width, baked.tiling.height);
        assert_eq!(size(&baked), size(&self.baked), "light images have the size of the first bake");
        if baked.has_specular != self.baked.has_specular {
            let constants = ShadeLightConstants { specular: baked.has_specular };
            self.kernels.shade_light = Kernel::new(&self.context, constants)?;
        }
        let transfer = baked.transfer.as_ref();
        self.indirect = None; // its memory first
        self.indirect = transfer.map(|t| Indirect::new(&self.context, t, self.transfer_budget)).transpose()?;
        self.visibility = VisibilityBuffers::new(&self.context, &baked, self.traces())?;
        self.gpu = GpuBaked::new(&self.context, &baked)?;
        for extras in &mut self.extras {
            *extras = extra_planes(&self.context, &baked)?;
        }
        self.baked = baked;
        self.start_anew();
        Ok(())
    }

    /// No image is up to date any more.
    fn start_anew(&mut self) {
        self.cache.invalidate(self.layers == Layers::All && self.gpu.emission.is_some());
        self.shown = None;
        self.sheet.forget();
    }

    /// Lights of which a whole picture has yet to make images.
    pub fn pending(&self) -> usize {
        self.cache.pending().0
    }

    /// Makes the image of one light that is [pending](Self::pending), so that a whole picture has less to do.
    pub fn prepare(&mut self) -> Result<()> {
        let Some(light) = self.cache.pending().1 else { return Ok(()) };
        let plan = self.cache.plan_light(light);
        self.run_or_start_anew(&plan, None)
    }

    /// Whether every image has its place, so that none is made twice.
    pub fn keeps_all(&self) -> bool {
        self.images.len() >= LightCache::slot_range(self.rig().lights.len()).1
    }

    /// Makes `lights` those that are about to be edited; see [`LightCache::select`].
    pub fn select(&mut self, lights: &[usize]) {
        self.cache.select(lights);
    }

    /// How closely stale images are made from now on. Exact: those that were made coarsely are stale.
    pub fn set_detail(&mut self, detail: Detail) {
        self.cache.set_detail(detail);
    }

    /// Whether an image that was made coarsely is part of any sum.
    pub fn is_coarse(&self) -> bool {
        self.cache.is_coarse()
    }

    /// Chooses the part of the picture that is made from now on; emitters belong to the whole.
    pub fn set_layers(&mut self, layers: Layers) {
        if self.layers != layers {
            self.layers = layers;
            self.cache.invalidate(layers == Layers::All && self.gpu.emission.is_some());
        }
    }

    /// From now on counts the values that passes leave infinite or not a number; see [`Self::non_finite`].
    pub fn check_finite(&mut self) -> Result<()> {
        self.finite_check = Some(FiniteCheck::new(&self.context)?);
        Ok(())
    }

    /// By pass, how many values were infinite or not a number; of none where nobody watches.
    pub fn non_finite(&self) -> Vec<(&'static str, u32)> {
        self.finite_check.as_ref().map_or_else(Vec::new, FiniteCheck::counts)
    }

    /// From now on looks into every picture but contact sheets for what is asked for.
    pub fn inspect(&mut self, wanted: Inspection) -> Result<()> {
        if wanted != Inspection::default() && self.inspector.is_none() {
            self.inspector = Some(Inspector::new(&self.context)?);
        }
        if let Some(inspector) = &mut self.inspector {
            inspector.wanted = wanted;
        }
        Ok(())
    }

    /// How many pixels of the last picture have which luminance, exposed: [`BINS_A_STOP`] bins a stop around middle grey,
    /// and those below and above all of them; of none where nobody asked.
    pub fn histogram(&self) -> Option<&[u32]> {
        self.inspector.as_ref()?.counts()
    }

    /// Pixel and scene-linear radiance where [`Self::inspect`] asked for it.
    pub fn probed(&self) -> Option<([u32; 2], Vec3)> {
        self.inspector.as_ref()?.probed()
    }

    /// Chooses the curve from scene-linear to display from now on.
    pub fn set_tone_map(&mut self, tone_map: ToneMap) {
        self.tone_map = tone_map;
    }

    /// The picture for a display: 8-bit sRGB with alpha, row by row, at 2^`exposure` stops.
    pub fn display(&mut self, picture: Picture, exposure: f32) -> Result<&[[u8; 4]]> {
        let output = Output::Display { exposure, tone_map: self.tone_map };
        self.run(picture, output, None)?;
        Ok(bytemuck::cast_slice(self.outputs.pixels(output).host()))
    }

    /// The same picture in a window; an unchanged one is drawn again.
    pub fn show(&mut self, picture: Picture, exposure: f32, screen: Screen) -> Result<()> {
        let blue_first = screen.surface.wants_blue_first();
        self.run(picture, Output::Screen { exposure, tone_map: self.tone_map, blue_first }, Some(screen))
    }

    /// The picture in scene-linear Rec. 709 radiance, row by row.
    pub fn linear(&mut self, picture: Picture) -> Result<&[[f32; 3]]> {
        self.run(picture, Output::Linear, None)?;
        Ok(bytemuck::cast_slice(self.outputs.pixels(Output::Linear).host()))
    }

    /// Pixels that no light changes, in a window.
    pub fn show_still(&mut self, pixels: Pixels, mut screen: Screen) -> Result<()> {
        self.times.clear();
        let mut frame = self.frames.begin()?;
        frame.draw(&mut screen, Some(pixels))?;
        frame.finish_on(screen.surface)?;
        self.times.extend(self.frames.times());
        Ok(())
    }

    fn plan(&mut self, picture: Picture) -> Plan {
        #[cfg(feature = "hot-reload")]
        if self.reload_changed_kernels() {
            self.start_anew();
        }
        match picture {
            Picture::Whole => self.cache.plan(),
            Picture::Light(light) => self.cache.plan_light(light),
            Picture::Emission => {
                let emission = Term { source: Source::Emission, scale: Vec3::ONE };
                Plan { steps: Vec::new(), picture: self.gpu.emission.iter().map(|_| emission).collect() }
            }
            Picture::Sheet => {
                let [width, height] = [self.baked.tiling.width, self.baked.tiling.height];
                self.cache.plan_sheet(Grid::new(self.rig().lights.len(), [width, height]).len())
            }
        }
    }

    /// Makes the picture.
    fn run(&mut self, picture: Picture, output: Output, screen: Option<Screen>) -> Result<()> {
        let is_sheet = picture == Picture::Sheet;
        self.outputs.prepare(output, is_sheet)?;
        let mut plan = self.plan(picture);
        if !is_sheet || self.shown.as_ref().is_none_or(|(shown, ..)| *shown != picture) {
            self.sheet.forget();
        }
        if is_sheet {
            self.sheet.thin(&mut plan, output);
        }
        plan.bring_shades_together();
        self.run_or_start_anew(&plan, Some(Last { picture, output, screen }))
    }

    /// After an error no image counts as made.
    fn run_or_start_anew(&mut self, plan: &Plan, last: Option<Last>) -> Result<()> {
        let outcome = self.run_frames(plan, last);
        if outcome.is_err() {
            self.start_anew();
        }
        outcome
    }

    /// One frame, or several if many lights are stale at once. Without an end, images alone are made.
    fn run_frames(&mut self, plan: &Plan, mut last: Option<Last>) -> Result<()> {
        self.times.clear();
        let shown = last.as_ref().map(|last| (last.picture, last.output, plan.picture.clone()));
        let unchanged = plan.steps.is_empty() && shown.is_some() && self.shown == shown;
        let mut inspector = self.inspector.as_mut();
        if let Some(inspector) = inspector.as_mut().filter(|_| !unchanged) {
            inspector.forget();
        }
        let looks = inspector.as_ref().is_some_and(|inspector| inspector.wanted != Inspection::default());
        if unchanged && !looks && last.as_ref().is_none_or(|last| last.screen.is_none()) {
            return Ok(()); // it is there already
        }
        self.shown = None;
        let began = Instant::now();
        let Self { frames, times, visibility, outputs, .. } = self;
        let parts = FrameResources {
            scene: &self.scene,
            bvh: &self.bvh,
            baked: &self.baked,
            gpu: &self.gpu,
            indirect: self.indirect.as_ref().filter(|_| self.layers.indirect()),
            images: &self.images,
            rest: &self.rest,
            extras: &self.extras,
            kernels: &self.kernels,
            rig: self.cache.rig(),
            layers: self.layers,
            finite_check: self.finite_check.as_ref(),
        };
        let mut steps = &plan.steps[..];
        loop {
            visibility.restart();
            let begin_ms = began.elapsed().as_secs_f64() * 1e3;
            let mut frame = frames.begin()?;
            while let Some(step) = steps.first() {
                let room = frame.passes_left().saturating_sub(LAST_PASSES) / parts.passes_a_step();
                let taken = match step {
                    _ if room == 0 => break,
                    Step::Shade(_) => {
                        let most = room.min(visibility.left()).min(self.extras.len());
                        let shades = steps.iter().map_while(Step::as_shade).take(most).copied().collect::<Vec<_>>();
                        if shades.is_empty() {
                            break;
                        }
                        parts.shade(&mut frame, visibility, self.shadow_maps.as_mut(), &shades);
                        shades.len()
                    }
                    Step::Sum { target, terms, accumulate } => {
                        parts.sum(&mut frame, *target, terms, *accumulate);
                        1
                    }
                    Step::Show { cell, term } => {
                        let output = last.as_ref().expect("sheets are shown").output;
                        parts.show(&mut frame, *cell, *term, outputs, output);
                        1
                    }
                };
                steps = &steps[taken..];
            }
            let done = steps.is_empty();
            match last.as_mut().filter(|_| done) {
                Some(Last { picture, output, screen }) => {
                    let is_sheet = *picture == Picture::Sheet;
                    if !unchanged && !is_sheet {
                        parts.composite(&mut frame, &plan.picture, outputs, *output);
                    }
                    if let Some(inspector) = inspector.as_mut().filter(|_| !is_sheet) {
                        inspector.run(&mut frame, &parts, &plan.picture, output.exposure());
                    }
                    match screen {
                        Some(screen) => {
                            let [width, height] = [self.baked.tiling.width, self.baked.tiling.height];
                            frame.draw(screen, Some(Pixels { buffer: outputs.pixels(*output), width, height }))?;
                            frame.finish_on(screen.surface)?;
                        }
                        None => frame.finish()?,
                    }
                }
                None => frame.finish()?,
            }
            times.extend(frames.times().iter().map(|time| PassTime { start_ms: begin_ms + time.start_ms, ..*time }));
            if done {
                self.shown = shown;
                return Ok(());
            }
        }
    }

    /// Compute kernels of the frame whose source changed are compiled anew, and the picture with them.
    #[cfg(feature = "hot-reload")]
    fn reload_changed_kernels(&mut self) -> bool {
        let Kernels { shade_light, resolve, sum_images } = &mut self.kernels;
        shade_light.reload_if_changed()
            | resolve.reload_if_changed()
            | sum_images.reload_if_changed()
            | self.outputs.reload_changed_kernels()
    }
}

/// Planes R, G, B for the radiance of extra samples.
fn extra_planes(context: &Arc<Context>, baked: &Baked) -> Result<Buffer<f32>> {
    let stride = baked.extra_samples.len().next_multiple_of(4);
    Buffer::new(context, "extra samples' radiance", Access::Device, 3 * stride)
}

/// How many lights of a rig are shaded together.
fn together(rig: &Rig) -> usize {
    rig.lights.len().clamp(1, LIGHTS_A_PASS as usize)
}

/// How many light images are kept for a rig, where the budget has room for so many.
fn slot_count(rig: &Rig, image_budget: usize) -> usize {
    let (fewest, most) = LightCache::slot_range(rig.lights.len());
    image_budget.clamp(fewest, most.min(MAX_IMAGES.max(fewest)))
}

/// Past this rigs do not keep everything, however much room there is: of 100,000 lights the images of small pictures alone
/// would be gigabytes, and nobody edits so many at once.
const MAX_IMAGES: usize = 4_096;

/// Composite, histogram, probe, fit, present, user interface.
const LAST_PASSES: usize = 6;
