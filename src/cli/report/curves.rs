//! Error against run time: path tracing, the thesis's method and ours, each with more and more work.

use std::sync::Arc;
use std::time::Instant;

use relume::bake::transport::directions::Lobe;
use relume::gpu::Processor;
use relume::image::{Image, exr};
use relume::relight::{Layers, Picture, Relighter, VisibilityMethod};
use relume::report::{Method, Point, Seconds, Skipped};
use relume::session::{BakeReport, Opened, build_bvh, cpu_seconds};
use relume::{Error, Result};
use serde::{Deserialize, Serialize};

use super::lab::{Lab, ours, picture_file};
use super::truth::{Truth, picture, trace};
use crate::cli::bench::load_average;
use crate::cli::bench_rig::nudge;
use crate::cli::output_file::make_parent;
use crate::cli::percentile::median;
use crate::cli::progress::Terminal;
use crate::cli::transfer::{Basis, FormName, Gi, MethodName, TransferOptions};

/// Singular values of the thesis's glossy method: more do not fit most machines, since every pair of samples has an
/// entry.
const THESIS_TERMS: usize = 4;
/// With 2,304 each bake of cornell-glossy took 2.8 times as long, and five scenes near three hours.
const USUAL_GATHER: u32 = 1024;
/// Surfaces smoother than this, and not mirrors, are glossy.
const ROUGH: f32 = 0.6;

/// Work on a clock.
pub struct Clock(Instant, f64);

impl Clock {
    pub fn start() -> Self {
        Self(Instant::now(), cpu_seconds())
    }

    pub fn seconds(&self) -> Seconds {
        Seconds { cpu: cpu_seconds() - self.1, wall: self.0.elapsed().as_secs_f64() }
    }
}

/// What a picture took, and what of it is no picture.
struct Made {
    image: Image,
    precompute: Seconds,
    frame: Seconds,
    bytes: u64,
    multiply_adds: u64,
    held_out: Option<f64>,
    spectral_radius: Option<f64>,
}

/// Of a setting.
#[derive(Serialize, Deserialize)]
enum Outcome {
    Is(Point),
    Skipped(Skipped),
}

