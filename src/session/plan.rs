//! What is baked for indirect light, and why: samples, rays and bases chosen from the picture's size and the asked error.

use std::borrow::Cow;
use std::path::Path;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::memory::check_free;
use super::progress::{Progress, advance};
use super::report::BakeReport;
use crate::bake::DeepFramebuffer;
use crate::bake::baselines::thesis::{Thesis, ThesisSettings};
use crate::bake::brdf_factors::harmonics::MAX_FUNCTIONS;
use crate::bake::brdf_factors::svd::Terms;
use crate::bake::compression::validation::{self, Validation, ValidationError};
use crate::bake::compression::{self, CompressionSettings, Compressor, Fitted, Operator, Part};
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::transfer::Transfer;
use crate::bake::transfer::blocks::check_addressable;
use crate::bake::transfer::sky::SkyTransfer;
use crate::bake::transport::direct;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::{self, LightTransport, Outgoing, TransferSettings};
use crate::error::{Error, Result};
use crate::scene::Scene;
use crate::shared::PackedLight;
use crate::storage::journal::Journal;
use crate::trace::bvh::TracedScene;

/// How indirect light is computed. What is `None` is chosen by the picture's size, and by the error that is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum IndirectSettings {
    /// Our method.
    Robust {
        outgoing: Outgoing,
        form: Form,
        /// Gather samples.
        gather: Option<u32>,
        /// Rays a row.
        rays: Option<u32>,
        /// Indirect bounces counted at the pixel; `None`: all of them.
        bounces: Option<u32>,
    },
    /// The thesis's method, dense, as printed [Yang 2007, Chapter 4].
    Thesis {
        outgoing: Outgoing,
        /// Terms of a BRDF's singular value decomposition.
        terms: Option<usize>,
        gather: Option<u32>,
        /// Its I + G + ... + G⁴ are 5 [Yang 2007, Eq. 4.6].
        bounces: u32,
    },
}

/// How our operator is stored, the compressed forms to a relative error: mean over point lights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Form {
    /// As it is: for few gather samples and small pictures.
    Dense,
    /// Nested blocks of low rank.
    Nested(f64),
    /// The largest wavelets of each row, the published form, to compare with [Ng 2003].
    Haar(f64),
}

/// What is baked, decided.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum TransferPlan {
    Robust(TransferSettings, Form),
    Thesis(ThesisSettings),
}

/// A scene, and what of it is seen.
#[derive(Clone, Copy)]
pub struct BakeInput<'a> {
    pub scene: &'a TracedScene,
    pub framebuffer: &'a DeepFramebuffer,
}

/// Gather samples of the thesis, and of the dense form [Yang 2007, Section 5.2].
const DENSE_SAMPLES: usize = 2304;
/// Gather samples of the compressed form at most; small pictures show less.
const SAMPLES: usize = 16_384;
/// Pixels for each gather sample of the compressed form, at the default error or a smaller one.
const PIXELS_A_SAMPLE: f64 = 4.0;
/// Rays a row: of the dense form, of small pictures at the default error.
const RAYS: u32 = 1024;
/// What another error may make of them.
const RAYS_BY_ERROR: [f64; 2] = [256.0, 4096.0];
/// Pixels beyond which neighbours share their noise: as many rays in all answer for as large a part of the picture.
const RAYS_PIXELS: usize = 100_000;
/// Share of the rays that remains in the largest picture. What noise hides is lost with it (docs/accuracy.md, "Rays of
/// a row").
const RAYS_LEAST: f64 = 0.5;
/// Error of the compressed operator by default.
pub const ERROR: f64 = 0.01;
/// Random lights that compression learns from.
const LIGHTS: usize = 512;
/// Random skies that compression learns from.
const SKIES: usize = 192;
/// Error of light of the sky, as a multiple of the compressed operator's: what mirrors throw is a small part of a picture,
/// and the rest of it serves while a dome moves.
const SKY_ERROR: f64 = 2.0;
/// Gather samples among which light bounces on.
const COARSE_SAMPLES: usize = 2304;
/// Points of all gather samples at which light is looked at.
const POINTS: usize = 65_536;
/// Bounces of I + G + ... + G⁴ [Yang 2007, Eq. 4.6].
pub const THESIS_BOUNCES: u32 = 5;
/// Error that a BRDF's singular values may leave, where nobody says how many there are.
const THESIS_ERROR: f64 = 0.1;

