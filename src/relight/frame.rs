//! A frame from start to end: visibility -> shading of changed lights -> sums of light images -> picture.

use std::time::Instant;

use super::indirect::sky_light::SkyTerms;
use super::light_cache::{LightPoints, POINTS_A_STEP, Plan, Step};
use super::light_sights::LightSights;
use super::output::inspect::{Inspection, Inspector};
use super::output::sheet::Grid;
use super::output::{Output, Outputs};
use super::passes::{FrameResources, Seeing};
use super::{Detail, Picture, Relighter, Request, visibility};
use crate::error::{Error, Result};
use crate::gpu::{Frame, PassTime, Pixels, Screen};

/// The picture that the last frame composites, and where it goes.
pub(super) struct FinalOutput<'a> {
    picture: Picture,
    inspection: Inspection,
    output: Output,
    screen: Option<Screen<'a>>,
}

impl FinalOutput<'_> {
    /// Scene-linear, for the host.
    pub fn linear(picture: Picture) -> Self {
        Self { picture, inspection: Inspection::default(), output: Output::Linear, screen: None }
    }
}

/// Points of one step fit into a frame.
const _: () = assert!((POINTS_A_STEP as usize) < visibility::BUFFERS);

/// Passes after the steps: composite, histogram, probe, fit, present, user interface.
const MAX_FINAL_PASSES: usize = 6;

impl Relighter {
    /// Renders a picture.
    pub(super) fn run(&mut self, request: &Request, output: Output, screen: Option<Screen>) -> Result<()> {
        #[cfg(feature = "hot-reload")]
        self.reload_changed_kernels();
        let Request { picture, inspection, .. } = *request;
        let is_sheet = picture == Picture::Sheet;
        self.outputs.prepare(&output, is_sheet)?;
        if inspection != Inspection::default() && self.inspector.is_none() {
            self.inspector = Some(Inspector::new(&self.context)?);
        }
        let mut plan = self.plan(request)?;
        if !is_sheet || self.shown.as_ref().is_none_or(|(shown, ..)| *shown != picture) {
            self.sheet.invalidate();
        }
        if is_sheet {
            self.sheet.remove_unchanged(&mut plan, &output);
        }
        plan.batch_shades();
        self.execute_or_invalidate(&plan, Some(FinalOutput { picture, inspection, output, screen }))
    }

    /// Renders images for a picture, but not the picture. Panics if that is [`Picture::Sheet`].
    pub fn advance(&mut self, request: impl Into<Request>) -> Result<()> {
        let mut plan = self.plan(&request.into())?;
        if plan.steps.is_empty() {
            self.times.clear();
            return Ok(()); // what was shown is up to date
        }
        plan.batch_shades();
        self.execute_or_invalidate(&plan, None)
    }

    fn plan(&mut self, request: &Request) -> Result<Plan> {
        let Request { picture, layers, detail, .. } = *request;
        self.set_layers_and_detail(layers, detail);
        if detail == Detail::Exact {
            self.decide_points(picture)?;
        }
        Ok(match picture {
            Picture::Whole => self.cache.plan(request.most_points),
            Picture::Light(light) => self.cache.plan_light(light),
            Picture::Emission => self.cache.plan_emitters(),
            Picture::Sheet => {
                let [width, height] = [self.framebuffer.tiling.width, self.framebuffer.tiling.height];
                self.cache.plan_sheet(Grid::new(self.rig().lights.len(), [width, height]).len())
            }
        })
    }

    /// Renders images of area lights until it is known how many points each needs.
    fn decide_points(&mut self, picture: Picture) -> Result<()> {
        loop {
            let light = match picture {
                Picture::Light(light) => self.cache.is_undecided(light).then_some(light),
                Picture::Emission => None,
                Picture::Whole | Picture::Sheet => self.cache.undecided(),
            };
            let Some(light) = light else { return Ok(()) };
            let plan = self.cache.plan_part(light, u32::MAX);
            self.execute_or_invalidate(&plan, None)?;
            if let Some(progress) = &self.progress {
                let all = self.rig().lights.len();
                progress(all - self.cache.pending().0, all);
            }
        }
    }

    /// Renders images, and the picture if `last` is given. An error invalidates all images.
    pub(super) fn execute_or_invalidate(&mut self, plan: &Plan, last: Option<FinalOutput>) -> Result<()> {
        let outcome = self.execute(plan, last);
        if outcome.is_err() {
            self.invalidate_all();
        }
        outcome
    }