impl Lab<'_> {
    /// All curves.
    pub fn curves(&mut self, truth: &Truth) -> Result<()> {
        let extent = self.extent;
        let [thesis, gather] = [extent.thesis, extent.gather].map(|all| self.up_to_pixels(all));
        for &samples in extent.samples {
            self.path_tracing(truth, samples)?;
        }
        for &gather in thesis {
            self.transfer(truth, Method::ThesisDiffuse, &thesis_diffuse(gather))?;
        }
        if self.is_glossy() {
            for &gather in thesis {
                self.transfer(truth, Method::ThesisGlossy, &thesis_glossy(gather))?;
            }
        }
        for &gather in gather {
            self.transfer(truth, Method::GatherSamples, &ours(Some(gather), 1024, 0.01, FormName::Auto))?;
        }
        let usual = Some(self.usual_gather_samples());
        for &rays in extent.rays {
            self.transfer(truth, Method::Rays, &ours(usual, rays, 0.01, FormName::Auto))?;
        }
        for &error in extent.errors {
            self.transfer(truth, Method::Compressed, &ours(usual, 1024, error, FormName::Auto))?;
        }
        for &error in extent.wavelets {
            self.transfer(truth, Method::Haar, &ours(usual, 1024, error, FormName::Haar))?;
        }
        Ok(())
    }

    /// Numbers of gather samples up to that of pixels, and the first one whatever that is: more are a waste.
    fn up_to_pixels(&self, all: &'static [u32]) -> &'static [u32] {
        let (width, height) = self.session.size();
        let fitting = all.iter().take_while(|count| **count as usize <= width * height).count();
        &all[..fitting.max(1)]
    }

    /// Whether any material is neither matt nor a mirror.
    pub fn is_glossy(&self) -> bool {
        self.session.scene.materials.iter().any(|m| m.roughness > 0.0 && m.roughness < ROUGH)
    }

    /// Gather samples of our curves over anything else: one of those on their own curve.
    pub fn usual_gather_samples(&self) -> u32 {
        let (width, height) = self.session.size();
        USUAL_GATHER.min((width * height) as u32)
    }

    fn path_tracing(&mut self, truth: &Truth, samples: u32) -> Result<()> {
        let setting = format!("--spp {samples}");
        self.point(truth, Method::PathTracing, &setting, &setting, |lab| {
            let clock = Clock::start();
            let opened = Opened::new(lab.path, lab.rig_path, &lab.view.settings(), &Terminal::default())?;
            build_bvh(opened.scene, &Terminal::default());
            let precompute = clock.seconds();
            let clock = Clock::start();
            let film = trace(&lab.session, &lab.view, samples, lab.view.seed);
            let frame = clock.seconds();
            let image = picture(&film);
            let (held_out, spectral_radius) = (None, None);
            Ok(Made { image, precompute, frame, bytes: 0, multiply_adds: 0, held_out, spectral_radius })
        })
    }

    /// Adds a point of a transfer's curve.
    pub fn transfer(&mut self, truth: &Truth, method: Method, options: &TransferOptions) -> Result<()> {
        let size = self.session.size();
        let indirect = options.settings()?.expect("indirect light is not off");
        let plan = indirect.plan([size.0 as u32, size.1 as u32], self.view.layers, self.view.seed);
        let what = format!("{plan:?} budget {:?}", self.relight.budget_bytes);
        self.point(truth, method, &setting(options), &what, |lab| {
            let session = &lab.session;
            let clock = Clock::start();
            let mut report = BakeReport::default();
            let progress = Terminal::default();
            let transfer = plan.bake(session.seen(), Lobe::All, session.rig.has_domes(), &mut report, &progress)?;
            let (bytes, multiply_adds) = transfer.cost();
            let held_out = transfer.report.held_out.as_ref().map(|r| r.point);
            let spectral_radius = Some(transfer.report.spectral_radius);
            let transfer = Some(Arc::new(transfer));
            let settings = lab.relight_with(VisibilityMethod::Traced);
            let mut relighter = Relighter::new(
                &lab.context,
                &session.scene,
                &session.framebuffer,
                transfer.as_ref(),
                &session.rig,
                &settings,
            )?;
            let bake = clock.seconds();
            let image = whole_and_indirect(&mut relighter, session.size())?;
            let frame = lab.frame(&mut relighter)?;
            let precompute =
                Seconds { cpu: bake.cpu + session.bake.cpu_seconds, wall: bake.wall + session.bake.seconds };
            Ok(Made { image, precompute, frame, bytes: bytes as u64, multiply_adds, held_out, spectral_radius })
        })
    }

    /// Adds a point, measured unless it was before. `what` tells it from others whose curve it may be on too.
    fn point(
        &mut self,
        truth: &Truth,
        method: Method,
        setting: &str,
        what: &str,
        make: impl FnOnce(&Self) -> Result<Made>,
    ) -> Result<()> {
        let what = format!("point {} truth {} {what}", self.identity, self.extent.truth);
        let there = |kept: &Outcome| !matches!(kept, Outcome::Is(point) if !self.dir.join(&point.file).exists());
        let outcome = match self.kept.get::<Outcome>(&what).filter(there) {
            Some(kept) => kept,
            None => {
                tracing::info!("{}: {}, {setting}", self.session.scene.name(), method.name());
                let outcome = self.outcome(truth, method, setting, make)?;
                self.kept.keep(&what, &outcome)?;
                outcome
            }
        };
        match outcome {
            Outcome::Is(point) => self.points.push(Point { method, ..point }),
            Outcome::Skipped(skipped) => self.skipped.push(skipped),
        }
        Ok(())
    }

    /// What does not fit this machine is told.
    fn outcome(
        &self,
        truth: &Truth,
        method: Method,
        setting: &str,
        make: impl FnOnce(&Self) -> Result<Made>,
    ) -> Result<Outcome> {
        let skipped = |why: String| Ok(Outcome::Skipped(Skipped { what: format!("`{setting}`"), why }));
        let made = match make(self) {
            Err(Error::Invalid { what: _, reason }) => return skipped(reason),
            made => made?,
        };
        let Some(errors) = truth.errors(&made.image) else { return skipped("no pixel of it is a number".into()) };
        let file = picture_file(&self.folder, setting);
        make_parent(&self.dir.join(&file))?;
        exr::write(&self.dir.join(&file), &made.image)?;
        Ok(Outcome::Is(Point {
            method,
            setting: setting.into(),
            precompute: made.precompute,
            frame: made.frame,
            bytes: made.bytes,
            multiply_adds: made.multiply_adds,
            held_out: made.held_out,
            spectral_radius: made.spectral_radius,
            load: load_average(),
            errors,
            file: file.to_string_lossy().into_owned(),
        }))
    }

    /// A picture after the first light has moved: mean CPU time, with that of the device's own passes where it is none
    /// of the CPU's, and median wall clock.
    fn frame(&self, relighter: &mut Relighter) -> Result<Seconds> {
        let Some(original) = self.session.rig.lights.first() else { return Ok(Seconds::default()) };
        let mut rig = self.session.rig.clone();
        let mut walls = Vec::new();
        let mut device_seconds = 0.0;
        let mut clock = Clock::start();
        for step in 0.. {
            if step == WARM_UP {
                (clock, device_seconds) = (Clock::start(), 0.0);
            }
            nudge(&mut rig.lights[0], original, &self.session, f64::from(step % 16));
            let start = Instant::now();
            relighter.set_rig(&rig)?;
            relighter.display(Picture::Whole)?;
            walls.push(start.elapsed().as_secs_f64());
            let on_device =
                relighter.times().iter().filter(|pass| pass.processor == Processor::Gpu && !self.context.is_cpu());
            device_seconds += 1e-3 * on_device.map(|pass| pass.ms).sum::<f64>();
            let counted = step + 1 - WARM_UP.min(step + 1);
            let spent = clock.seconds();
            if counted >= FEWEST_FRAMES && (spent.cpu >= ENOUGH_SECONDS || spent.wall >= 2.0 * ENOUGH_SECONDS) {
                return Ok(Seconds {
                    cpu: (spent.cpu + device_seconds) / f64::from(counted),
                    wall: median(&mut walls[WARM_UP as usize..]),
                });
            }
        }
        unreachable!("the loop above has no end")
    }
}