impl Default for IndirectSettings {
    fn default() -> Self {
        let outgoing = Outgoing::Glossy { functions: None };
        Self::Robust { outgoing, form: Form::Nested(ERROR), gather: None, rays: None, bounces: None }
    }
}

impl IndirectSettings {
    /// Refuses numbers that mean nothing.
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |reason: &str| Err(Error::invalid("indirect light", reason));
        let (Self::Robust { outgoing, gather, .. } | Self::Thesis { outgoing, gather, .. }) = *self;
        if gather == Some(0) || matches!(self, Self::Robust { rays: Some(0), .. } | Self::Thesis { terms: Some(0), .. })
        {
            return refuse("gather samples, rays and terms must be at least 1");
        }
        if self.error().is_some_and(|error| !(error > 0.0 && error <= 1.0)) {
            return refuse("the error must be greater than 0, and at most 1");
        }
        match outgoing {
            Outgoing::Glossy { functions: Some(count) }
                if count.isqrt().pow(2) != count || !(1..=MAX_FUNCTIONS as u8).contains(&count) =>
            {
                refuse("the number of functions must be a square number from 1 to 49")
            }
            _ => Ok(()),
        }
    }

    /// For a picture of `size` pixels whose rays go on through at most `layers` mirrors.
    pub fn plan(&self, size: [u32; 2], layers: u32, seed: u64) -> TransferPlan {
        let samples = self.samples(size).0;
        match *self {
            Self::Robust { outgoing, form, bounces, .. } => {
                let settings = TransferSettings {
                    outgoing,
                    samples,
                    paths: TransferSettings::paths_for(samples),
                    // The compressed form inverts the matrix among them.
                    coarse_samples: if form == Form::Dense { COARSE_SAMPLES } else { COARSE_SAMPLES.min(samples / 2) },
                    points: (POINTS / samples).clamp(1, 16),
                    rays: self.rays(size).0,
                    layers,
                    bounces,
                    seed,
                };
                TransferPlan::Robust(settings, form)
            }
            Self::Thesis { outgoing, terms, bounces, .. } => {
                let terms = terms.map_or(Terms::Error(THESIS_ERROR), Terms::Count);
                TransferPlan::Thesis(ThesisSettings { outgoing, samples, terms, bounces, seed })
            }
        }
    }

    /// The error of a compressed form.
    fn error(&self) -> Option<f64> {
        match *self {
            Self::Robust { form: Form::Nested(error) | Form::Haar(error), .. } => Some(error),
            _ => None,
        }
    }

    /// Number of gather samples for a picture of `size` pixels, and why. With `--gather`: that number. Dense form and
    /// thesis: [`DENSE_SAMPLES`]. Else pixels divided by [`PIXELS_A_SAMPLE`], from [`DENSE_SAMPLES`] to [`SAMPLES`]; an
    /// error above [`ERROR`] divides it further, in proportion.
    fn samples(&self, size: [u32; 2]) -> (usize, String) {
        let (Self::Robust { gather, .. } | Self::Thesis { gather, .. }) = *self;
        if let Some(samples) = gather {
            return (samples as usize, "--gather".into());
        }
        let Some(error) = self.error() else {
            return (DENSE_SAMPLES, "a dense matrix of more is too large".into());
        };
        let pixels = size[0] as usize * size[1] as usize;
        let pixels_each = (PIXELS_A_SAMPLE / (ERROR / error).min(1.0)).round() as usize;
        let samples = (pixels / pixels_each).clamp(DENSE_SAMPLES, SAMPLES);
        let bound = match samples {
            DENSE_SAMPLES => format!(", at least {DENSE_SAMPLES}"),
            SAMPLES => format!(", at most {SAMPLES}"),
            _ => String::new(),
        };
        (samples, format!("one for {pixels_each} of {pixels} pixels{bound}, with --error {error}"))
    }

    /// Rays a row, and why. With `--rays`: that number. Dense form: [`RAYS`]. Else inversely proportional to the error,
    /// within [`RAYS_BY_ERROR`], and fewer in pictures of more than [`RAYS_PIXELS`].
    fn rays(&self, size: [u32; 2]) -> (u32, String) {
        if let Self::Robust { rays: Some(rays), .. } = *self {
            return (rays, "--rays".into());
        }
        let Some(error) = self.error() else {
            return (RAYS, "the dense form is not compressed".into());
        };
        let [least, most] = RAYS_BY_ERROR;
        let by_error = (f64::from(RAYS) * ERROR / error).clamp(least, most);
        let pixels = size[0] as usize * size[1] as usize;
        let share = (RAYS_PIXELS as f64 / pixels as f64).clamp(RAYS_LEAST, 1.0);
        let why = format!("{by_error:.0} with --error {error}, {share:.2} of them in {pixels} pixels");
        ((by_error * share).round() as u32, why)
    }

    /// What is chosen for a picture of `size` pixels, and why; for people, in the command line's words.
    pub fn reasons(&self, size: [u32; 2]) -> Vec<String> {
        let (samples, why_samples) = self.samples(size);
        let mut reasons = vec![format!("{samples} gather samples: {why_samples}")];
        if matches!(self, Self::Robust { .. }) {
            let (rays, why_rays) = self.rays(size);
            reasons.push(format!("{rays} rays a row: {why_rays}"));
        }
        reasons.push(match self {
            Self::Robust { outgoing: Outgoing::Diffuse, .. } | Self::Thesis { outgoing: Outgoing::Diffuse, .. } => {
                "1 function a sample: --gi diffuse".into()
            }
            Self::Robust { outgoing: Outgoing::Glossy { functions: None }, .. } => {
                "1 to 49 functions a sample: as its material's gloss needs".into()
            }
            Self::Thesis { terms: None, .. } => format!("singular values down to {THESIS_ERROR} of a BRDF"),
            _ => "functions a sample: --basis".into(),
        });
        reasons
    }
}