    /// Records one frame, or several if the steps do not fit into one.
    pub(super) fn execute(&mut self, plan: &Plan, mut last: Option<FinalOutput>) -> Result<()> {
        self.times.clear();
        let shown = last.as_ref().map(|last| (last.picture, last.output.clone(), plan.picture.clone()));
        let unchanged = plan.steps.is_empty() && shown.is_some() && self.shown == shown;
        if let Some(inspector) = self.inspector.as_mut().filter(|_| !unchanged) {
            inspector.invalidate();
        }
        let is_observed = |last: &FinalOutput| last.screen.is_some() || last.inspection != Inspection::default();
        if unchanged && !last.as_ref().is_some_and(is_observed) {
            return Ok(()); // the pixels are up to date
        }
        self.shown = None;
        let began = Instant::now();
        let Self { frames, times, visibility, shadow_maps, sights, soft, sky_terms, outputs, inspector, .. } = self;
        let resources = FrameResources {
            scene: &self.scene,
            framebuffer: &self.framebuffer,
            transfer: self.transfer.as_deref(),
            gpu: &self.gpu,
            indirect: self.indirect.as_ref().filter(|_| self.layers.indirect()),
            images: self.images.as_slice(),
            some_points: self.some_points.as_ref(),
            changes: &self.changes,
            rest: &self.rest,
            extras: &self.extras,
            kernels: &self.kernels,
            rig: self.cache.rig(),
            links: &self.links,
            skies: &self.skies,
            triangles: self.triangles.as_ref(),
            layers: self.layers,
            finite_check: self.finite_check.as_ref(),
            site: self.site,
        };
        let mut steps = &plan.steps[..];
        loop {
            visibility.restart();
            sights.iter_mut().for_each(LightSights::restart);
            sky_terms.iter_mut().for_each(SkyTerms::restart);
            let begin_ms = began.elapsed().as_secs_f64() * 1e3;
            let mut frame = frames.begin()?;
            let output = last.as_ref().map(|last| last.output.clone());
            let mut seeing = Seeing {
                visibility,
                shadow_maps: shadow_maps.as_mut(),
                sights: sights.as_mut(),
                soft: soft.as_mut(),
                sky_terms: sky_terms.as_mut(),
            };
            let left = resources.record_steps(&mut frame, steps, &mut seeing, outputs, output.as_ref())?;
            if !left.is_empty() && left.len() == steps.len() {
                let reason = "it has no room for one light of such a picture: choose a smaller --size";
                return Err(Error::invalid("the device", reason));
            }
            steps = left;
            let is_done = steps.is_empty();
            let mut surface = None;
            if let Some(FinalOutput { picture, inspection, output, screen }) = last.as_mut().filter(|_| is_done) {
                let is_sheet = *picture == Picture::Sheet;
                if !unchanged && !is_sheet {
                    resources.composite(&mut frame, &plan.picture, outputs, output);
                }
                if let Some(inspector) = inspector.as_mut().filter(|_| !is_sheet) {
                    inspector.run(&mut frame, &resources, &plan.picture, *inspection, output.exposure());
                }
                if let Some(screen) = screen {
                    let [width, height] = [self.framebuffer.tiling.width, self.framebuffer.tiling.height];
                    frame.draw(screen, Some(Pixels { buffer: outputs.pixels(output), width, height }))?;
                    surface = Some(&mut *screen.surface);
                }
            }
            match surface {
                Some(surface) => frame.finish_on(surface)?,
                None => frame.finish()?,
            }
            times.extend(frames.times().iter().map(|time| PassTime { start_ms: begin_ms + time.start_ms, ..*time }));
            if let Some(progress) = &self.progress
                && last.is_some()
            {
                let left = steps.iter().filter(|step| step.as_shade().is_some()).count();
                let all = self.cache.rig().lights.len();
                progress(all.saturating_sub(left), all);
            }
            if is_done {
                self.shown = shown;
                if let (Some(light), Some(some_points)) = (plan.compared_light(), &self.some_points) {
                    self.cache.set_change(light, some_points.change());
                }
                return Ok(());
            }
        }
    }
}

impl FrameResources<'_> {
    /// Records as many of `steps` as fit into the frame and returns the others. `output` is the target of contact
    /// sheets.
    fn record_steps<'p>(
        &self,
        frame: &mut Frame,
        mut steps: &'p [Step],
        seeing: &mut Seeing,
        outputs: &Outputs,
        output: Option<&Output>,
    ) -> Result<&'p [Step]> {
        while let Some(step) = steps.first() {
            let room = frame.passes_left().saturating_sub(MAX_FINAL_PASSES) / self.max_passes_per_step();
            let taken = match step {
                _ if room == 0 => break,
                Step::Shade(shade) if shade.points != LightPoints::One => {
                    if shade.points.count() > room.min(seeing.visibility.left()) || !seeing.has_room() {
                        break;
                    }
                    self.shade(frame, seeing, std::slice::from_ref(shade))?;
                    1
                }
                Step::Shade(_) => {
                    let at_once = self.indirect.map_or(usize::MAX, |indirect| indirect.lights_at_once);
                    let most = room.min(seeing.visibility.left()).min(self.extras.len()).min(at_once);
                    let shades =
                        steps.iter().map_while(Step::as_shade).take_while(|shade| shade.points == LightPoints::One);
                    let shades: Vec<_> = shades.take(most).copied().collect();
                    if shades.is_empty() {
                        break;
                    }
                    self.shade(frame, seeing, &shades)?;
                    shades.len()
                }
                Step::Sum { target, terms, kept } => {
                    self.sum(frame, *target, terms, *kept)?;
                    1
                }
                Step::Compare { image, .. } => {
                    self.compare(frame, *image);
                    1
                }
                Step::Show { cell, term } => {
                    self.show(frame, *cell, *term, outputs, output.expect("sheets are shown"));
                    1
                }
            };
            steps = &steps[taken..];
        }
        Ok(steps)
    }
}