const WARM_UP: u32 = 3;
const FEWEST_FRAMES: u32 = 8;
const ENOUGH_SECONDS: f64 = 0.5;

/// The thesis's diffuse transfer.
pub fn thesis_diffuse(gather: u32) -> TransferOptions {
    TransferOptions { gi: Gi::Diffuse, method: MethodName::Thesis, ..ours(Some(gather), 1024, 0.01, FormName::Auto) }
}

/// Its glossy transfer.
pub fn thesis_glossy(gather: u32) -> TransferOptions {
    let basis = Some(Basis::SingularValues(THESIS_TERMS));
    TransferOptions { gi: Gi::Glossy, basis, ..thesis_diffuse(gather) }
}

/// In the command line's options, all that tells points of one scene apart.
fn setting(options: &TransferOptions) -> String {
    let gather = options.gather.map_or_else(String::new, |gather| format!("--gather {gather}"));
    if options.method == MethodName::Thesis {
        let basis =
            if options.gi == Gi::Diffuse { "--gi diffuse".into() } else { format!("--basis svd{THESIS_TERMS}") };
        return format!("--method thesis {basis} {gather}");
    }
    let form = if options.transfer == FormName::Haar { " --transfer haar" } else { "" };
    let rays = options.rays.map_or_else(String::new, |rays| format!(" --rays {rays}"));
    format!("{gather}{rays} --error {}{form}", options.error)
}

fn whole_and_indirect(relighter: &mut Relighter, (width, height): (usize, usize)) -> Result<Image> {
    let whole = relighter.linear(Picture::Whole)?.to_vec();
    let indirect = relighter.linear(Layers::Indirect)?.to_vec();
    Ok(Image::single(width, height, whole).with_layer("indirect", indirect))
}