impl TransferPlan {
    /// For people.
    pub fn describe(&self) -> String {
        match self {
            Self::Robust(settings, form) => {
                let TransferSettings { samples, rays, bounces, .. } = settings;
                let bounces = bounces.map_or("all bounces".into(), |bounces| format!("{bounces} bounces"));
                let form = match form {
                    Form::Dense => "dense".into(),
                    Form::Nested(error) => format!("compressed to an error of {error}"),
                    Form::Haar(error) => format!("the wavelets of each row to an error of {error}"),
                };
                format!("{samples} gather samples, {rays} rays a row, {bounces}, {form}")
            }
            Self::Thesis(ThesisSettings { samples, bounces, .. }) => {
                format!("{samples} gather samples as in the thesis, {bounces} bounces, dense")
            }
        }
    }

    /// Gather samples, points of each, and the most functions of each.
    pub(super) fn gather(&self) -> (usize, usize, usize) {
        match self {
            Self::Robust(TransferSettings { samples, points, outgoing, .. }, _) => {
                let functions = match outgoing {
                    Outgoing::Diffuse => 1,
                    Outgoing::Glossy { functions } => functions.map_or(MAX_FUNCTIONS, usize::from),
                };
                (*samples, *points, functions)
            }
            // Nobody knows the terms that an error needs.
            Self::Thesis(ThesisSettings { samples, terms, .. }) => {
                (*samples, 1, if let Terms::Count(terms) = terms { *terms } else { 1 })
            }
        }
    }

    /// Whether rows baked to one sample a pixel can serve further samples.
    pub fn spreads(&self) -> bool {
        !matches!(self, Self::Robust(_, Form::Haar(_)))
    }

    /// What takes about a second: for a compressed form, as a first look.
    pub fn first(&self) -> Option<Self> {
        let Self::Robust(settings, Form::Nested(_) | Form::Haar(_)) = self else { return None };
        let settings = TransferSettings {
            outgoing: Outgoing::Diffuse,
            samples: settings.samples.min(512),
            paths: 1 << 15,
            coarse_samples: settings.coarse_samples.min(256),
            points: 2,
            rays: settings.rays.min(64),
            ..settings.clone()
        };
        Some(Self::Robust(settings, Form::Dense))
    }

    /// What takes seconds and tells where the light goes; for a compressed form.
    pub fn coarse(&self) -> Option<Self> {
        let Self::Robust(settings, Form::Nested(error) | Form::Haar(error)) = self else { return None };
        let samples = settings.samples.min(1024);
        let coarse_samples = settings.coarse_samples.min(samples / 4);
        let rays = settings.rays.min(64);
        let paths = TransferSettings::paths_for(samples);
        let settings = TransferSettings { samples, paths, coarse_samples, points: 4, rays, ..settings.clone() };
        Some(Self::Robust(settings, Form::Nested(error.max(0.05))))
    }

    /// How far an operator of ours is from rows gathered anew, under points and spots.
    pub fn verify(
        &self,
        BakeInput { scene, framebuffer }: BakeInput,
        operator: &Transfer,
        progress: &dyn Progress,
    ) -> Result<[ValidationError; 2]> {
        let Self::Robust(settings, _) = self else {
            return Err(Error::invalid("--verify", "works only with --method robust"));
        };
        progress.begin("bounces", settings.coarse_samples.min(settings.samples));
        let transfer = LightTransport::new(scene, framebuffer, settings, &advance(progress));
        progress.end();
        let direct = |light: &PackedLight| direct::shade(scene, &transfer.fine, light);
        let rays = RAYS_ANEW * settings.rays;
        let validation = Validation { rays, share: 0.1, lights: 20, lobe: Lobe::All, seed: settings.seed ^ 5 << 32 };
        progress.begin("verifying", (validation.share * framebuffer.samples.len() as f64) as usize);
        let errors =
            validation::validate(&transfer, &direct, |light| operator.apply(light), &validation, &advance(progress));
        progress.end();
        Ok(errors)
    }

    /// Bakes the operator, and light of the sky for rigs that have `domes`; keeps nothing in the cache.
    pub fn bake(
        &self,
        input: BakeInput,
        lobe: Lobe,
        domes: bool,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Transfer> {
        let mut prepared = self.prepare(input, report, progress);
        let transfer = prepared.bake(lobe, None, None, report, progress)?;
        let bake_sky = || prepared.bake_sky(lobe, None, None, report, progress);
        let sky = (domes && self.has_sky()).then(bake_sky).transpose()?;
        Ok(Transfer { sky, ..transfer })
    }

    /// Whether there is light of the sky: with our own method.
    pub(super) fn has_sky(&self) -> bool {
        matches!(self, Self::Robust(..))
    }

    /// Whether it can be baked in parts.
    pub fn is_divisible(&self) -> bool {
        matches!(self, Self::Robust(_, Form::Nested(_)))
    }

    /// What [`TransferPlan::prepare`] made, from a file that has light of the sky if `has_sky`.
    pub(super) fn restore<'a>(&'a self, input: BakeInput<'a>, shared: Shared<'static>, has_sky: bool) -> Prepared<'a> {
        let Self::Robust(settings, form) = self else { unreachable!("only our own method is stored") };
        let Shared { transport, direct, sky } = shared;
        let transport = Box::new(transport.restore(input.scene, input.framebuffer, settings));
        let sky = has_sky.then(|| sky.map(|(from_sky, stored)| (from_sky.into_owned(), stored)));
        let stored = Box::new(StoredCompressors { direct: Some(direct), sky });
        Prepared::Robust { transport, form: *form, seed: settings.seed, stored }
    }

    /// What operators are made from.
    pub(super) fn prepare<'a>(
        &'a self,
        BakeInput { scene, framebuffer }: BakeInput<'a>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Prepared<'a> {
        let advance = advance(progress);
        match self {
            Self::Robust(settings, form) => {
                progress.begin("bounces", settings.coarse_samples.min(settings.samples));
                let transport = report.stage("bounces", || LightTransport::new(scene, framebuffer, settings, &advance));
                progress.end();
                let radius = transport.certificate.spectral_radius;
                if radius > HARDLY_ABSORBED {
                    tracing::warn!(
                        "this scene absorbs hardly any light: each bounce keeps up to {radius:.5} of it; {:.3} % of all reflected light was removed",
                        100.0 * transport.certificate.capped
                    );
                }
                let stored = Box::default();
                Prepared::Robust { transport: Box::new(transport), form: *form, seed: settings.seed, stored }
            }
            Self::Thesis(settings) => {
                progress.begin("bounces", settings.samples);
                let thesis = report.stage("bounces", || Thesis::new(scene, framebuffer, settings, &advance));
                progress.end();
                Prepared::Thesis {
                    thesis: Box::new(thesis),
                    input: BakeInput { scene, framebuffer },
                    bounces: settings.bounces,
                }
            }
        }
    }
}

/// Gather samples and bounces among them, before the operator.
pub(super) enum Prepared<'a> {
    Robust { transport: Box<LightTransport<'a>>, form: Form, seed: u64, stored: Box<StoredCompressors> },
    Thesis { thesis: Box<Thesis<'a>>, input: BakeInput<'a>, bounces: u32 },
}

/// What parts of a bake share, in a file.
#[derive(Serialize, Deserialize)]
pub(super) struct Shared<'a> {
    transport: transport::Stored<'a>,
    direct: compression::Stored<'a>,
    /// Of light of the sky, if there is a dome and any of its light arrives: [`LightTransport::from_sky`], and what compresses it.
    sky: Option<(Cow<'a, CsrMatrix>, compression::Stored<'a>)>,
}

/// What was stored of compressors and is not used yet.
#[derive(Default)]
pub(super) struct StoredCompressors {
    direct: Option<compression::Stored<'static>>,
    /// The inner option: whether any light of the sky arrives.
    sky: Option<Option<(CsrMatrix, compression::Stored<'static>)>>,
}

impl Prepared<'_> {
    /// The operator; `fits` are those that parts made; `journal` is where it keeps what it would go on from if it was stopped.
    pub fn bake(
        &mut self,
        lobe: Lobe,
        fits: Option<Vec<Fitted>>,
        journal: Option<&Path>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Transfer> {
        let advance = advance(progress);
        let mut journal = journal.map_or_else(Journal::default, Journal::open);
        let made = match self {
            Self::Robust { transport, form, seed, stored } => {
                let (scene, framebuffer) = (transport.scene(), transport.framebuffer());
                if *form == Form::Dense {
                    check_dense(framebuffer, transport.column_count(), scene)?;
                }
                progress.begin("transfer", framebuffer.samples.len());
                let to = |error| CompressionSettings { error, lights: LIGHTS, lobe, seed: *seed };
                let make = || match *form {
                    Form::Dense => Ok(Transfer::dense(transport, framebuffer, lobe, &mut journal, &advance)),
                    Form::Nested(error) => {
                        let compressor = compressor(transport, None, &to(error), stored.direct.take());
                        Transfer::compressed(&compressor, fits, &mut journal, &advance)
                    }
                    Form::Haar(error) => {
                        let fits = |bytes| check_wavelets(bytes, scene);
                        Transfer::haar(transport, &to(error), fits, &mut journal, &advance)
                    }
                };
                let made = report.stage("transfer", make);
                progress.end();
                let made = made.inspect_err(|_| journal.remove())?;
                if let (Form::Nested(error), Some(held_out)) = (*form, &made.report.held_out)
                    && held_out.is_exceeded()
                {
                    tracing::warn!(
                        "the compressed transfer misses --error {error} in {} parts of the picture; their summed squared error is {:.0} % above the target",
                        held_out.missed,
                        100.0 * held_out.excess
                    );
                }
                made
            }
            Self::Thesis { thesis, input: BakeInput { scene, framebuffer }, bounces } => {
                check_dense(framebuffer, thesis.column_count(), scene)?;
                if scene.materials.iter().any(|material| material.emissive != Vec3::ZERO) {
                    tracing::warn!("--method thesis has no indirect light of emissive materials");
                }
                if thesis.spectral_radius >= 1.0 {
                    tracing::warn!(
                        "the series of --method thesis does not converge here: its spectral radius is {:.3}; the picture has its first {bounces} terms",
                        thesis.spectral_radius,
                    );
                }
                progress.begin("transfer", framebuffer.samples.len());
                let make = || Transfer::thesis(thesis, framebuffer, lobe, &mut journal, &advance);
                let dense = report.stage("transfer", make);
                progress.end();
                dense
            }
        };
        journal.remove();
        Ok(made)
    }

    /// Light of the sky, compressed in nested blocks in any form of the operator. Arguments as of [`Prepared::bake`].
    ///
    /// Panics if the plan [has none](TransferPlan::has_sky).
    pub fn bake_sky(
        &mut self,
        lobe: Lobe,
        fits: Option<Vec<Fitted>>,
        journal: Option<&Path>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<SkyTransfer> {
        let Self::Robust { transport, form, seed, stored } = self else { unreachable!("see has_sky") };
        let advance = advance(progress);
        let mut journal = journal.map_or_else(Journal::default, Journal::open);
        progress.begin("light of the sky", transport.framebuffer().samples.len());
        let make = || {
            let (from_sky, stored) = match stored.sky.take() {
                Some(stored) => stored.unzip(),
                None => (transport.from_sky(), None),
            };
            let Some(from_sky) = from_sky else { return Ok(SkyTransfer::default()) };
            let compressor = compressor(transport, Some(&from_sky), &of_sky(*form, lobe, *seed), stored);
            SkyTransfer::compressed(&compressor, fits, &mut journal, &advance)
        };
        let made = report.stage("light of the sky", make);
        progress.end();
        journal.remove();
        if made.as_ref().is_ok_and(|sky| sky.chain.is_empty()) {
            tracing::warn!("hardly any light of the sky arrives: the scene is closed");
        }
        made
    }

    /// Computes what parts of the bake share, and gives it to `keep`.
    ///
    /// Panics unless the plan [is divisible](TransferPlan::is_divisible), as do the next two.
    pub fn share<R>(&self, lobe: Lobe, has_sky: bool, keep: impl FnOnce(&Shared) -> R) -> R {
        let (transport, settings, of_sky) = self.divisible(lobe);
        let direct = compressor(transport, None, &settings, None);
        let from_sky = if has_sky { transport.from_sky() } else { None };
        let sky = from_sky.as_ref().map(|from_sky| compressor(transport, Some(from_sky), &of_sky, None));
        // Training made a part of what is stored of the transport.
        let transport = transport::Stored::of(transport);
        let sky = from_sky.as_ref().map(Cow::Borrowed).zip(sky.as_ref().map(Compressor::stored));
        keep(&Shared { transport, direct: direct.stored(), sky })
    }

    /// Fits the superclusters of one part of the operator. `journal`: see [`Prepared::bake`].
    pub fn bake_part(
        &mut self,
        lobe: Lobe,
        part: Part,
        journal: &Path,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Vec<Fitted>> {
        let Self::Robust { stored, .. } = self else { unreachable!("see is_divisible") };
        let stored = stored.direct.take();
        let (transport, settings, _) = self.divisible(lobe);
        let compressor = || compressor(transport, None, &settings, stored);
        fit_part("transfer", compressor, part, journal, report, progress)
    }

    /// [`Prepared::bake_part`] for light of the sky; nothing, if none arrives.
    pub fn bake_part_of_sky(
        &mut self,
        lobe: Lobe,
        part: Part,
        journal: &Path,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Vec<Fitted>> {
        let Self::Robust { stored, .. } = self else { unreachable!("see is_divisible") };
        let stored = stored.sky.take();
        let (transport, _, settings) = self.divisible(lobe);
        let (from_sky, stored) = match stored {
            Some(stored) => stored.unzip(),
            None => (transport.from_sky(), None),
        };
        let Some(from_sky) = from_sky else { return Ok(Vec::new()) };
        let compressor = || compressor(transport, Some(&from_sky), &settings, stored);
        fit_part("light of the sky", compressor, part, journal, report, progress)
    }

    /// The transport, and how it and light of the sky are compressed.
    fn divisible(&self, lobe: Lobe) -> (&LightTransport<'_>, CompressionSettings, CompressionSettings) {
        let &Self::Robust { ref transport, form: form @ Form::Nested(error), seed, .. } = self else {
            unreachable!("see is_divisible")
        };
        (transport, CompressionSettings { error, lights: LIGHTS, lobe, seed }, of_sky(form, lobe, seed))
    }

    /// The view samples and the scene of our own method.
    pub fn input(&self) -> BakeInput<'_> {
        let Self::Robust { transport, .. } = self else { unreachable!("see has_sky") };
        BakeInput { scene: transport.scene(), framebuffer: transport.framebuffer() }
    }
}

/// How light of the sky is compressed.
fn of_sky(form: Form, lobe: Lobe, seed: u64) -> CompressionSettings {
    let error = match form {
        Form::Nested(error) | Form::Haar(error) => error,
        Form::Dense => ERROR,
    };
    CompressionSettings { error: SKY_ERROR * error, lights: SKIES, lobe, seed }
}

/// From what was stored of it, or computed.
fn compressor<'b>(
    transport: &'b LightTransport,
    from_sky: Option<&'b CsrMatrix>,
    settings: &CompressionSettings,
    stored: Option<compression::Stored>,
) -> Compressor<'b> {
    let operator = Operator { transport, from_sky };
    match stored {
        Some(stored) => Compressor::restore(operator, stored, settings),
        None => Compressor::new(operator, settings),
    }
}

fn fit_part<'b>(
    name: &'static str,
    compressor: impl FnOnce() -> Compressor<'b>,
    part: Part,
    journal: &Path,
    report: &mut BakeReport,
    progress: &dyn Progress,
) -> Result<Vec<Fitted>> {
    let compressor = report.stage("restore", compressor);
    let mut journal = Journal::open(journal);
    progress.begin(name, compressor.rows_of(part));
    let made = report.stage(name, || compressor.fit_part(part, &mut journal, &advance(progress)));
    progress.end();
    made
}

/// Spectral radius from which light bounces some thousand times: a thousandth more or less reflected halves or doubles it.
const HARDLY_ABSORBED: f64 = 0.999;

/// Rays of rows gathered anew, for each of the operator's own.
const RAYS_ANEW: u32 = 8;

/// Refuses a dense operator that cannot fit this machine: float16 RGB, on the host and on the device, and G* once more.
fn check_dense(framebuffer: &DeepFramebuffer, columns: usize, scene: &Scene) -> Result<()> {
    let bytes = 12.0 * (framebuffer.samples.len() as f64 + 4.0 * columns as f64) * columns as f64;
    check_addressable((6 * framebuffer.samples.len() * columns) as u64)?;
    let what =
        format!("a dense transfer of {columns} coefficients to {} view samples takes", framebuffer.samples.len());
    check_free(
        bytes,
        &what,
        "choose a smaller --size, a smaller --gather, or a --basis with fewer functions",
        &scene.path,
    )
}

/// Refuses wavelets that cannot fit this machine.
fn check_wavelets(bytes: f64, scene: &Scene) -> Result<()> {
    check_addressable(bytes as u64 / 2)?;
    let what = "the wavelets that --error needs take";
    check_free(bytes, what, "choose a larger --error, a smaller --size, or a smaller --gather", &scene.path)
}
